# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays of a tile through all volumes: single scattering, emission, alpha, depth, and depths to predict at."""

from dataclasses import dataclass, replace

import numpy as np

from ..blur.sharpness import NEVER, Spreads
from ..grids.bound_medium import Movement
from ..marching.depth_samples import DepthSamples
from ..marching.held_volumes import held_volumes, in_columns
from ..marching.ray_features import RayFeatures
from ..marching.ray_march import RaySegment
from ..marching.ray_steps import RayBatch
from ..numerics.quadrature import PLASTIC
from ..numerics.small_matmul import product
from ..occluders.depth_buffer import end_rays_at_surfaces
from ..plan.plan import last_albedo
from ..scene.camera import Camera
from ..scene.camera_rays import camera_rays, pixel_rays, places_in_image
from ..scene.errors import SceneError
from .context import ChannelPass, PreparedScene, RenderContext, Tile
from .framebuffer import Framebuffer, add_at, summed
from .lamp_pass import LampMeans, means_around_lamps

# Steps per task: amortises the overhead of calls, and of numpy's arrays fits in cache.
STEPS_PER_TASK = 1_000_000
# Steps of one ray above which a task would need too much memory.
MAX_STEPS = 1 << 18
# Opacity below this is none beside a holdout.
HELD = 1e-5
# Estimates of the work ahead march one pixel in PILOT x PILOT.
PILOT = 12


def lookup_offsets(columns: np.ndarray, rows: np.ndarray, seed: int) -> np.ndarray:
    """Offsets (N,) in [0, 1) of pixels: a rank-1 lattice over the image, shifted by the seed.

    Neighbouring pixels get offsets far apart, so that the remaining error has no low frequencies. Depends only on the
    pixel's place in the whole image.
    """
    offsets = np.random.default_rng(seed).random() + columns * PLASTIC[0] + rows * PLASTIC[1]
    return offsets - np.floor(offsets)


@dataclass(frozen=True)
class TileRays:
    """Camera rays that are marched: R of them.

    batch: RayBatch. pixel: int (R,), of the tile, ascending. offsets: (R,) in [0, 1), jitter of lookups. share: (R,),
    fraction of the pixel that each ray stands for. free: (R,), fraction of the ray that no surface ends. rays: through
    each whole pixel.
    """

    batch: RayBatch
    pixel: np.ndarray
    offsets: np.ndarray
    share: np.ndarray
    free: np.ndarray
    rays: int = 1

    def take(self, some: np.ndarray) -> "TileRays":
        """Some of the rays."""
        return TileRays(
            batch=self.batch.take(some),
            pixel=self.pixel[some],
            offsets=self.offsets[some],
            share=self.share[some],
            free=self.free[some],
            rays=self.rays,
        )


def march_tile(
    context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, tile: Tile
) -> DepthSamples | None:
    """Add single scattering to the tile, emission, alpha and depth.

    Returns the depth samples of all its rays, or None if no ray hits a volume. Raises Cancelled, and SceneError for
    rays that would take too many steps.
    """
    with tile.report.stage("march"):
        tile.report.count("rays that miss every volume", len(tile.framebuffer.alpha) - len(tile.shown))
        parts = (
            _march(context, scene, channel_pass.through(groups), tile.part(window))
            for window, groups in scene.parts(tile.camera.window)
        )
        marched = [part for part in parts if part is not None]
        return DepthSamples.joined(marched) if marched else None


