# SPDX-License-Identifier: GPL-3.0-or-later
"""The background of a render whose film is not transparent."""

from collections.abc import Callable
from dataclasses import dataclass, field

import bpy
import numpy as np

from ...inference.scene import Camera
from ..nodes.sockets import Unsupported
from ..objects.visibility import evaluated_world
from ..world.lighting import constant_background, is_wanted
from ..world.picture import WorldSource, cached_source, world_source
from ..world.process import PictureFailed

# Cycles' samples for each pixel that differs from its neighbours.
SAMPLES = 16
# Seconds until Cycles' process has started, that it takes for the light of a World, and for a pixel behind the volumes.
CYCLES_START, LIGHT_SECONDS, PIXEL_SECONDS = 2.0, 1.0, 4e-6


@dataclass
class Background:
    """The World behind a camera's pixels.

    camera: whose window it fills. radiance: float32, (3,) where it is uniform, else (h, w, 3) of the window, rows from
    the top. warnings: why it is not the World's.
    """

    camera: Camera
    radiance: np.ndarray
    warnings: list[str] = field(default_factory=list)

    def pixels(self, region: tuple[int, int, int, int] | None = None) -> np.ndarray:
        """float32 (h, w, 3) of the window's pixels (x0, y0, x1, y1), in the image as `Camera.region`; all of them
        without a region.
        """
        left, top = self.camera.window[:2]
        x0, y0, x1, y1 = region or self.camera.window
        if self.radiance.ndim == 1:
            return np.broadcast_to(self.radiance, (y1 - y0, x1 - x0, 3))
        return self.radiance[y0 - top : y1 - top, x0 - left : x1 - left]


def read_background(
    depsgraph: "bpy.types.Depsgraph", camera: Camera, check: Callable[[], None] = lambda: None
) -> Background:
    """The World behind a camera's pixels; takes seconds where Cycles renders it for the first time.

    check: called often; an exception that it raises stops the work. A World that cannot be rendered becomes black, with
    a warning that names it.
    """
    found = world_behind(depsgraph)
    if not isinstance(found, WorldSource):
        return Background(camera, found * np.float32(camera.exposure))
    warnings = []
    if camera.eye is not None and np.isfinite(camera.eye.convergence):
        warnings.append(
            f'World "{depsgraph.scene.world.name}": both eyes of spherical stereo show the same background; set '
            "Convergence Mode to Parallel, or turn on Film > Transparent"
        )
    try:
        return Background(camera, found.view(camera, SAMPLES, pixel_filter(depsgraph.scene), check), warnings)
    except PictureFailed as failure:
        return Background(
            camera,
            np.zeros(3, np.float32),
            [
                f'World "{depsgraph.scene.world.name}": {failure}, so the background is black; '
                "turn on Film > Transparent to composite the layer over another"
            ],
        )


def world_behind(depsgraph: "bpy.types.Depsgraph") -> np.ndarray | WorldSource:
    """The World as cameras see it: radiance, float32 (3,), or the source that Cycles renders."""
    world = evaluated_world(depsgraph)
    if world is None or not _visible_to_camera(world):
        return np.zeros(3, np.float32)
    try:
        return constant_background(world).astype(np.float32)
    except Unsupported:
        return world_source(world, depsgraph.scene)


def sky_seconds(depsgraph: "bpy.types.Depsgraph", camera: Camera) -> float:
    """About how long Cycles renders the World: for the volumes, and behind them where the film is not transparent."""
    scene, world = depsgraph.scene, evaluated_world(depsgraph)
    light, behind = is_wanted(depsgraph), False
    if scene.render.engine == "MRPNN" and not scene.render.film_transparent and world and _visible_to_camera(world):
        try:
            constant_background(world)
        except Unsupported:
            source = cached_source(world, scene)
            behind = source is None or not source.has_view(camera, SAMPLES, pixel_filter(scene))
    x0, y0, x1, y1 = camera.window
    pixels = (x1 - x0) * (y1 - y0) if behind else 0
    return CYCLES_START * (light or behind) + LIGHT_SECONDS * light + PIXEL_SECONDS * pixels


def pixel_filter(scene: "bpy.types.Scene") -> tuple[str, float]:
    """Cycles' filter type and its width in pixels."""
    # Properties of Cycles, absent while Cycles is disabled.
    settings = getattr(scene, "cycles", None)
    return (settings.pixel_filter_type, settings.filter_width) if settings else ("BLACKMAN_HARRIS", 1.5)


def _visible_to_camera(world: "bpy.types.World") -> bool:
    visibility = getattr(world, "cycles_visibility", None)
    return visibility is None or visibility.camera


def over(image: np.ndarray, behind: np.ndarray) -> np.ndarray:
    """float32 (h, w, 4): a premultiplied image (h, w, 4) over a background (h, w, 3), with alpha 1."""
    rgb = image[..., :3] + (1.0 - image[..., 3:]) * behind
    return np.concatenate([rgb, np.ones_like(image[..., 3:])], axis=2)
