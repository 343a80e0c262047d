# SPDX-License-Identifier: GPL-3.0-or-later
"""Scene in, layer out: the stages of a render in their order."""

import functools
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from .blur.eyes import Eyes, find_eyes
from .blur.shutter import moved_back
from .grids.bound_medium import Flow, Movement, scattering_channels
from .grids.dense_grid import DenseGrid
from .grids.grid import Grid
from .grids.sun_optical_depth import SunOpticalDepth
from .image.camera_pass import add_sharpness, march_tile
from .image.context import ChannelPass, PreparedScene, RenderContext, Tile
from .image.environment_correction import correct_environments
from .image.framebuffer import Framebuffer, Window
from .image.lamp_pass import lamps_nearby, prepare_lamp_march
from .image.layer import Layer, compose_layer
from .image.predicted_error import expected_error
from .image.reflected_light import open_volume, surface_light
from .image.scattered_light import add_scattered_light
from .image.sources import prepare_sources, solve_transport
from .image.work_estimate import WorkEstimate
from .kernels.library import load_kernels
from .marching.extended_lights import ExtendedLights
from .marching.lamp_in_media import LampInMedia, enclosed_warnings
from .marching.marcher import Marcher
from .marching.ray_march import MarchOptions
from .network.interfaces import System
from .occluders.depth_buffer import DepthBuffer, eye_distances
from .occluders.occluders import NO_OCCLUDERS, Occluders, find_occluders
from .occluders.seen_surfaces import vantage
from .outputs.requested import Outputs
from .plan.joined_volumes import find_joins, with_joined
from .plan.lights import without_lamps
from .plan.plan import Channels, Plan, SortedScene, decide, fit_memory, see_sky, sort_lights, sort_scene
from .render_cache import RenderCache, ScatteringGroup
from .runtime.cancellation import CancelToken
from .runtime.progress import Progress
from .runtime.report import Report, process_peak_memory
from .runtime.tasks import Tasks
from .scene.camera import Camera
from .scene.description import Medium, Surface, Volume
from .scene.light import Light
from .scene.settings import Settings
from .scene.sparse_grid import SparseGrid


