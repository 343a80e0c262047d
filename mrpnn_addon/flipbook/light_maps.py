# SPDX-License-Identifier: GPL-3.0-or-later
"""Six-way light maps: a volume lit by one sun at a time, from six sides of the camera. Imports no bpy."""

import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ... import inference
from ...inference.image.layer import Layer
from ...inference.scene import Medium, SceneError, Settings, Sun, Volume, soft_sun
from ...inference.scene.environment import LUMA
from ...inference.scene.sparse_grid import SparseGrid
from ..scene.reader import SceneDescription
from .motion_vectors import motion_vectors

#: The sides from which the suns shine, in the order of `Tile.maps`, and the directions towards them in the camera's
#: axes: it looks along -Z, which is where the back is.
SIDES = {
    "right": (1.0, 0.0, 0.0),
    "top": (0.0, 1.0, 0.0),
    "back": (0.0, 0.0, -1.0),
    "left": (-1.0, 0.0, 0.0),
    "bottom": (0.0, -1.0, 0.0),
    "front": (0.0, 0.0, 1.0),
}
# A white matte surface that faces a sun of this irradiance has radiance 1.
IRRADIANCE = np.pi
# Interpolating light between six sides errs far more than this makes the maps err.
TOLERANCE = 6.0
# Relative differences of colour channels above which a medium is coloured.
COLOURED = 0.01


@dataclass
class Tile:
    """One frame, rows from the top, premultiplied by alpha.

    maps: float32 (H, W, 6), radiance for a sun from each of SIDES, over that of a white matte surface which faces it.
    alpha: float32 (H, W). emission: float32 (H, W, 3), radiance of light that the volumes emit. motion: of
    `motion_vectors` until the next tile, or None.
    """

    maps: np.ndarray
    alpha: np.ndarray
    emission: np.ndarray
    motion: np.ndarray | None = None


def render_tile(
    scene: SceneDescription,
    settings: Settings,
    angle: float = 0.0,
    frames: int = 1,
    progress: Callable[[float, str], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
    cache: inference.RenderCache | None = None,
) -> Tile:
    """The light maps of a scene as its camera sees it, whose own lights are left out.

    angle: angular diameter of the suns, radians. What six maps cannot tell, light between the sides, is then smoother.
    frames: until the next tile. progress, cancelled: as of `inference.render`, called on any thread. cache: of earlier
    tiles.

    Three suns share a render: a sun that shines in one colour channel only is alone in this channel of the picture,
    because the media are made grey. The renders run side by side. Raises SceneError, and Cancelled when `cancelled()`
    returns True.
    """
    camera = replace(scene.camera, exposure=1.0, region=None)
    if camera.projection == "equirectangular":
        raise SceneError("light maps need a perspective or orthographic camera")
    surfaces = [replace(surface, emission=np.zeros(3)) for surface in scene.surfaces]
    # A tile is an instant, whatever moves in it.
    still = [(replace(volume, velocity=None), medium) for volume, medium in scene.volumes]
    volumes = [(without_emission(volume), grey(medium)) for volume, medium in still]
    glows = any(volume.emission is not None and medium.emission > 0.0 for volume, medium in scene.volumes)
    cache, parts = cache or inference.RenderCache(), 2 + glows
    flows = any(volume.velocity is not None for volume, _ in scene.volumes)
    # A thread that renders alone calls the network for larger parts of a picture.
    threads = settings.threads or os.cpu_count() or 1
    settings = replace(settings, tolerance=TOLERANCE, states_error=False, threads=max(threads // 2, 1))
    told = replace(settings, outputs=settings.outputs | {"median"}) if flows else settings
    towards = np.array(list(SIDES.values())) @ camera.world_matrix[:3, :3].T

    done = [0.0] * parts

    def render(number: int, lights: list, of: list[tuple[Volume, Medium]]) -> Layer:
        def tell(fraction: float, message: str) -> None:
            done[number] = fraction
            if progress is not None:
                progress(sum(done) / parts, message)

        return inference.render(of, lights, camera, told if number == 0 else settings, tell, cancelled, cache, surfaces)

    def suns(number: int) -> Iterator[Sun]:
        for channel in range(3):
            side = 3 * number + channel
            yield from soft_sun(towards[side], IRRADIANCE * np.eye(3)[channel], angle, list(SIDES)[side])

    try:
        with ThreadPoolExecutor(min(threads, 2)) as pool:
            lit = list(pool.map(lambda number: render(number, list(suns(number)), volumes), range(2)))
        maps = np.concatenate([layer.rgb for layer in lit], axis=2)
        emission = render(2, [], still).rgb if glows else np.zeros_like(maps[..., :3])
    except MemoryError:
        raise SceneError("not enough memory for this frame; use a smaller texture, or smaller grids") from None
    distance, motion = lit[0].median, None
    if distance is not None:
        motion = motion_vectors(camera, distance, scene.volumes, frames)
    return Tile(maps, lit[0].alpha, emission, motion)


def without_emission(volume: Volume) -> Volume:
    """A volume with the same voxels that emits nothing."""
    return replace(volume, emission=None)


def grey(medium: Medium) -> Medium:
    """A medium of the same luminance whose colour channels are equal."""
    extinction = float(LUMA @ medium.sigma_t)
    if medium.varies:
        grids = medium.albedo
        albedo = grids if len(grids) == 1 else (_weighted(grids),)
    else:
        scattering = float(LUMA @ (medium.sigma_t * medium.albedo))
        albedo = scattering / extinction if extinction > 0.0 else float(LUMA @ medium.albedo)
    return replace(medium, sigma_t=np.full(3, extinction), albedo=albedo)


def _weighted(grids: tuple) -> np.ndarray | SparseGrid:
    if isinstance(grids[0], SparseGrid):
        return grids[0].with_values(_mean([grid.values for grid in grids]))
    return _mean(grids)


def _mean(grids: Sequence[np.ndarray]) -> np.ndarray:
    """The luminance of the values of three colour channels, at most 1."""
    return np.clip(sum(np.float32(weight) * grid for weight, grid in zip(LUMA, grids)), 0.0, 1.0)


def is_coloured(medium: Medium) -> bool:
    """Whether the colour channels of a medium differ visibly."""
    if medium.varies:
        return len(medium.albedo) > 1
    return any(np.ptp(values) > COLOURED * values.max() for values in (medium.sigma_t, medium.albedo))


def recombined(maps: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The picture (H, W) for a sun in a direction (3,), in the camera's axes, as game engines interpolate it.

    The squares of the direction's components, which sum to 1, weigh the maps of the three sides that it points to:
    what Unity's six-way shader does.
    """
    direction = direction / np.linalg.norm(direction)
    weights = np.maximum(np.array(list(SIDES.values())) @ direction, 0.0) ** 2
    return maps @ weights.astype(np.float32)