def _march(context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, tile: Tile) -> DepthSamples | None:
    report = tile.report
    rays = tile_rays(context, scene, channel_pass, tile)
    if rays is None:
        return None
    counts = channel_pass.step_counts(rays.batch)
    report.count("steps", counts.sum())
    longest = counts.max()
    if longest > MAX_STEPS:
        raise SceneError(
            f"a camera ray would take {longest:.2g} steps, because one volume's voxels are tiny compared to the path "
            "through another; render volumes of such different sizes in view layers of their own"
        )
    size = _rays_per_task(channel_pass, counts)
    shade, parts, features, of_lamps = Shading(scene, channel_pass, tile.camera), [], [], []
    scattering = []
    means = _means_around_lamps(scene, channel_pass, tile, rays) if scene.lamps else []
    for start in range(0, len(rays.pixel), size):
        context.cancel.check()
        span = slice(start, start + size)
        batch = rays.batch.take(span)
        segment = channel_pass.march.march_steps(batch, counts[span])
        single = shade.single(segment, batch, rays.pixel[span], rays.free[span])
        report.count("steps evaluated", segment.steps_evaluated)
        report.count("rays that meet density", np.count_nonzero(segment.alpha))
        add_marched(
            tile.framebuffer, scene, channel_pass, MarchedRays(rays.pixel[span], rays.share[span], segment, single)
        )
        if segment.lamps is not None:
            for mean in means:
                mean.replace(segment.lamps.single, start)
            add_lamps(tile.framebuffer, scene, channel_pass, rays.pixel[span], rays.share[span], segment.lamps.single)
            if segment.lamps.features is not None:
                of_lamps.append(segment.lamps.features.values)
        ray = (start + segment.sample_ray).astype(np.int32)
        weight = segment.sample_weight * rays.share[ray]
        parts.append((ray, segment.sample_distance, weight, segment.sample_fraction))
        if segment.sample_features is not None:
            features.append(segment.sample_features.values)
        if segment.sample_scattering is not None:
            scattering.append(segment.sample_scattering)
    ray, distance, weight, fraction = (np.concatenate(column) for column in zip(*parts))
    held, columns = held_volumes(fraction > 0.0, channel_pass.volumes)
    held_groups, of_groups = held_volumes(*scene.groups_holding(fraction > 0.0, channel_pass.volumes))
    samples = DepthSamples(
        pixel=rays.pixel,
        origins=rays.batch.origins,
        directions=rays.batch.directions,
        offsets=rays.offsets,
        ray=ray,
        distance=distance,
        weight=weight,
        held=held,
        fraction=in_columns(fraction, columns),
        held_groups=held_groups,
        features=RayFeatures(in_columns(np.concatenate(features), of_groups)) if features else None,
        lamp_features=RayFeatures(in_columns(np.concatenate(of_lamps), of_groups)) if of_lamps else None,
        scattering=in_columns(np.concatenate(scattering), columns) if scattering else None,
        detail=rays.batch.detail,
        volumes=frozenset(channel_pass.volumes),
        rays=rays.rays,
        eyes=rays.batch.eyes,
        motion=scene.motion,
    )
    report.count("points", len(samples.ray))
    _hold_out(tile.framebuffer, channel_pass, samples)
    return samples


def _hold_out(framebuffer: Framebuffer, channel_pass: ChannelPass, samples: DepthSamples) -> None:
    """Take the opacity of holdouts from the tile."""
    if channel_pass.holdouts and len(samples.ray):
        taken = samples.weight * samples.share(channel_pass.holdouts) * len(channel_pass.channels.indices) / 3.0
        add_at(framebuffer.alpha, samples.pixel[samples.ray], -taken)
        add_at(framebuffer.depth, samples.pixel[samples.ray], -taken * samples.distance)
        for image in (framebuffer.alpha, framebuffer.depth):
            # Rounding leaves a little where all of it is taken.
            image[image < HELD] = 0.0