def render(
    volumes: Sequence[tuple[Volume, Medium]],
    lights: Sequence[Light],
    camera: Camera,
    settings: Settings | None = None,
    progress: Callable[[float, str], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
    cache: RenderCache | None = None,
    surfaces: Sequence[Surface] = (),
) -> Layer:
    """Render volumes lit by suns, lamps and environments.

    volumes: list of (Volume, Medium). lights: list of Sun, PointLight, SpotLight, AreaLight and Environment. progress:
    (fraction, message), called on the calling thread; the fraction is of the time. cancelled: () -> bool, asked several
    times a second. cache: of earlier renders, for what has not changed since; its memory is held until it is dropped.
    surfaces: Surfaces at which camera rays end, for a layer that is put over them (but not those of equirectangular
    cameras), that keep light from the volumes, and whose own light shines into them.

    The same seed gives the same image for any number of threads. Raises SceneError for a scene that cannot be rendered,
    Cancelled when asked to stop.
    """
    # The last is the whole image; the others need not be composed.
    parts = _finished_parts(volumes, lights, camera, settings or Settings(), progress, cancelled, cache, surfaces)
    [(_, compose)] = deque(parts, maxlen=1)
    return compose()


def render_tiles(
    volumes: Sequence[tuple[Volume, Medium]],
    lights: Sequence[Light],
    camera: Camera,
    settings: Settings | None = None,
    progress: Callable[[float, str], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
    cache: RenderCache | None = None,
    surfaces: Sequence[Surface] = (),
) -> Iterator[tuple[tuple[int, int, int, int], Layer]]:
    """As `render`, but yield each part of the image as soon as it is finished.

    Yields ((x0, y0, x1, y1), Layer): the window of the image, rows from the top, and the layer in it, without a report.
    The last one is the whole image, with the report."""
    parts = _finished_parts(volumes, lights, camera, settings or Settings(), progress, cancelled, cache, surfaces)
    for window, compose in parts:
        yield window, compose()


def _finished_parts(
    volumes: Sequence[tuple[Volume, Medium]],
    lights: Sequence[Light],
    camera: Camera,
    settings: Settings,
    progress: Callable[[float, str], None] | None,
    cancelled: Callable[[], bool] | None,
    cache: RenderCache | None,
    surfaces: Sequence[Surface],
) -> Iterator[tuple[Window, Callable[[], Layer]]]:
    """As `render_tiles`, but yield what composes each layer, to be called before the next one is asked for."""
    report = Report()
    with Tasks(settings.threads, CancelToken(cancelled)) as tasks:
        with report.stage("total"):
            if cache is None or "unchanged" not in settings.optimizations:
                cache = RenderCache()
            report.kernels = load_kernels().name
            context = RenderContext(settings, cache, tasks, Progress(progress), report)
            outputs = Outputs(settings.outputs, camera)
            scene = prepare_scene(context, volumes, lights, camera, surfaces, adapts=True)
            x0, y0, x1, y1 = camera.window
            framebuffer = Framebuffer.black((y1 - y0) * (x1 - x0), tasks.each)
            yield from _render_passes(context, scene, framebuffer, outputs)
            if scene.eyes is not None:
                with report.stage("blur"):
                    framebuffer = framebuffer.joined(camera.window, tasks.each)
                    outputs.join(framebuffer.sharpness, tasks.each)
            outputs.add_shadow(context, scene, surfaces)
    context.progress.finish()
    report.planned, report.left_out = scene.plan.planned, scene.plan.left_out
    report.count("pixels", len(framebuffer.alpha))
    report.count("suns", len(scene.plan.suns))
    report.count("environments", len(scene.environments))
    report.count("lamps", len(scene.plan.lamps))
    report.threads, report.peak_memory = tasks.threads, process_peak_memory()

    def compose() -> Layer:
        layer = compose_layer(framebuffer, (y1 - y0, x1 - x0), camera.exposure, report)
        outputs.complete(layer)
        network = scene.network
        tells = scene.uncertainty_network or (network and network.deviation is not None)
        if settings.states_error and tells:
            report.expected_error = expected_error(layer)
        return layer

    yield camera.window, compose


def _render_passes(
    context: RenderContext, scene: PreparedScene, framebuffer: Framebuffer, outputs: Outputs
) -> Iterator[tuple[Window, Callable[[], Layer]]]:
    """Render into the framebuffer; yield the window of each finished tile, and what composes its Layer."""
    if not scene.plan.volumes:
        return
    work, last = WorkEstimate(context, scene), scene.plan.channels[-1]
    for channels in scene.plan.channels:
        channel_pass = _channel_pass(context, scene, channels)
        work.survey(channel_pass)
        for tile in _tiles(context, scene, channel_pass, framebuffer, outputs):
            window = tile.camera.window
            context.report.merge(tile.report, context.tasks.threads)
            work.tile_finished(tile)
            if channels is last:
                yield window, functools.partial(_compose_part, framebuffer, scene.camera, window)


def _compose_part(framebuffer: Framebuffer, camera: Camera, part: Window) -> Layer:
    """The Layer of a part of the window of a camera, whose pixels a framebuffer holds."""
    x0, y0, x1, y1 = part
    return compose_layer(framebuffer.part(camera.window, part), (y1 - y0, x1 - x0), camera.exposure)


def _tiles(
    context: RenderContext,
    scene: PreparedScene,
    channel_pass: ChannelPass,
    framebuffer: Framebuffer,
    outputs: Outputs,
) -> Iterator[Tile]:
    """The tiles of a pass, each rendered on one thread and added to the framebuffer. Raises Cancelled."""

    camera, shown = scene.camera, scene.shown
    told = outputs.of_pass(context, scene, channel_pass) if outputs.wanted else None

    def shade(window: Window) -> Tile:
        tile = Tile.of(camera, window, shown)
        samples = march_tile(context, scene, channel_pass, tile)
        if samples is not None:
            estimates = add_scattered_light(context, sources, tile, samples, outputs.moments)
            if scene.eyes is not None:
                add_sharpness(scene, tile, samples)
            framebuffer.add(camera.window, tile.framebuffer, tile.camera.window)
            if told is not None:
                told.add(tile, samples, estimates)
        return tile

    # Those that show most first, so that no thread waits long for the last one.
    (left, top, *_), tasks = camera.window, context.tasks
    pixels = [shown[y0 - top : y1 - top, x0 - left : x1 - left].sum() for x0, y0, x1, y1 in scene.plan.tiles]
    windows = [scene.plan.tiles[n] for n in np.argsort(pixels, kind="stable")[::-1]]
    # The light of environments is corrected by light paths.
    sources = prepare_sources(context, scene, channel_pass)
    sources = correct_environments(context, scene, channel_pass, sources)
    context.progress.message("single and multiple scattering")
    return tasks.map(shade, windows)


def _channel_pass(context: RenderContext, scene: PreparedScene, channels: Channels) -> ChannelPass:
    """Some colour channels, ready to be marched."""
    fluence = solve_transport(context, scene, channels)
    settings, media = context.settings, scene.media(channels)
    near = lamps_nearby(scene, channels) if scene.lamps and settings.multiple else []
    detail = settings.most_detail if near else 1
    # Rays of several eyes share the depth samples of a pixel. One on each would always be in its middle.
    shared = 1 if scene.eyes is None else max(scene.eyes.rays // 2, 1)
    options = MarchOptions(
        max(-(-settings.depth_samples // shared), min(settings.depth_samples, 2)),
        fluence,
        scene.occluders.shadow_maps,
        scene.plan.groups,
        settings.optimizations,
        scattering=scattering_channels(media, channels.indices),
        most_detail=detail,
        suns=np.array([sun.direction for sun in scene.plan.suns]).reshape(-1, 3),
    )
    lamps = prepare_lamp_march(context, scene, channels, np.count_nonzero(scene.shown))
    march = Marcher(media, options, channels.indices, context.tasks.stopping, lamps)
    return ChannelPass(
        channels=channels,
        media=media,
        march=march,
        scattering=options.scattering,
        near=near,
        most_detail=detail,
        groups=range(len(scene.groups)),
        volumes=range(len(media)),
    )


def prepare_scene(
    context: RenderContext,
    volumes: Sequence[tuple[Volume, Medium]],
    lights: Sequence[Light],
    camera: Camera,
    surfaces: Sequence[Surface] = (),
    adapts: bool = False,
) -> PreparedScene:
    """Plan a scene and prepare what does not depend on the colour channel: the stages up to the coarse transport.

    adapts: whether volumes may become other ones that look about the same.

    Raises SceneError and Cancelled.
    """
    report, settings, cancel, cache = context.report, context.settings, context.cancel, context.cache
    asked = sort_scene(volumes, lights, surfaces)
    asked = _joined(context, asked, camera) if adapts else asked
    placed = sort_lights(asked, see_sky(asked, camera, cancel), settings)
    # Memory is refused before any is taken.
    asked, coarser = fit_memory(asked, placed, camera, settings, adapts)
    report.warn(coarser)
    with report.stage("shadows"):
        grids = cache.grids([volume for volume, _ in asked.volumes], cancel)
    with report.stage("surfaces"):
        covering = [surface for surface in surfaces if surface.covers]
        ends = bool(covering) and camera.projection != "equirectangular"
        eyes = find_eyes(camera, settings.blur_rays)
        depth_buffer = DepthBuffer(covering, camera, cancel) if ends and (eyes is None or settings.outputs) else None
        distances = eye_distances(covering, eyes, camera.window, cancel) if ends and eyes is not None else None
        occluders, lit = NO_OCCLUDERS, list(range(len(placed.suns)))
        if grids:
            corners = np.concatenate([grid.corners() for grid in grids])
            drop_dark = "needless_suns" in settings.optimizations
            occluders, lit = find_occluders(surfaces, placed.suns, corners, drop_dark, cancel)
    plan = decide(scene=asked, lights=placed, lit=lit, camera=camera, settings=settings)
    report.warnings += plan.linking_warnings()
    sun_depths, lamps = _shadows(context, plan, grids, surfaces)
    extended = [sun for sun in plan.suns if sun.spread is not None]
    motion = [] if eyes is None else _movements([volume for volume, _ in plan.volumes], eyes)
    phases = [medium.scattered for _, medium in plan.volumes]
    see_ahead = len(covering) == len(surfaces) and (ends or not surfaces)
    network = _load_network(context, plan)
    cache.keep_groups((1 + (plan.reflects or bool(plan.sky))) * len(plan.groups))
    context.progress.message("preparing volumes")
    groups = _groups(context, plan, grids, network, occluders)
    environment = uncertainty = None
    if network is not None:
        with report.stage("network loading"):
            uncertainty = cache.uncertainty_network(network.name, cancel) if settings.states_error else None
            if plan.from_everywhere:
                environment = cache.environment_network(settings.model, settings.provider, cancel)
    scene = PreparedScene(
        plan=plan,
        camera=camera,
        grids=grids,
        sun_depths=sun_depths,
        occluders=occluders,
        depth_buffer=depth_buffer,
        eyes=eyes,
        eye_distances=distances,
        motion=motion if any(found is not None for found in motion) else (),
        extended_lights=ExtendedLights(camera, extended, phases, see_ahead, cancel) if extended else None,
        groups=groups,
        network=network,
        environments=plan.environments,
        environment_network=environment,
        uncertainty_network=uncertainty,
        lamps=lamps,
    )
    return _with_light_of_surfaces(context, scene, surfaces)


def _movements(volumes: Sequence[Volume], eyes: Eyes) -> list[Movement | None]:
    """How volumes move in front of eyes; None for those that stand still."""
    found: list[Movement | None] = []
    known: dict[int, Sequence[DenseGrid | SparseGrid]] = {}
    for volume in volumes:
        velocity, flow = volume.velocity, None
        if velocity is not None:
            # Instances share them.
            key = id(velocity.components[0])
            known[key] = known.get(key) or Flow.grids_of(velocity)
            flow = Flow(velocity, known[key], np.interp(eyes.times, [0.0, 1.0], velocity.times))
        still = volume.motion is None and flow is None
        found.append(None if still else Movement(moved_back(volume.motion, eyes.times), flow))
    return found


def _joined(context: RenderContext, scene: SortedScene, camera: Camera) -> SortedScene:
    """The scene in which many volumes that overlap are one. Raises Cancelled."""
    joins = find_joins(scene, camera, context.settings)
    wanted = [([scene.volumes[v] for v in join.members], join.name, join.edge) for join in joins]
    with context.report.stage("shadows"):
        return with_joined(scene, joins, context.cache.joined(wanted, context.cancel))


def _shadows(
    context: RenderContext, plan: Plan, grids: Sequence[Grid], surfaces: Sequence[Surface]
) -> tuple[list[list[SunOpticalDepth]], list[LampInMedia]]:
    """Optical depths (V, L) towards suns, and the plan's lamps in their places. Raises Cancelled."""
    voxels = [float(np.prod(volume.density.shape)) for volume, _ in plan.volumes]
    context.progress.expect("shadows", sum(voxels) * len(plan.suns))
    with context.report.stage("shadows"), context.progress.stage("shadows"):
        sun_depths = []
        towards = [sun.direction for sun in plan.suns]
        for grid, (volume, _), octaves, count in zip(grids, plan.volumes, plan.coarser_shadows, voxels):
            context.progress.message(f"shadows of {volume.name}")
            sun_depths.append(grid.sun_depths(towards, octaves, context.cancel))
            context.progress.advance("shadows", count * len(plan.suns))
    with context.report.stage("shadows"):
        context.progress.message("shadows of lamps")
        lamps = context.cache.lamps(plan.lamps, plan.lamp_shares, grids, surfaces, context.cancel) if grids else []
        for lamp in lamps if plan.predicts_lamps else ():
            context.report.warnings += enclosed_warnings(lamp, plan.volumes)
    return sun_depths, lamps


def _groups(
    context: RenderContext, plan: Plan, grids: Sequence[Grid], network: System | None, occluders: Occluders
) -> list[ScatteringGroup | None]:
    """As of PreparedScene. Raises Cancelled."""
    groups: list[ScatteringGroup | None] = []
    with context.report.stage("fields"):
        for g, members in enumerate(plan.groups):
            group = None
            if network is not None and plan.multiple[g]:
                own = [grids[v] for v in members]
                group = context.cache.group(network, plan.members(g), own, g, plan.coarser[g], context.cancel)
                channels = next((channels for channels in plan.channels if plan.predicts(g, channels)), None)
                if channels is not None:
                    sigma_t, name = float(group.medium.sigma_t[channels.indices[0]]), group.volume.name
                    context.report.warnings += group.predictor.warnings(name, group.medium, sigma_t, occluders)
            groups.append(group)
    return groups


def _with_light_of_surfaces(context: RenderContext, scene: PreparedScene, surfaces: Sequence[Surface]) -> PreparedScene:
    """The scene with what surfaces emit and throw back, as environments of their own. Raises Cancelled."""
    plan = scene.plan
    eye = vantage(surfaces, scene.corners, scene.camera) if scene.grids and (plan.reflects or plan.sky) else None
    if eye is None:
        return scene
    # Light that surfaces hide in places ends at them, in the whole medium.
    if all(environment.weight is None for environment in plan.environments):
        scene = replace(scene, open_groups=_open_groups(context, scene, surfaces, eye))
    if not plan.reflects:
        return scene
    with context.report.stage("surfaces"):
        emitted, returned = surface_light(scene, without_lamps(surfaces, plan.lamps), eye, context.cancel)
    found = [environment for environment in (emitted, returned) if environment is not None]
    return replace(scene, environments=[*plan.environments, *found], thrown_back=returned)


def _open_groups(
    context: RenderContext, scene: PreparedScene, surfaces: Sequence[Surface], eye: np.ndarray
) -> list[ScatteringGroup | None]:
    """The scene's groups without what surfaces hide from a place (3,) in them; none where they cut no volume."""
    opened: list[ScatteringGroup | None] = []
    if scene.network is None or not len(scene.occluders.triangles):
        return opened
    stopping, cancel = [surface for surface in surfaces if surface.stops], context.cancel
    for number, group in enumerate(scene.groups, len(scene.groups)):
        if group is None:
            opened.append(None)
            continue
        with context.report.stage("surfaces"):
            visible = open_volume(group.volume, stopping, eye, cancel)
        with context.report.stage("fields"):
            members = [(visible, group.medium)]
            coarser = group.predictor.resolution
            opened.append(context.cache.group(scene.network, members, [], number, coarser, cancel))
    return opened


def _load_network(context: RenderContext, plan: Plan) -> System | None:
    """The network, or None where nothing is predicted."""
    if not any(plan.multiple):
        return None
    report, settings = context.report, context.settings
    with report.stage("network loading"):
        network = context.cache.network(settings.model, settings.provider, context.cancel)
    report.model, report.checksum = network.name, network.checksum
    report.provider = getattr(network, "provider", "CPU")
    report.warnings += getattr(network, "warnings", ())
    return network
