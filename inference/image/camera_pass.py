"""Camera rays of a tile through all volumes: single scattering, emission, alpha, depth, and depths to predict at."""

from dataclasses import dataclass, replace

import numpy as np

from ..marching.depth_samples import DepthSamples
from ..marching.emission import emitted_radiance
from ..marching.ray_features import RayFeatures
from ..marching.ray_march import MarchOptions, march
from ..marching.ray_steps import RayBatch, step_counts
from ..numerics.small_matmul import product
from ..occluders.depth_buffer import PLACES, split_rays_at_surfaces
from ..plan.plan import Plan
from ..scene.camera import Camera
from ..scene.camera_rays import camera_rays, window_around
from ..scene.errors import SceneError
from .context import ChannelPass, PreparedScene, RenderContext, Tile
from .framebuffer import add_at

# Steps per task: enough to amortise the overhead of numpy calls, few enough to fit in a processor's cache.
STEPS_PER_TASK = 200_000
# Steps of one ray beyond which a task's memory would no longer be small.
MOST_STEPS = 1 << 18
# Pixels along each axis of which one stands for all when the work ahead is estimated.
PILOT = 12


def lookup_offsets(camera: Camera, seed: int) -> np.ndarray:
    """(N,) offsets in [0, 1) of the window's pixels: a rank-1 lattice over the image, shifted by the seed.

    Neighbouring pixels get offsets far apart, so that what error is left has no
    low frequencies. Depends on the pixel's place in the whole image alone.
    """
    x0, y0, x1, y1 = camera.window
    columns, rows = np.meshgrid(np.arange(x0, x1), np.arange(y0, y1))
    shift = np.random.default_rng(seed).random()
    # Powers of the reciprocal of the plastic number.
    return np.mod(shift + columns.ravel() * 0.7548776662466927 + rows.ravel() * 0.5698402909980532, 1.0)


@dataclass(frozen=True)
class _TileRays:
    """Camera rays that are marched: R of them.

    batch: RayBatch. pixel: int (R,), ascending, of the tile. offsets: (R,) in [0, 1), of lookups. share: (R,) of the pixel
    that each ray stands for. free: (R,) of the ray, where no surface ends it. missed: rays that meet no volume.
    """

    batch: RayBatch
    pixel: np.ndarray
    offsets: np.ndarray
    share: np.ndarray
    free: np.ndarray


def march_tile(
    context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, tile: Tile
) -> DepthSamples | None:
    """Fill the tile's single scattering, emission, alpha and depth.

    Returns the depth samples of all its rays, or None where no ray meets a volume. Raises Cancelled, and SceneError where
    a ray would take too many steps.
    """
    report, settings = context.report, context.settings
    rays = _tile_rays(context, scene, channel_pass, tile)
    if rays is None:
        return None
    counts = step_counts(channel_pass.media, rays.batch)
    report.count("steps", counts.sum())
    longest = counts.max()
    if longest > MOST_STEPS:
        raise SceneError(
            f"a camera ray would take {longest:.2g} steps, because one volume's voxels are tiny beside the way through "
            "another; render volumes of so different sizes in view layers of their own"
        )
    size = _rays_per_task(scene, counts)
    hit = np.arange(len(rays.pixel))
    shade = _Shading(scene, channel_pass, tile.camera)
    options = _march_options(context, scene, channel_pass)

    def task(some):
        batch = rays.batch.take(some)
        segment = march(channel_pass.media, batch, options)
        emission = emitted_radiance(channel_pass.media, batch, channel_pass.channels.indices, settings.leave_out)
        return some, segment, shade.single(segment, batch, rays.pixel[some], rays.free[some]), emission

    parts, features = [], []
    context.progress.message("single scattering")
    with report.stage("march"), context.progress.stage("march"):
        for some, segment, single, emission in context.tasks.map(
                task, [hit[start : start + size] for start in range(0, len(hit), size)]):
            report.count("steps evaluated", segment.steps_evaluated)
            report.count("rays that meet density", np.count_nonzero(segment.alpha))
            _add(tile.framebuffer, scene, channel_pass, rays.pixel[some], rays.share[some], segment, single, emission)
            ray = some[segment.sample_ray].astype(np.int32)
            parts.append((ray, segment.sample_distance, segment.sample_weight * rays.share[ray], segment.sample_fraction))
            features.append(segment.sample_features)
            context.progress.advance("march", segment.steps_evaluated)
    columns = (np.concatenate(column) for column in zip(*parts))
    gathered = None
    if channel_pass.fluence is not None:
        gathered = RayFeatures(np.concatenate([part.values for part in features]))
    samples = DepthSamples(rays.pixel, rays.batch.origins, rays.batch.directions, rays.offsets, *columns, gathered)
    report.count("points", len(samples.ray))
    return samples


