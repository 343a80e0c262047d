# SPDX-License-Identifier: GPL-3.0-or-later
"""A factor of the light that the network predicts of environments, from light paths.

Paths of environments vary little, since they need not meet a sun: some ten thousand tell the mean of a picture to one
or two per cent, though its pixels far less well than the network. The network's light of a few camera rays is compared
with paths from these rays, and what it errs by on their mean is taken back in the whole picture.
"""

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..environments.environment_light import ROWS, Skies
from ..grids.working_cube import Cube
from ..marching.light_paths import GIVEN_UP, MISSED, PathTracer, ScatteringMedia
from ..marching.ray_steps import RayBatch
from ..scene.camera import Camera
from ..scene.camera_rays import camera_rays
from ..scene.environment import pixel_numbers
from .camera_pass import march_tile
from .context import ChannelPass, PreparedScene, RenderContext, Tile
from .sources import Source
from .tile_estimate import TileEstimate

#: Rays whose light is compared, and pixels of the whole image for one more each, since noise shows as flicker in films.
RAYS, PIXELS_PER_RAY, MOST_RAYS = 128, 1024, 2048
#: Paths of an opaque ray in a batch, and of any at most. There are as many batches as it takes until the standard
#: error of the comparison, of RAYS rays, is so small, but no more than the last number.
PATHS, MOST_PATHS, CERTAIN, MOST_BATCHES = 64, 1024, 0.01, 2
# Between the numbers of rays' paths in one batch and in the next.
APART = 1 << 32
# Optical thickness of a voxel above which there are fewer paths, since each takes longer.
THICK_VOXEL = 4.0
# Of a camera of so many pixels along its longer edge, or as many more as it takes until enough of its rays meet the
# bounds of a volume, for each ray that is compared; and opacity below which rays do not count.
LEAST_EDGE, MOST_EDGE, MEETING, MIN_ALPHA = 32, 1024, 4, 0.02
# Standard deviation of the network's error on the mean of a picture: what paths tell less certainly counts less.
EXPECTED = 0.03
# Rays that a thread follows at once.
RAYS_PER_TASK = 16


def correct_environments(
    context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, sources: Sequence[Source]
) -> list[Source]:
    """Sources, those of environments with the factors by which their light is corrected where paths can tell.

    They cannot where surfaces are lit or hide light from the volumes; and numpy alone would take too long. As in the
    network, the phase function is Henyey and Greenstein's. Raises Cancelled.
    """
    lit = [source for source in sources if source.tells_single]
    if not lit or not _followed(context, scene):
        return list(sources)
    factors = np.ones(3)
    with context.report.stage("light paths"):
        factors[channel_pass.channels.indices] = _compare(context, scene, channel_pass, lit)
    return [source.corrected(factors) if source.tells_single else source for source in sources]


def _followed(context: RenderContext, scene: PreparedScene) -> bool:
    """Whether paths are traced through a scene."""
    settings, plan = context.settings, scene.plan
    if not (settings.light_paths and settings.multiple):
        return False
    if plan.reflects or plan.sky or len(scene.occluders.triangles):
        return False
    return all(environment.weight is None for environment in scene.environments)


