"""What a render shows behind the layer where the film is not transparent."""

from dataclasses import dataclass, field
from typing import List, Optional, Tuple, Union

import numpy as np

from ...inference.scene import Camera
from ..nodes.sockets import Unsupported
from ..objects.visibility import evaluated_world
from ..world.lighting import constant_background
from ..world.picture import WorldSource, world_source
from ..world.process import PictureFailed

# Of Cycles, for each pixel that differs from its neighbours.
SAMPLES = 16


@dataclass
class Background:
    """The World behind a camera's pixels.

    camera: whose window it fills. radiance: float32, (3,) where it is the same everywhere, else (h, w, 3) of the
    window, rows from the top. warnings: why it is not the World's own.
    """

    camera: Camera
    radiance: np.ndarray
    warnings: List[str] = field(default_factory=list)

    def pixels(self, region: Optional[Tuple[int, int, int, int]] = None) -> np.ndarray:
        """float32 (h, w, 3) of pixels (x0, y0, x1, y1) of the image that lie in the window, as `Camera.region`.

        All of the window where there is no region.
        """
        left, top = self.camera.window[:2]
        x0, y0, x1, y1 = region or self.camera.window
        if self.radiance.ndim == 1:
            return np.broadcast_to(self.radiance, (y1 - y0, x1 - x0, 3))
        return self.radiance[y0 - top : y1 - top, x0 - left : x1 - left]


def read_background(depsgraph, camera: Camera, check=lambda: None) -> Background:
    """The World behind a camera's pixels; where Cycles has to show it this takes some seconds, unless it has before.

    check: called often meanwhile; what it raises ends the work. Where the World cannot be shown it is black, with a
    warning that names it.
    """
    found = world_behind(depsgraph)
    if not isinstance(found, WorldSource):
        return Background(camera, found)
    try:
        return Background(camera, found.view(camera, SAMPLES, pixel_filter(depsgraph.scene), check))
    except PictureFailed as failure:
        return Background(camera, np.zeros(3, np.float32), [
            f"World \"{depsgraph.scene.world.name}\": {failure}, so the background is black; "
            "turn on Film > Transparent to put the layer over your own"])


def world_behind(depsgraph) -> Union[np.ndarray, WorldSource]:
    """What cameras see of the World: its radiance, float32 (3,), or what has Cycles show it."""
    world = evaluated_world(depsgraph)
    if world is None or not _seen_by_camera(world):
        return np.zeros(3, np.float32)
    try:
        return constant_background(world).astype(np.float32)
    except Unsupported:
        return world_source(world, depsgraph.scene)


def pixel_filter(scene) -> Tuple[str, float]:
    """Cycles' own filter and its width in pixels."""
    # Cycles' own properties, gone while Cycles is disabled.
    settings = getattr(scene, 'cycles', None)
    return (settings.pixel_filter_type, settings.filter_width) if settings else ('BLACKMAN_HARRIS', 1.5)


def _seen_by_camera(world) -> bool:
    visibility = getattr(world, 'cycles_visibility', None)
    return visibility is None or visibility.camera


def over(image: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """float32 (h, w, 4): a premultiplied image (h, w, 4) over what is behind (h, w, 3), with alpha 1."""
    rgb = image[..., :3] + (1.0 - image[..., 3:]) * behind
    return np.concatenate([rgb, np.ones_like(image[..., 3:])], axis=2)
