"""Camera rays through all volumes: single scattering, alpha and depth of pixels, and depths to predict at."""

from dataclasses import replace

import numpy as np

from .depth_samples import DepthSamples
from .emission import emitted
from .images import add_at
from .march import march
from .products import product
from .ray_light import RayLight
from .ray_steps import step_counts
from .rays import camera_rays, window_around
from .scene import Camera, SceneError
from .surfaces import PLACES, rays_to_surfaces

# Rays a marching task are chosen to hold about this many steps that are looked at: fewer, and what calling numpy takes
# shows; more, and what they hold no longer fits into a processor's cache.
STEPS_A_TASK = 200_000
# Steps of one ray beyond which a task's memory would no longer be small.
MOST_STEPS = 1 << 18


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


def march_camera_rays(
    plan, channels, grids, camera, screen, obstacles, spread, settings, diffused, work, report, start, end, images
):
    """Fill single, emission, alpha and depth; return the DepthSamples of all rays, or None where no ray meets a volume.

    spread: SpreadLight of those of the plan's suns that have a spread, or None.
    """
    # Rays through pixels that lie away from every volume are not even made.
    around, pixel = _around(camera, grids, "missed_pixels" in settings.leave_out)
    report.count("camera rays", len(pixel))
    report.count("rays that miss every volume", len(images.alpha) - len(pixel))
    if not len(pixel):
        return None
    origins, directions, clip_near, clip_far = camera_rays(around)
    offsets = lookup_offsets(around, settings.seed)
    near, far = _ray_intervals(plan, grids, channels.sigma_t, origins, directions, clip_near, clip_far, report)
    share, free = np.ones((2, len(near)))
    if screen is not None:
        with report.stage("surfaces"):
            kept, far, share, free = _cut(screen, around.window, near, far)
        pixel, origins, directions, offsets, near = (values[kept] for values in (pixel, origins, directions, offsets, near))
    hit = np.flatnonzero(near < far)
    report.count("rays that miss every volume", len(origins) - len(hit))
    report.count("rays marched", len(hit))
    if not len(hit):
        return None

    for grid, sigma_t in zip(grids, channels.sigma_t):
        grid.set_extinction(float(sigma_t))
    counts = step_counts(grids, channels.sigma_t, directions[hit], near[hit], far[hit])
    report.count("steps", counts.sum())
    longest = counts.max()
    if longest > MOST_STEPS:
        raise SceneError(
            f"a camera ray would take {longest:.2g} steps, because one volume's voxels are tiny beside the way through "
            "another; render volumes of so different sizes in view layers of their own"
        )
    looked_at = longest * min(sum(grid.occupancy.share() for grid in grids), 1.0)
    size = int(np.clip(STEPS_A_TASK / looked_at, 16, 4096))
    tasks = [hit[i : i + size] for i in range(0, len(hit), size)]
    suns = np.array([sun.direction for sun in plan.suns]).reshape(-1, 3)
    wide = [l for l, sun in enumerate(plan.suns) if sun.spread is not None]
    x0, y0, x1, _ = camera.window

    def task(rays):
        segment = march(
            grids, channels.sigma_t, origins[rays], directions[rays], near[rays], far[rays],
            settings.depth_samples, diffused, obstacles.sun_maps if obstacles else None, plan.groups, settings.leave_out,
        )
        cosine = product(directions[rays], suns.T)
        phase = np.stack([m.scattered(cosine) for _, m in plan.volumes], axis=1)
        if spread is not None:
            row, column = np.divmod(pixel[rays], x1 - x0)
            phase[..., wide], ahead = spread.phase(column + x0 + 0.5, row + y0 + 0.5)
            # Along the ray, wherever it scatters, light meets all that the ray does.
            straight = segment.through * np.exp(-segment.through.sum(axis=1, keepdims=True)) * free[rays, None]
        glow = emitted(grids, channels, [m.emission for _, m in plan.volumes], origins[rays], directions[rays],
                       near[rays], far[rays], settings.leave_out)
        lit = segment.single * phase
        if spread is not None:
            lit[..., wide] += straight[..., None] * ahead
        return rays, segment, lit, glow

    parts, light = [], []
    part = len(channels.indices) / 3.0
    with report.stage("march"):
        for rays, segment, lit, glow in work.map(task, tasks, start, end, "single scattering"):
            report.count("steps looked at", segment.steps_looked_at)
            report.count("rays that meet density", np.count_nonzero(segment.alpha))
            at, weight = pixel[rays], share[rays]
            if glow is not None:
                for number, c in enumerate(channels.indices):
                    add_at(images.emission[:, c], at, glow[:, number] * weight)
            for c in channels.indices:
                albedo = np.array([m.albedo[c] for _, m in plan.volumes])
                irradiance = np.array([sun.irradiance[c] for sun in plan.suns])
                add_at(images.single[:, c], at, np.einsum("rvl,v,l,r->r", lit, albedo, irradiance, weight))
            add_at(images.alpha, at, segment.alpha * weight * part)
            add_at(images.depth, at, segment.alpha * segment.depth * weight * part)
            ray = rays[segment.sample_ray].astype(np.int32)
            parts.append((ray, segment.sample_distance, segment.sample_weight * share[ray], segment.sample_fraction))
            light.append(segment.sample_light)
    columns = (np.concatenate(column) for column in zip(*parts))
    samples = DepthSamples(pixel, origins, directions, offsets, *columns)
    if diffused is not None:
        samples.light = RayLight(np.concatenate([part.values for part in light]))
    report.count("points", len(samples.ray))
    return samples