def add_sharpness(scene: PreparedScene, tile: Tile, samples: DepthSamples) -> None:
    """Add to the tile how sharp its pixels are: at depth samples, and where surfaces end rays."""
    assert scene.eyes is not None
    (left, top, *_), window = scene.camera.window, tile.camera.window
    pixel, distance, still = samples.pixel[samples.ray], samples.distance, samples.weight.copy()
    for v, motion in enumerate(scene.motion):
        if motion is not None and samples.meets([v]):
            share = samples.weight * samples.share([v])
            some = np.flatnonzero(share > 0.0)
            seen, velocities = (pixel[some], distance[some], share[some]), samples.velocities(some, motion)
            _add_sharpness(scene, tile, tile.framebuffer.sharpness, seen, motion, velocities)
            still -= share
    if scene.eye_distances is not None:
        x0, y0, x1, y1 = window
        ends, moving = (
            values[y0 - top : y1 - top, x0 - left : x1 - left].ravel()
            for values in (scene.eye_distances.distances, scene.eye_distances.moving)
        )
        share, some, hit = 1.0 / scene.eyes.rays, np.flatnonzero(moving >= 0), np.flatnonzero(np.isfinite(ends))
        seen = some // scene.eyes.rays, ends[some], np.full(len(some), share)
        velocities = scene.eye_distances.velocities[moving[some]]
        _add_sharpness(scene, tile, tile.framebuffer.swept, seen, None, velocities)
        hit = hit[moving[hit] < 0]
        pixel = np.concatenate([pixel, hit // scene.eyes.rays])
        distance = np.concatenate([distance, ends[hit]])
        still = np.concatenate([still, np.full(len(hit), share)])
    some = np.flatnonzero(still > 0.0)
    _add_sharpness(scene, tile, tile.framebuffer.sharpness, (pixel[some], distance[some], still[some]))


def _add_sharpness(
    scene: PreparedScene,
    tile: Tile,
    image: np.ndarray,
    seen: tuple[np.ndarray, np.ndarray, np.ndarray],
    motion: Movement | None = None,
    velocities: np.ndarray | None = None,
) -> None:
    """Add to an image how sharp is what pixels (N,) see at distances (N,), weighted (N,), of what one movement moves.

    velocities: (N, 3) in the world, or None; without a movement, per shutter.
    """
    pixel, distance, weight = seen
    if not len(pixel):
        return
    assert scene.eyes is not None
    window = tile.camera.window
    frames = None if motion is None else motion.frames
    times = NEVER if velocities is None else scene.eyes.times
    if motion is not None:
        times = NEVER if motion.flow is None else motion.flow.times
    spreads = Spreads(scene.eyes, tile.camera, window, (distance.min(), distance.max()), frames, times)
    found = spreads.sharpness(pixel, distance, velocities)
    for number, values in enumerate((*(found * weight[:, None]).T, weight)):
        image[:, number] += np.bincount(pixel, values, len(image))


def estimate_march(
    context: RenderContext, channel_pass: ChannelPass, camera: Camera, rays: int = 1
) -> tuple[float, float]:
    """Approximate number of steps evaluated on a camera's rays, so many per pixel, and of their depth samples.

    Marches one pixel in PILOT x PILOT. Raises Cancelled.
    """
    x0, y0, x1, y1 = camera.window
    width, height = max((x1 - x0) // PILOT, 1), max((y1 - y0) // PILOT, 1)
    sparse = np.array([(x1 - x0) / width, (y1 - y0) / height])
    resolution = np.maximum(np.round(camera.resolution / sparse), 1).astype(int)
    pilot = replace(camera, resolution=tuple(resolution), region=None)
    left, top = (np.array([x0, y0]) / sparse).astype(int)
    right, bottom = min(left + width, pilot.resolution[0]), min(top + height, pilot.resolution[1])
    if left >= right or top >= bottom:
        return 0.0, 0.0
    origins, directions, near, far = camera_rays(replace(pilot, region=(left, top, right, bottom)))
    near, far = channel_pass.march.boxes.intervals(origins, directions, (near, far))
    hit = np.flatnonzero(near < far)
    batch = channel_pass.detailed(RayBatch(origins[hit], directions[hit], near[hit], far[hit]))
    steps, samples = 0, 0
    size = _rays_per_task(channel_pass, channel_pass.step_counts(batch)) if len(hit) else 1
    for start in range(0, len(hit), size):
        context.cancel.check()
        segment = channel_pass.march(batch.take(slice(start, start + size)))
        steps, samples = steps + segment.steps_evaluated, samples + len(segment.sample_ray)
    return float(steps * sparse.prod() * rays), float(samples * sparse.prod() * rays)


def _rays_per_task(channel_pass: ChannelPass, counts: np.ndarray) -> int:
    """Number of rays that are marched together; counts: int (R,), steps of each ray."""
    evaluated = counts.max() * min(sum(medium.grid.occupancy.share for medium in channel_pass.media), 1.0)
    steps = STEPS_PER_TASK
    return int(np.clip(steps / evaluated, 16, 4096))


@dataclass(frozen=True)
class MarchedRays:
    """What a batch of R rays gathered.

    pixel, share: (R,), as in TileRays. single: (R, V, L, S), as in RaySegment, with the phase function.
    """

    pixel: np.ndarray
    share: np.ndarray
    segment: RaySegment
    single: np.ndarray


def add_marched(
    framebuffer: Framebuffer, scene: PreparedScene, channel_pass: ChannelPass, marched: MarchedRays
) -> None:
    """Add what a batch of rays gathered to the tile."""
    pixel, weight, segment, emission = marched.pixel, marched.share, marched.segment, marched.segment.emission
    indices = channel_pass.channels.indices
    suns = scene.plan.suns
    linked, known = scene.plan.linking(suns, channel_pass.volumes), {}
    for c in indices:
        albedo = np.array([last_albedo(*scene.plan.volumes[v])[c] for v in channel_pass.volumes])
        light, place = linked * albedo[:, None] * [sun.irradiance[c] for sun in suns], channel_pass.scattering_place(c)
        # Channels may be lit alike.
        key = place, light.tobytes()
        if key not in known:
            known[key] = summed(pixel, np.einsum("rvl,vl,r->r", marched.single[..., place], light, weight))
        framebuffer.single[pixel[0] : pixel[0] + len(known[key]), c] += known[key]
    if emission is not None:
        for number, c in enumerate(indices):
            add_at(framebuffer.emission[:, c], pixel, emission[:, number] * weight)
    fraction = len(indices) / 3.0
    add_at(framebuffer.alpha, pixel, segment.alpha * weight * fraction)
    add_at(framebuffer.depth, pixel, segment.alpha * segment.depth * weight * fraction)


def add_lamps(
    framebuffer: Framebuffer,
    scene: PreparedScene,
    channel_pass: ChannelPass,
    pixel: np.ndarray,
    share: np.ndarray,
    single: np.ndarray,
) -> None:
    """Add single scattering of lamps (R, V, K, S), as in LampSegment, to the tile.

    pixel, share: (R,), as in TileRays.
    """
    linked = scene.plan.linking([scene.plan.lamps[cell[0]] for cell in scene.lamp_cells])
    for c in channel_pass.channels.indices:
        albedo = np.array([last_albedo(*pair)[c] for pair in scene.plan.volumes])
        light = linked * albedo[:, None] * [lamp.power[c] for lamp in scene.marched_lamps]
        of_lamps = single[..., channel_pass.scattering_place(c)]
        add_at(framebuffer.single[:, c], pixel, np.einsum("rvk,vk,r->r", of_lamps, light, share))


def _means_around_lamps(scene: PreparedScene, channel_pass: ChannelPass, tile: Tile, rays: TileRays) -> list[LampMeans]:
    """As `means_around_lamps`, of the rays of a tile that are all of their pixels."""
    camera, (x0, y0, x1, _) = tile.camera, tile.camera.window
    rows, columns = np.divmod(rays.pixel, x1 - x0) + np.array([[y0], [x0]])

    def intervals(origins: np.ndarray, directions: np.ndarray, cosine: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        clip = [end / cosine for end in camera.clip]
        return channel_pass.march.boxes.intervals(origins, directions, clip)

    pixels = np.where(rays.share < 1.0, -1, columns), rows
    return means_around_lamps(scene, channel_pass, camera, rays.batch, pixels, intervals)


class Shading:
    """Phase functions of single scattering in one tile."""

    def __init__(self, scene: PreparedScene, channel_pass: ChannelPass, camera: Camera):
        suns = scene.plan.suns
        self.extended_lights, self.camera, self.eyes = scene.extended_lights, camera, scene.eyes is not None
        self.directions = np.array([sun.direction for sun in suns]).reshape(-1, 3)
        self.extended = [number for number, sun in enumerate(suns) if sun.spread is not None]
        # Each once, and which of them each medium has.
        media = [bound.medium for bound in channel_pass.media]
        kinds = [(medium.anisotropy, None if medium.phase is None else id(medium.phase)) for medium in media]
        different = {kind: medium.scattered for kind, medium in zip(kinds, media)}
        numbers = {kind: number for number, kind in enumerate(different)}
        self.phases, self.phase_of = list(different.values()), [numbers[kind] for kind in kinds]

    def single(self, segment: RaySegment, batch: RayBatch, pixel: np.ndarray, free: np.ndarray) -> np.ndarray:
        """Single scattering (R, V, L, S) of a batch's rays by volume and sun, as in RaySegment, for irradiance 1."""
        cosine = product(batch.directions, self.directions.T)
        phase = np.stack([scattered(cosine) for scattered in self.phases], axis=1)[:, self.phase_of]
        if self.extended_lights is None:
            return segment.single * phase[..., None]
        towards, ahead = self.extended_lights.phase(*places_in_image(self.camera, pixel, batch.directions, self.eyes))
        phase[..., self.extended] = towards
        # Light from ahead is attenuated along the whole ray, wherever it scatters.
        depth = segment.optical_depth
        scattered = depth[..., None] if segment.scattering_depth is None else segment.scattering_depth
        straight = scattered * np.exp(-depth.sum(axis=1))[:, None, None] * free[:, None, None]
        single = segment.single * phase[..., None]
        single[:, :, self.extended] += straight[:, :, None] * ahead[..., None]
        return single


def tile_rays(context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, tile: Tile) -> TileRays | None:
    """The camera rays that may meet a volume, or None if there are none."""
    report, pixel = tile.report, tile.shown
    report.count("camera rays", len(pixel))
    if not len(pixel):
        return None
    x0, y0, x1, _ = tile.camera.window
    rows, columns = np.divmod(pixel, x1 - x0) + np.array([[y0], [x0]])
    eyes = scene.eyes
    if eyes is None:
        rays = _rays_of_pixels(context, scene, channel_pass, tile, (columns, rows))
    else:
        rays = _rays_of_eyes(context, scene, channel_pass, tile, eyes.of_pixels(columns, rows))
    hit = rays.batch.near < rays.batch.far
    report.count("rays that miss every volume", len(hit) - np.count_nonzero(hit))
    report.count("rays marched", np.count_nonzero(hit))
    if not hit.any():
        return None
    rays = rays if hit.all() else rays.take(hit)
    return replace(rays, batch=channel_pass.detailed(rays.batch))


def _rays_of_pixels(
    context: RenderContext,
    scene: PreparedScene,
    channel_pass: ChannelPass,
    tile: Tile,
    pixels: tuple[np.ndarray, np.ndarray],
) -> TileRays:
    """Rays through the centres of the tile's pixels, columns and rows (N,); several where surfaces end them apart."""
    origins, directions, *clip = pixel_rays(tile.camera, *pixels)
    offsets = lookup_offsets(*pixels, context.settings.seed)
    near, far = channel_pass.march.boxes.intervals(origins, directions, clip)
    rays = TileRays(RayBatch(origins, directions, near, far), tile.shown, offsets, *np.ones((2, len(near))))
    if scene.depth_buffer is None:
        return rays
    with tile.report.stage("surfaces"):
        ended = end_rays_at_surfaces(scene.depth_buffer, pixels, (near, far), context.cancel)
    rays = rays.take(ended.pixel)
    return replace(rays, batch=replace(rays.batch, far=ended.far), share=ended.share, free=ended.free)


def _rays_of_eyes(
    context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, tile: Tile, numbers: np.ndarray
) -> TileRays:
    """Rays of eyes, by number (N, R), through the tile's pixels."""
    eyes, (x0, y0, x1, _) = scene.eyes, tile.camera.window
    assert eyes is not None
    pixel, number = np.repeat(tile.shown, eyes.rays), numbers.ravel()
    rows, columns = np.divmod(pixel, x1 - x0) + np.array([[y0], [x0]])
    origins, directions = np.empty((2, len(pixel), 3))
    interval = np.empty((2, len(pixel)))
    order, boxes = np.argsort(number, kind="stable"), channel_pass.march.boxes
    for some in np.split(order, np.flatnonzero(np.diff(number[order])) + 1):
        eye = number[some[0]]
        origins[some], directions[some], *ends = pixel_rays(eyes.cameras[eye], columns[some], rows[some])
        seen = boxes.seen_by(eye) if scene.motion else boxes
        interval[:, some] = seen.intervals(origins[some], directions[some], ends)
    offsets = lookup_offsets(columns, rows, context.settings.seed) + number % eyes.rays * PLASTIC[0]
    near, far = interval
    share, free = np.full(len(pixel), 1.0 / eyes.rays), np.ones(len(pixel))
    if scene.eye_distances is not None:
        left, top, *_ = scene.camera.window
        ends = scene.eye_distances.distances[rows - top, columns - left, number % eyes.rays]
        far, free = np.minimum(far, ends), np.isinf(ends).astype(float)
    batch = RayBatch(origins, directions, near, far, eyes=number if scene.motion else None)
    return TileRays(batch, pixel, offsets - np.floor(offsets), share, free, eyes.rays)
