"""Scene in, layer out: camera rays, single scattering, predicted multiple scattering, composed."""

import contextlib
from dataclasses import dataclass, replace
from typing import Optional

import numpy as np

from .camera_march import march_camera_rays
from .glow_image import add_glow
from .images import Images
from .kept import Kept
from .multiple_image import add_multiple, diffuse
from .obstacles import Obstacles
from .plan import make_plan
from .report import Report, process_peak_memory
from .savings import estimated_savings
from .scene import Camera, Settings
from .spread_light import SpreadLight
from .surfaces import Screen
from .work import Work

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
    uncertainty: float32 (H, W) standard error of `multiple` from the choice of depths and from sharing between pixels,
        as a mean over the channels; the network's own error is not in it. With one depth sample nothing tells
        it, and it is at least as large as `multiple`.
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


def empty_layer(camera: Camera) -> Layer:
    """What a camera sees where nothing is."""
    x0, y0, x1, y1 = camera.window
    shape = (y1 - y0, x1 - x0)
    rgb, single, multiple, emission = np.zeros((4, *shape, 3), np.float32)
    alpha, uncertainty = np.zeros((2, *shape), np.float32)
    depth = np.full(shape, np.inf, np.float32)
    return Layer(rgb, alpha, depth, single, multiple, uncertainty, emission, Report(seconds={"total": 0.0}))


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
    if not kept or "unchanged" not in settings.leave_out:
        kept = Kept(any_view=False)
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
    images = Images.black(height * width)
    report.count("pixels", height * width)

    with report.stage("shadows"):
        grids = kept.grids([volume for volume, _ in plan.volumes], plan.suns, work)
    fields, screen, obstacles = {}, None, None
    with report.stage("surfaces"):
        covering = [surface for surface in surfaces if surface.covers]
        if covering and camera.projection != "equirectangular":
            screen = Screen(covering, camera, work.check)
        if surfaces and plan.volumes:
            corners = np.concatenate([grid.corners() for grid in grids])
            obstacles = Obstacles(surfaces, [sun.direction for sun in plan.suns], corners, work.check)
            if len(obstacles.lit) < len(plan.suns) and "needless_suns" in settings.leave_out:
                report.left_out.append(
                    f"{len(plan.suns) - len(obstacles.lit)} suns: surfaces keep all of their light from the volumes")
                # One stays where all are dark, for the single scattering's sake, which is 0.
                lit, multiple = obstacles.lit or [0], [one and bool(obstacles.lit) for one in plan.multiple]
                plan = replace(plan, suns=[plan.suns[n] for n in lit], multiple=multiple)
                grids, obstacles = [grid.of_suns(lit) for grid in grids], obstacles.of_suns(lit)
    wide = [sun for sun in plan.suns if sun.spread is not None]
    phases = [medium.scattered for _, medium in plan.volumes]
    see_ahead = len(covering) == len(surfaces) and (screen is not None or not surfaces)
    spread = SpreadLight(camera, wide, phases, see_ahead, work.check) if wide else None
    report.count("suns", len(plan.suns))
    report.count("suns left out", len(suns) - len(plan.suns))
    with kept.predicting(work) if network or any(plan.scattered_glow) else contextlib.nullcontext():
        for number, channels in enumerate(plan.channels if plan.volumes else []):
            diffused = None
            if network is not None and network.needs_light:
                with report.stage("fields"):
                    diffused = diffuse(plan, channels, network, kept, grids, fields, obstacles, work, report)
            share = 1.0 / len(plan.channels) / len(plan.tiles)
            for tile, (top, bottom) in enumerate(plan.tiles):
                rows = replace(camera, region=(x0, top, x1, bottom))
                start = number / len(plan.channels) + tile * share
                middle = start + share * MARCH_SHARE
                part = images.part(slice((top - y0) * width, (bottom - y0) * width))
                samples = march_camera_rays(
                    plan, channels, grids, rows, screen, obstacles, spread, settings, diffused, work, report, start, middle, part)
                if samples is not None and any(plan.scattered_glow):
                    add_glow(plan, channels, kept, grids, samples, work, report, part.multiple)
                if network is not None and samples is not None:
                    add_multiple(
                        plan, channels, network, kept, grids, fields, obstacles, samples, rows, settings, work,
                        report, middle, start + share, part, whole=len(plan.tiles) > 1)

    report.saved = estimated_savings(report, plan, settings)
    shape = (height, width)
    single, multiple, emission = (
        colour.reshape(*shape, 3) for colour in (images.single, images.multiple, images.emission))
    depth = np.where(images.alpha > 0.0, images.depth / np.maximum(images.alpha, np.float32(1e-30)), np.float32(np.inf))
    return Layer(
        rgb=single + multiple + emission,
        alpha=np.clip(images.alpha, 0.0, 1.0).reshape(shape),
        depth=depth.reshape(shape),
        single=single,
        multiple=multiple,
        uncertainty=images.uncertainty.reshape(shape),
        emission=emission,
        report=report,
    )
