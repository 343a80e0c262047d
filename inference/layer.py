"""Scene in, layer out: camera rays, single scattering, predicted multiple scattering, composed."""

import contextlib
from dataclasses import dataclass, replace
from typing import Optional, Tuple

import numpy as np

from .depth_samples import DepthSamples
from .emission import emitted
from .kept import Kept
from .march import march
from .multiple import POINTS_A_TASK, MultipleField
from .phase import henyey_greenstein
from .plan import distinct_albedos, make_plan
from .ray_light import RayLight
from .ray_steps import step_counts
from .rays import camera_rays
from .report import Report, process_peak_memory
from .scene import Camera, SceneError, Settings
from .sun_map import SunMap
from .surfaces import PLACES, Screen, rays_to_surfaces
from .work import Work

# Rays a marching task are chosen to hold about this many steps.
STEPS_A_TASK = 600_000
# Steps of one ray beyond which a task's memory would no longer be small.
MOST_STEPS = 1 << 18
# Depth samples whose scattered emission is looked up at a time.
GLOW_POINTS = 1 << 16
# Share of the progress bar that marching takes.
MARCH_SHARE = 0.4


@dataclass
class Layer:
    """What a render returns, rows from the top.

    rgb: float32 (H, W, 3) linear radiance, premultiplied by alpha.
    alpha: float32 (H, W), 1 - transmittance of the camera ray.
    depth: float32 (H, W) mean distance along the ray at which light scatters,
        world units; infinity where alpha is 0.
    single, multiple, emission: float32 (H, W, 3), light scattered once and more often, and what volumes
        emit, unscattered; rgb is their sum.
    uncertainty: float32 (H, W) standard error of `multiple` from the choice of depths, as a mean
        over the channels; the network's own error is not in it. With one depth sample nothing tells
        it, and it is as large as `multiple`.
    report: what was planned, left out and measured.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    single: np.ndarray
    multiple: np.ndarray
    uncertainty: np.ndarray
    emission: np.ndarray
    report: Optional[Report] = None


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


def render(
    volumes, suns, camera: Camera, settings: Settings = None, progress=None, cancelled=None, kept: Kept = None,
    surfaces=(),
) -> Layer:
    """Render volumes lit by suns.

    volumes: list of (Volume, Medium); suns: list of Sun. progress(fraction,
    message) is called on the calling thread; cancelled() -> bool is asked several times a
    second. kept: of renders before, for what has not changed since; its memory is held until it is dropped.
    surfaces: Surfaces at which camera rays end, for a layer that is put over them, though not those of equirectangular
    cameras, and that keep suns' light from being scattered once.
    The same seed gives the same image for any number of threads.
    Raises SceneError for a scene that cannot be rendered, Cancelled when asked to stop.
    """
    settings = settings or Settings()
    report = Report()
    work = Work(settings, progress, cancelled)
    try:
        with report.stage("total"):
            layer = _render(volumes, suns, camera, settings, work, report, kept, surfaces)
    finally:
        work.close()
    report.threads = work.threads
    report.peak_memory = process_peak_memory()
    return layer


def _render(volumes, suns, camera, settings, work, report, kept, surfaces):
    kept = kept or Kept(any_view=False)
    plan = make_plan(volumes, suns, camera, settings)
    report.planned, report.left_out = plan.planned, plan.left_out
    network = None
    if any(plan.multiple):
        with report.stage("network loading"):
            network = kept.network(settings.model, settings.provider)
        report.model, report.checksum = network.name, network.checksum
        report.provider = getattr(network, "provider", "CPU")
        report.warnings += getattr(network, "warnings", ())

    x0, y0, x1, y1 = camera.window
    height, width = y1 - y0, x1 - x0
    single, multiple, emission = np.zeros((3, height * width, 3), np.float32)
    uncertainty, alpha, depth = np.zeros((3, height * width), np.float32)
    report.count("pixels", height * width)

    with report.stage("shadows"):
        grids = kept.grids([volume for volume, _ in plan.volumes], plan.suns, work)
    fields, screen, sun_maps = {}, None, None
    with report.stage("surfaces"):
        covering = [surface for surface in surfaces if surface.covers]
        if covering and camera.projection != "equirectangular":
            screen = Screen(covering, camera)
        shading = [surface for surface in surfaces if surface.shades]
        if shading and plan.volumes:
            corners = np.concatenate([grid.corners() for grid in grids])
            sun_maps = [SunMap(shading, sun.direction, corners) for sun in plan.suns]
            sun_maps = None if all(sun_map.empty for sun_map in sun_maps) else sun_maps
    with kept.predicting(work) if network or any(plan.scattered_glow) else contextlib.nullcontext():
        for number, channels in enumerate(plan.channels if plan.volumes else []):
            diffused = None
            if network is not None and network.needs_light:
                with report.stage("fields"):
                    diffused = _diffuse(plan, channels, network, kept, grids, fields, work, report)
            tiles = range(y0, y1, plan.tile_rows)
            share = 1.0 / len(plan.channels) / len(tiles)
            for tile, row in enumerate(tiles):
                rows = replace(camera, region=(x0, row, x1, min(row + plan.tile_rows, y1)))
                start = number / len(plan.channels) + tile * share
                pixels = slice((row - y0) * width, (row - y0 + plan.tile_rows) * width)
                samples = _march_camera_rays(
                    plan, channels, grids, rows, screen, sun_maps, settings, diffused, work, report,
                    start, start + share * MARCH_SHARE, single[pixels], emission[pixels], alpha[pixels],
                    depth[pixels],
                )
                if samples is not None and any(plan.scattered_glow):
                    _add_glow(plan, channels, kept, grids, samples, work, report, multiple[pixels])
                if network is not None and samples is not None:
                    _add_multiple(
                        plan, channels, network, kept, grids, fields, samples, work, report,
                        start + share * MARCH_SHARE, start + share, multiple[pixels], uncertainty[pixels], whole=len(tiles) > 1,
                    )

    shape = (height, width)
    single, multiple, emission = (colour.reshape(*shape, 3) for colour in (single, multiple, emission))
    np.divide(depth, np.maximum(alpha, np.float32(1e-30)), out=depth)
    depth[alpha <= 0.0] = np.inf
    return Layer(
        rgb=single + multiple + emission,
        alpha=np.clip(alpha, 0.0, 1.0).reshape(shape),
        depth=depth.reshape(shape),
        single=single,
        multiple=multiple,
        uncertainty=uncertainty.reshape(shape),
        emission=emission,
        report=report,
    )


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


def _scatters(plan, channels, g) -> bool:
    """Whether multiple scattering is predicted in a group of volumes, in these channels."""
    return plan.multiple[g] and any(
        channels.sigma_t[v] > 0.0 and plan.volumes[v][1].albedo[channels.indices].any() for v in plan.groups[g])


def _pairs(plan):
    """The Volume and Medium of each volume in each group."""
    return [[plan.volumes[v] for v in group] for group in plan.groups]


def _field(plan, channels, network, kept, grids, fields, g, work, report) -> Tuple[MultipleField, float]:
    """The field of one group of volumes, made once, and its extinction in these channels."""
    made = g not in fields
    if made:
        work.check()
        fields[g] = kept.field(network, _pairs(plan), g, [grids[v] for v in plan.groups[g]], work.check)
    work.check()
    sigma_t = float(fields[g].medium.sigma_t[channels.indices[0]])
    if made:
        report.warnings += fields[g].warnings(sigma_t)
    return fields[g], sigma_t


def _diffuse(plan, channels, network, kept, grids, fields, work, report):
    """DiffusedLight of each group of volumes in which multiple scattering is predicted, else None."""
    diffused = []
    for g in range(len(plan.groups)):
        light = None
        if _scatters(plan, channels, g):
            field, sigma_t = _field(plan, channels, network, kept, grids, fields, g, work, report)
            light = field.diffused_light(sigma_t, [sun.direction for sun in plan.suns], work.each)
        diffused.append(light)
    return diffused


def _march_camera_rays(
    plan, channels, grids, camera, screen, sun_maps, settings, diffused, work, report, start, end, single, emission, alpha, depth
):
    """Fill single, emission, alpha and depth; return the DepthSamples of all rays, or None where no ray meets a volume."""
    origins, directions, clip_near, clip_far = camera_rays(camera)
    offsets = lookup_offsets(camera, settings.seed)
    near, far = _ray_intervals(plan, grids, channels.sigma_t, origins, directions, clip_near, clip_far, report)
    pixel, share = np.arange(len(near)), np.ones(len(near))
    if screen is not None:
        with report.stage("surfaces"):
            pixel, share, far = _cut(screen, camera.window, near, far)
        origins, directions, offsets, near = (values[pixel] for values in (origins, directions, offsets, near))
    hit = np.flatnonzero(near < far)
    report.count("rays that miss every volume", len(origins) - len(hit))
    report.count("rays marched", len(hit))
    if not len(hit):
        return None

    for grid, sigma_t in zip(grids, channels.sigma_t):
        grid.set_extinction(float(sigma_t))
    longest = step_counts(grids, channels.sigma_t, directions[hit], near[hit], far[hit]).max()
    if longest > MOST_STEPS:
        raise SceneError(
            f"a camera ray would take {longest:.2g} steps, because one volume's voxels are tiny beside the way through "
            "another; render volumes of so different sizes in view layers of their own"
        )
    size = int(np.clip(STEPS_A_TASK // longest, 16, 4096))
    tasks = [hit[i : i + size] for i in range(0, len(hit), size)]
    suns = np.array([sun.direction for sun in plan.suns]).reshape(-1, 3)

    def task(rays):
        segment = march(
            grids, channels.sigma_t, origins[rays], directions[rays], near[rays], far[rays],
            settings.depth_samples, diffused, sun_maps, plan.groups,
        )
        cosine = directions[rays] @ suns.T
        phase = np.stack([henyey_greenstein(cosine, m.anisotropy) for _, m in plan.volumes], axis=1)
        glow = emitted(grids, channels, [m.emission for _, m in plan.volumes], origins[rays], directions[rays],
                       near[rays], far[rays])
        return rays, segment, segment.single * phase, glow

    parts, light = [], []
    part = len(channels.indices) / 3.0
    with report.stage("march"):
        for rays, segment, lit, glow in work.map(task, tasks, start, end, "single scattering"):
            at, weight = pixel[rays], share[rays]
            if glow is not None:
                np.add.at(emission, (at[:, None], channels.indices), glow * weight[:, None])
            for c in channels.indices:
                albedo = np.array([m.albedo[c] for _, m in plan.volumes])
                irradiance = np.array([sun.irradiance[c] for sun in plan.suns])
                np.add.at(single, (at, c), np.einsum("rvl,v,l,r->r", lit, albedo, irradiance, weight))
            np.add.at(alpha, at, segment.alpha * weight * part)
            np.add.at(depth, at, segment.alpha * segment.depth * weight * part)
            ray = rays[segment.sample_ray].astype(np.int32)
            parts.append((ray, segment.sample_distance, segment.sample_weight * share[ray], segment.sample_fraction))
            light.append(segment.sample_light)
    columns = (np.concatenate(column) for column in zip(*parts))
    samples = DepthSamples(pixel, origins, directions, offsets, *columns)
    if diffused is not None:
        samples.light = RayLight(np.concatenate([part.values for part in light]))
    report.count("points", len(samples.ray))
    return samples


def _cut(screen, window, near, far):
    """Rays that end at surfaces, as `rays_to_surfaces`: pixel (M,), share (M,), far (M,)."""
    x0, y0, x1, y1 = window
    rows, columns = np.divmod(np.flatnonzero(near < far), x1 - x0)
    distances = np.full((y1 - y0, x1 - x0, PLACES**2), np.inf)
    if len(rows):
        # Only around the pixels that show a volume.
        left, top, right, bottom = columns.min(), rows.min(), columns.max() + 1, rows.max() + 1
        found = screen.distances((x0 + left, y0 + top, x0 + right, y0 + bottom))
        distances[top:bottom, left:right] = found.reshape(bottom - top, right - left, -1)
    pixel, far, share = rays_to_surfaces(near, far, distances.reshape(len(near), -1))
    return pixel, share, far


def _add_glow(plan, channels, kept, grids, samples, work, report, multiple):
    """Add what the volumes scatter of light that they emit to the image."""
    for g, group in enumerate(plan.groups):
        if not plan.scattered_glow[g]:
            continue
        with report.stage("emission"):
            glow = kept.glow(_pairs(plan), g, [grids[v] for v in group], work.check)
        warnings = glow.warnings(" and ".join(plan.volumes[v][0].name for v in group))
        report.warnings += [warning for warning in warnings if warning not in report.warnings]
        for v in group:
            medium, inside = plan.volumes[v][1], np.flatnonzero(samples.fraction[:, v] > 0.0)
            for start in range(0, len(inside), GLOW_POINTS):
                work.check()
                points = inside[start : start + GLOW_POINTS]
                positions, directions = samples.positions(points), samples.directions[samples.ray[points]]
                weight = samples.weight[points] * samples.fraction[points, v]
                for c in channels.indices:
                    light = glow.scattered(c, positions, directions, medium.anisotropy) * medium.albedo[c]
                    np.add.at(multiple, (samples.pixel[samples.ray[points]], c), weight * light)


def _add_multiple(
    plan, channels, network, kept, grids, fields, samples, work, report, start, end, multiple, uncertainty, whole: bool
):
    """Add the predicted multiple scattering of every volume and sun to the image, and its uncertainty.

    whole: whether further samples may lie anywhere in the volumes.
    """
    # What each sample adds to the mean of the three channels.
    parts = np.zeros(len(samples.ray), np.float32)
    jobs = [(g, l) for g in range(len(plan.groups)) if _scatters(plan, channels, g) for l in range(len(plan.suns))]
    for number, (g, l) in enumerate(jobs):
        sun, group = plan.suns[l], plan.groups[g]
        inside = np.flatnonzero(samples.fraction[:, group].any(axis=1))
        if not len(inside):
            continue
        # Of each volume in the group, (V, 3).
        scattered = np.array([plan.volumes[v][1].albedo for v in group], np.float32)
        tasks = [inside[i : i + POINTS_A_TASK] for i in range(0, len(inside), POINTS_A_TASK)]
        first, last = (start + (end - start) * n / len(jobs) for n in (number, number + 1))
        message = "multiple scattering of " + " and ".join(plan.volumes[v][0].name for v in group)
        work.progress(first, message)
        with report.stage("fields"):
            field, sigma_t = _field(plan, channels, network, kept, grids, fields, g, work, report)
            if kept.any_view or whole:
                low, high = field.extent()
            else:
                bounds = [field.bounds(samples.positions(points)) for points in tasks]
                low, high = np.min([b[0] for b in bounds], axis=0), np.max([b[1] for b in bounds], axis=0)
            field.light(sigma_t, sun.direction, low, high, work.each)
            work.check()
        albedos = distinct_albedos(field.medium, channels.indices)
        values = [value for value, _ in albedos]

        def task(points, field=field, g=g, l=l):
            directions = samples.directions[samples.ray[points]]
            light = samples.light.of(points, g, l) if samples.light else None
            return points, field.predict(samples.positions(points), directions, values, samples.jitter(points), light)

        with report.stage("network"):
            for points, radiance in work.map(task, tasks, first, last, message):
                weight = samples.weight[points, None] * (samples.fraction[points][:, group] @ scattered)
                pixel = samples.pixel[samples.ray[points]]
                for (_, members), row in zip(albedos, radiance):
                    for c in members:
                        part = weight[:, c] * row * sun.irradiance[c]
                        added = np.bincount(pixel - pixel[0], part)
                        multiple[pixel[0] : pixel[0] + len(added), c] += added
                        parts[points] += part / 3.0
        report.count("network points", len(inside))
    np.add.at(uncertainty, *samples.standard_error(parts))