def _compare(
    context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, sources: Sequence[Source]
) -> np.ndarray:
    """Factors (C,) of the channels that are rendered together."""
    indices = channel_pass.channels.indices
    channels = len(indices)
    width, height = scene.camera.resolution
    count = min(RAYS + width * height // PIXELS_PER_RAY, MOST_RAYS)
    meeting = _meeting_rays(context, scene, channel_pass, MEETING * count)
    if meeting is None:
        return np.ones(channels)
    rays, predicted, opacity = _predicted(context, scene, channel_pass, sources, meeting, count)
    paths = _paths(channel_pass, opacity)
    if not paths:
        return np.ones(channels)
    media = ScatteringMedia([medium for medium in channel_pass.media if medium.sigma_t > 0.0], indices)
    opened = scene.opened(sources[0].groups[0])
    assert opened is not None
    cube = opened.predictor.cube
    skies = Skies.of(scene.environments, cube.rotation)
    tracer = PathTracer(media, context.tasks.stopping)
    # Light that scatters too often to be followed, and that of rays on which no path collides, counts as predicted.
    typical = predicted.T / opacity[:, None]

    def trace(batch: int, first: int) -> tuple[np.ndarray, np.ndarray]:
        context.cancel.check()
        some = slice(first, first + RAYS_PER_TASK)
        ends = tracer.trace(rays.batch.take(some), rays.pixels[some] + batch * APART, paths)
        arriving = _arriving(skies, indices, cube, ends.directions) * ends.kept
        light = np.where((ends.ends == GIVEN_UP)[..., None], typical[some, None], arriving)
        met = (ends.ends != MISSED)[..., None]
        count = np.maximum(met.sum(axis=1), 1)
        mean = (light * met).sum(axis=1) / count
        variance = (((light - mean[:, None]) ** 2) * met).sum(axis=1) / count**2
        return np.where(met.any(axis=1), mean, typical[some]), variance

    def sums(batch: int) -> tuple[np.ndarray, np.ndarray]:
        traced = context.tasks.map(functools.partial(trace, batch), range(0, len(opacity), RAYS_PER_TASK))
        mean, variance = (np.concatenate(part) for part in zip(*traced))
        return (opacity[:, None] * mean).sum(axis=0), (opacity[:, None] ** 2 * variance).sum(axis=0)

    whole = predicted.sum(axis=1)
    traced, variance = sums(0)
    wanted = _batches(whole, variance * len(opacity) / RAYS)
    # The last one counts in part, so that the factors are continuous in the light.
    shares = np.minimum(wanted - np.arange(np.ceil(wanted)), 1.0) / wanted
    traced = shares[0] * traced + sum(share * sums(batch)[0] for batch, share in enumerate(shares[1:], 1))
    return _factor(whole, traced, variance * (shares**2).sum())


def _batches(predicted: np.ndarray, variance: np.ndarray) -> float:
    """How many times as many paths it takes to be certain enough; arrays (C,) as for `_factor`."""
    error = variance / np.maximum(predicted, 1e-30) ** 2
    return float(np.clip(error.max() / CERTAIN**2, 1.0, MOST_BATCHES))


def _paths(channel_pass: ChannelPass, opacity: np.ndarray) -> int:
    """How many paths start at each of R rays of some opacities (R,), about as many of which scatter in any scene."""
    thickness = max(medium.voxel_thickness for medium in channel_pass.media)
    wanted = PATHS * len(opacity) * min(1.0, THICK_VOXEL / max(thickness, 1e-9))
    return int(min(np.round(wanted / max(opacity.sum(), 1e-9)), MOST_PATHS))


def _factor(predicted: np.ndarray, traced: np.ndarray, variance: np.ndarray) -> np.ndarray:
    """What predicted sums (C,) of light are to be multiplied by, from traced ones and the variances of these."""
    with np.errstate(all="ignore"):
        ratio, error = traced / predicted, variance / predicted**2
        factor = 1.0 + (ratio - 1.0) * EXPECTED**2 / (EXPECTED**2 + error)
    return np.where(np.isfinite(factor), factor, 1.0)


@dataclass(frozen=True)
class _Rays:
    """Rays of a coarse camera that may meet volumes.

    camera: that they are of. pixels: int64 (R,), of its image, which decide the paths of each ray. batch: between the
    bounds of the volumes.
    """

    camera: Camera
    pixels: np.ndarray
    batch: RayBatch

    def take(self, some: np.ndarray | slice) -> "_Rays":
        """Some of the rays."""
        return _Rays(self.camera, self.pixels[some], self.batch.take(some))


def _meeting_rays(context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, count: int) -> _Rays | None:
    """About so many rays, evenly spread over what the camera sees of the volumes' bounds in its whole image."""
    longest, edge = max(scene.camera.resolution), LEAST_EDGE
    while True:
        size = np.maximum(np.round(np.array(scene.camera.resolution) * min(edge / longest, 1.0)), 1).astype(int)
        camera = replace(scene.camera, resolution=tuple(size.tolist()), region=None)
        origins, directions, *clip = camera_rays(camera)
        near, far = np.full((2, len(origins)), [[np.inf], [-np.inf]])
        coarse = replace(scene, camera=camera, eyes=None)
        pixels = np.arange(len(origins)).reshape(camera.resolution[::-1])
        for (x0, y0, x1, y1), groups in coarse.parts(camera.window):
            some, boxes = pixels[y0:y1, x0:x1].ravel(), channel_pass.through(groups).march.boxes
            near[some], far[some] = boxes.intervals(origins[some], directions[some], [ends[some] for ends in clip])
        meet = np.flatnonzero(near < far)
        if len(meet) >= count or edge >= min(longest, MOST_EDGE):
            break
        edge *= 2
        context.cancel.check()
    if not len(meet):
        return None
    meet = _spread(meet, count)
    return _Rays(camera, meet, RayBatch(origins[meet], directions[meet], near[meet], far[meet]))


def _predicted(
    context: RenderContext,
    scene: PreparedScene,
    channel_pass: ChannelPass,
    sources: Sequence[Source],
    rays: _Rays,
    count: int,
) -> tuple[_Rays, np.ndarray, np.ndarray]:
    """At most so many of the rays, the light (C, R) that is predicted of them without surfaces, and opacities (R,)."""
    width, height = rays.camera.resolution
    shown = np.zeros((height, width), bool)
    shown.flat[rays.pixels] = True
    coarse, tile = (
        replace(scene, depth_buffer=None, camera=rays.camera, eyes=None),
        Tile.of(rays.camera, rays.camera.window, shown),
    )
    light, opacity = np.zeros((len(channel_pass.channels.indices), width * height)), np.zeros(width * height)
    marched = march_tile(context, coarse, channel_pass, tile)
    if marched is None:
        return rays.take(rays.pixels[:0]), light[:, :0], opacity[:0]
    samples = marched.nodes
    pixel = samples.pixel[samples.ray]
    np.add.at(opacity, pixel, samples.weight)
    lit = np.flatnonzero(opacity[rays.pixels] > MIN_ALPHA)
    rays = rays.take(_spread(lit, count))
    wanted = np.isin(pixel, rays.pixels)
    for source in (source.within(samples.volumes) for source in sources):
        if not source.members:
            continue
        some = np.flatnonzero(wanted & (samples.share(source.members) > 0.0))
        if not len(some):
            continue
        estimate = TileEstimate(context, samples, tile, source)
        estimate.evaluate(some)
        for row, radiance in zip(source.rows, estimate.radiance):
            for c in row.channels:
                light[channel_pass.channels.indices.index(c)] += radiance
    return rays, light[:, rays.pixels], opacity[rays.pixels]


def _spread(values: np.ndarray, most: int) -> np.ndarray:
    """At most so many of some values, evenly spread."""
    count = min(most, len(values))
    return values[np.arange(count) * len(values) // max(count, 1)]


def _arriving(skies: Skies, channels: Sequence[int], cube: Cube, directions: np.ndarray) -> np.ndarray:
    """Radiance (..., C) in some channels that arrives of skies in a cube's frame from world directions (..., 3)."""
    image = skies.image.reshape(2 * ROWS * ROWS, -1)
    radiance = image[pixel_numbers(cube.directions(directions.reshape(-1, 3)), ROWS)]
    if skies.channels > 1:
        radiance = radiance[:, channels]
    return np.broadcast_to(radiance, (len(radiance), len(channels))).reshape(*directions.shape[:-1], len(channels))