def estimate_march(
    context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, camera: Camera
) -> tuple[float, float]:
    """About how many steps are evaluated on a camera's rays, and how many depth samples they get, from one pixel in
    PILOT x PILOT."""
    x0, y0, x1, y1 = camera.window
    width, height = max((x1 - x0) // PILOT, 1), max((y1 - y0) // PILOT, 1)
    sparse = np.array([(x1 - x0) / width, (y1 - y0) / height])
    pilot = replace(camera, resolution=tuple(np.maximum(np.round(camera.resolution / sparse), 1).astype(int)), region=None)
    left, top = (np.array([x0, y0]) / sparse).astype(int)
    right, bottom = min(left + width, pilot.resolution[0]), min(top + height, pilot.resolution[1])
    if left >= right or top >= bottom:
        return 0.0, 0.0
    origins, directions, near, far = camera_rays(replace(pilot, region=(left, top, right, bottom)))
    near, far, _ = _ray_intervals(scene.plan, channel_pass.media, origins, directions, near, far)
    hit = np.flatnonzero(near < far)
    batch = RayBatch(origins[hit], directions[hit], near[hit], far[hit])
    options, steps, samples = _march_options(context, scene, channel_pass), 0, 0
    size = _rays_per_task(scene, step_counts(channel_pass.media, batch)) if len(hit) else 1
    for start in range(0, len(hit), size):
        context.cancel.check()
        segment = march(channel_pass.media, batch.take(slice(start, start + size)), options)
        steps, samples = steps + segment.steps_evaluated, samples + len(segment.sample_ray)
    return float(steps * sparse.prod()), float(samples * sparse.prod())


def _march_options(context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass) -> MarchOptions:
    return MarchOptions(context.settings.depth_samples, channel_pass.fluence, scene.occluders.shadow_maps,
                        scene.plan.groups, context.settings.leave_out)


def _rays_per_task(scene: PreparedScene, counts) -> int:
    """Rays that are marched at a time; counts: (R,) steps of each."""
    evaluated = counts.max() * min(sum(grid.occupancy.share() for grid in scene.grids), 1.0)
    return int(np.clip(STEPS_PER_TASK / evaluated, 16, 4096))


def _add(framebuffer, scene, channel_pass, pixel, weight, segment, single, emission):
    """Add what a batch of rays saw; weight: (R,) of each ray in its pixel."""
    indices = channel_pass.channels.indices
    if emission is not None:
        for number, c in enumerate(indices):
            add_at(framebuffer.emission[:, c], pixel, emission[:, number] * weight)
    for c in indices:
        albedo = np.array([medium.albedo[c] for _, medium in scene.plan.volumes])
        irradiance = np.array([sun.irradiance[c] for sun in scene.plan.suns])
        add_at(framebuffer.single[:, c], pixel, np.einsum("rvl,v,l,r->r", single, albedo, irradiance, weight))
    part = len(indices) / 3.0
    add_at(framebuffer.alpha, pixel, segment.alpha * weight * part)
    add_at(framebuffer.depth, pixel, segment.alpha * segment.depth * weight * part)


class _Shading:
    """Phase functions of single scattering in one tile."""

    def __init__(self, scene: PreparedScene, channel_pass: ChannelPass, camera: Camera):
        suns = scene.plan.suns
        self.extended_lights, self.camera = scene.extended_lights, camera
        self.directions = np.array([sun.direction for sun in suns]).reshape(-1, 3)
        self.extended = [l for l, sun in enumerate(suns) if sun.spread is not None]
        self.phases = [medium.medium.scattered for medium in channel_pass.media]

    def single(self, segment, batch: RayBatch, pixel, free) -> np.ndarray:
        """(R, V, L): single scattering of a batch's rays by volume and sun, for albedo 1 and irradiance 1."""
        cosine = product(batch.directions, self.directions.T)
        phase = np.stack([scattered(cosine) for scattered in self.phases], axis=1)
        if self.extended_lights is None:
            return segment.single * phase
        x0, y0, x1, _ = self.camera.window
        row, column = np.divmod(pixel, x1 - x0)
        phase[..., self.extended], ahead = self.extended_lights.phase(column + x0 + 0.5, row + y0 + 0.5)
        # Along the ray, wherever it scatters, light meets all that the ray does.
        depth = segment.optical_depth
        straight = depth * np.exp(-depth.sum(axis=1, keepdims=True)) * free[:, None]
        single = segment.single * phase
        single[..., self.extended] += straight[..., None] * ahead
        return single


def _tile_rays(context, scene, channel_pass, tile) -> _TileRays | None:
    """The camera rays that meet a volume, or None where none does."""
    report, settings = context.report, context.settings
    # Rays through pixels that lie away from every volume are not even made.
    around, pixel = _around(tile.camera, scene.grids, "missed_pixels" in settings.leave_out)
    report.count("camera rays", len(pixel))
    report.count("rays that miss every volume", len(tile.framebuffer.alpha) - len(pixel))
    if not len(pixel):
        return None
    origins, directions, clip_near, clip_far = camera_rays(around)
    offsets = lookup_offsets(around, settings.seed)
    near, far, warnings = _ray_intervals(scene.plan, channel_pass.media, origins, directions, clip_near, clip_far)
    report.warnings += [warning for warning in warnings if warning not in report.warnings]
    share, free = np.ones((2, len(near)))
    if scene.depth_buffer is not None:
        with report.stage("surfaces"):
            kept, far, share, free = _cut(scene.depth_buffer, around.window, near, far, context.cancel)
        pixel, origins, directions, offsets, near = (values[kept] for values in (pixel, origins, directions, offsets, near))
    hit = np.flatnonzero(near < far)
    report.count("rays that miss every volume", len(origins) - len(hit))
    report.count("rays marched", len(hit))
    if not len(hit):
        return None
    return _TileRays(RayBatch(origins[hit], directions[hit], near[hit], far[hit]), pixel[hit], offsets[hit], share[hit],
                     free[hit])


def _around(camera, grids, no_more: bool):
    """The camera with the pixels around all grids as its window, and if wanted no more, and their numbers (P,) in its own."""
    x0, y0, x1, y1 = camera.window
    if not no_more:
        return camera, np.arange((x1 - x0) * (y1 - y0))
    left, top, right, bottom = window_around(camera, np.concatenate([grid.corners() for grid in grids]))
    pixel = (np.arange(top, bottom)[:, None] - y0) * (x1 - x0) + np.arange(left, right) - x0
    return replace(camera, region=(left, top, right, bottom)) if pixel.size else camera, pixel.ravel()


def _ray_intervals(plan: Plan, media, origins, directions, clip_near, clip_far):
    """Distances (P,) between which each ray meets any medium that attenuates or emits, near > far on a miss, and warnings.

    What begins between the camera and its clip start is warned of.
    """
    near, far, warnings = np.full(len(origins), np.inf), np.full(len(origins), -np.inf), []
    for (volume, _), medium in zip(plan.volumes, media):
        if medium.matters:
            enter, leave = medium.grid.interval(origins, directions)
            if np.any((enter > 0.0) & (enter < clip_near) & (leave > clip_near)):
                warnings.append(f"{volume.name}: begins before the camera's clip start and is shown from there on; Cycles "
                                "would show nothing of it where it does")
            enter, leave = np.maximum(enter, clip_near), np.minimum(leave, clip_far)
            meets = enter < leave
            near[meets] = np.minimum(near[meets], enter[meets])
            far[meets] = np.maximum(far[meets], leave[meets])
    return near, far, warnings


def _cut(depth_buffer, window, near, far, cancel):
    """Rays that end at surfaces, as `split_rays_at_surfaces`."""
    x0, y0, x1, y1 = window
    rows, columns = np.divmod(np.flatnonzero(near < far), x1 - x0)
    distances = np.full((y1 - y0, x1 - x0, PLACES**2), np.inf)
    if len(rows):
        # Only around the pixels that show a volume.
        left, top, right, bottom = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
        found = depth_buffer.distances((x0 + left, y0 + top, x0 + right, y0 + bottom), cancel)
        distances[top:bottom, left:right] = found.reshape(bottom - top, right - left, -1)
    return split_rays_at_surfaces(near, far, distances.reshape(len(near), -1))