def _around(camera, grids, no_more: bool):
    """The camera with the pixels around all grids as its window, and if wanted no more, and their numbers (P,) in its own."""
    x0, y0, x1, y1 = camera.window
    if not no_more:
        return camera, np.arange((x1 - x0) * (y1 - y0))
    left, top, right, bottom = window_around(camera, np.concatenate([grid.corners() for grid in grids]))
    pixel = (np.arange(top, bottom)[:, None] - y0) * (x1 - x0) + np.arange(left, right) - x0
    return replace(camera, region=(left, top, right, bottom)) if pixel.size else camera, pixel.ravel()


def _ray_intervals(plan, grids, sigma_t, origins, directions, clip_near, clip_far, report):
    """Distances (P,) between which each ray meets any grid that attenuates or emits; near > far on a miss.

    What begins between the camera and its clip start is warned of.
    """
    near, far = np.full(len(origins), np.inf), np.full(len(origins), -np.inf)
    for (volume, _), grid, extinction in zip(plan.volumes, grids, sigma_t):
        if extinction > 0.0 or grid.emission:
            enter, leave = grid.interval(origins, directions)
            warning = f"{volume.name}: begins before the camera's clip start and is shown from there on; Cycles would " \
                "show nothing of it where it does"
            if np.any((enter > 0.0) & (enter < clip_near) & (leave > clip_near)) and warning not in report.warnings:
                report.warnings.append(warning)
            enter, leave = np.maximum(enter, clip_near), np.minimum(leave, clip_far)
            meets = enter < leave
            near[meets] = np.minimum(near[meets], enter[meets])
            far[meets] = np.maximum(far[meets], leave[meets])
    return near, far


def _cut(screen, window, near, far):
    """Rays that end at surfaces, as `rays_to_surfaces`."""
    x0, y0, x1, y1 = window
    rows, columns = np.divmod(np.flatnonzero(near < far), x1 - x0)
    distances = np.full((y1 - y0, x1 - x0, PLACES**2), np.inf)
    if len(rows):
        # Only around the pixels that show a volume.
        left, top, right, bottom = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
        found = screen.distances((x0 + left, y0 + top, x0 + right, y0 + bottom))
        distances[top:bottom, left:right] = found.reshape(bottom - top, right - left, -1)
    return rays_to_surfaces(near, far, distances.reshape(len(near), -1))
