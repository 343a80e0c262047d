# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene needs: sorted, then decided once what surfaces hide is known."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..models.abilities import abilities
from ..occluders.seen_surfaces import OpenSky, open_sky, vantage
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.camera import Camera
from ..scene.description import Medium, Sun, Surface, Volume
from ..scene.environment import Environment
from ..scene.errors import SceneError
from ..scene.lamps import Lamp
from ..scene.light import Families, Light
from ..scene.mesh_light import MeshLight
from ..scene.optimizations import ALL
from ..scene.settings import Settings
from .coarser import fitting_volumes
from .detail import box_corners, coarser_groups, coarser_shadows, once_per_ray, seen_groups
from .joined_lamps import joined_lamps
from .lights import (
    PredictedSun,
    lamp_shares,
    linked_lights,
    linking,
    mesh_lights,
    predicted_suns,
    reflects_light,
    shining,
    split_lights,
    without_faint,
    without_lamps,
)
from .memory import (
    IMAGE_BYTES,
    SKY_BYTES,
    field_bytes,
    grids_bytes,
    lamp_bytes,
    merged_bytes,
    ray_bytes,
)
from .overlap import group_name, overlapping
from .precision import Rescaled, in_range
from .resolution import BAND, Coarser

# Bands along an edge of a tile, which one thread renders: the larger, the more points per network call. An image is cut
# into so many tiles per thread at least, where it is large enough, that none waits long for the last one; into fewer
# where these would have one band, and for one thread.
TILE_BANDS, TILES_PER_THREAD, SMALL_TILES_PER_THREAD = (8, 4, 2, 1), 6, 2


@dataclass(frozen=True)
class Channels:
    """Colour channels of equal extinction, which are rendered together.

    indices: of the RGB channels. sigma_t: (V,), extinction coefficient of each volume, per unit density and world unit.
    """

    indices: list[int]
    sigma_t: np.ndarray


@dataclass(frozen=True, kw_only=True)
class SceneLights:
    """A scene's lights as they are computed.

    suns: those that contribute, parallel ones merged. environments: light from everywhere, without its peaks. sky: the
    same as they are without surfaces; empty if none hides any of them. lamps: that emit light. lamp_clusters:
    (G,), lamps, by number, that multiple scattering in a group is predicted of at once. lamp_shares: (K,), of
    `lights.lamp_shares`. predicts_lamps: whether the network knows lamps. reflects: whether the light that surfaces
    send into volumes becomes one more environment. planned, left_out: sentences.
    """

    suns: list[Sun]
    environments: list[Environment]
    sky: list[Environment]
    lamps: list[Lamp]
    lamp_clusters: list[list[list[int]]]
    lamp_shares: np.ndarray
    predicts_lamps: bool
    reflects: bool
    planned: list[str]
    left_out: list[str]

    @property
    def from_everywhere(self) -> bool:
        """Whether there is light from everywhere."""
        return bool(self.environments) or self.reflects


@dataclass(frozen=True, kw_only=True)
class Plan(SceneLights):
    """The work that a scene requires, and in words what is done and what is skipped. It never changes.

    volumes: V pairs of Volume and Medium, scaled into the range of single precision. channels: groups of colour
    channels. groups: G groups of volumes, by number, each of which the network treats as one medium. multiple: (G,),
    whether a network predicts in a group. scattered_emission: (G,), whether a group scatters light that it emits.
    coarser: (G,), how finely each group is resolved. once_per_ray: (G,), of the function of that name. coarser_shadows:
    (V,), octaves by which voxels of a volume's shadows are larger than its grid's. optimizations: names of those in
    use, as in Settings. memory: estimated peak in bytes, on top of the input. tiles: windows (x0, y0, x1, y1) of the
    image, each of which one thread renders.
    """

    volumes: list[tuple[Volume, Medium]]
    channels: list[Channels]
    groups: list[list[int]]
    multiple: list[bool]
    scattered_emission: list[bool]
    coarser: list[Coarser]
    once_per_ray: list[bool]
    coarser_shadows: list[int]
    optimizations: frozenset[str]
    memory: int
    tiles: list[tuple[int, int, int, int]]

    def members(self, group: int) -> list[tuple[Volume, Medium]]:
        """Volume and Medium of each volume in a group."""
        return [self.volumes[v] for v in self.groups[group]]

    def linking(self, lights: Sequence[Sun | Lamp], volumes: Sequence[int] | None = None) -> np.ndarray:
        """Whether lights light each of some volumes, by number, or of all: 0 or 1, float64 (V, L)."""
        numbers = range(len(self.volumes)) if volumes is None else volumes
        return linking(lights, [self.volumes[v][0].name for v in numbers])

    def lights_group(self, light: Sun | Lamp, group: int) -> bool:
        """Whether a light lights any volume of a group."""
        return bool(self.linking([light], self.groups[group]).any())

    def linking_warnings(self) -> list[str]:
        """Names lights that are linked to a part of volumes that overlap."""
        lights: list[Sun | Lamp] = [*self.suns, *self.lamps]
        return [
            f"{light.name}: it lights only some of {self.group_name(g)}, which overlap; their multiple scattering is "
            "as if it lit all of them"
            for light in lights
            for g, members in enumerate(self.groups)
            if len(members) > 1 and len(set(self.linking([light], members)[:, 0])) > 1
        ]

    def group_name(self, group: int) -> str:
        """Names of a group's volumes, for messages."""
        return group_name(self.members(group))

    def predicts(self, group: int, channels: Channels) -> bool:
        """Whether multiple scattering is predicted in a group, in some colour channels."""
        return self.multiple[group] and any(
            channels.sigma_t[v] > 0.0 and distinct_albedos(self.volumes[v][1], channels.indices, self.optimizations)
            for v in self.groups[group]
        )

    def predicted_suns(self) -> list[PredictedSun]:
        """The suns, the parts of each soft one together."""
        return predicted_suns(self.suns)


def last_albedo(volume: Volume, medium: Medium) -> np.ndarray:
    """(3,) factor of the scattering that rays gather in a volume: its albedo, unless they have read it from a grid."""
    return medium.albedo if volume.scattering is None else np.ones(3)


def distinct_albedos(
    medium: Medium, indices: list[int], optimizations: frozenset[str] = ALL
) -> list[tuple[float, list[int]]]:
    """Distinct albedos above 0 among some colour channels, with the channels of each.

    Without the optimization "equal_albedos": one albedo per channel, even if it is 0.
    """
    if "equal_albedos" not in optimizations:
        return [(float(medium.albedo[c]), [c]) for c in indices]
    values = sorted({float(medium.albedo[c]) for c in indices if medium.albedo[c] > 0.0})
    return [(value, [c for c in indices if medium.albedo[c] == value]) for value in values]


def merge_parallel(suns: list[Sun]) -> list[Sun]:
    """Merge suns of equal direction that light the same, adding their irradiance; those of an extent are left alone."""
    merged: list[Sun] = []
    for sun in suns:
        for other in merged:
            if sun.is_parallel_to(other):
                other.irradiance = other.irradiance + sun.irradiance
                break
        else:
            merged.append(replace(sun))
    return merged


def emits(volume: Volume, medium: Medium) -> bool:
    """Whether a volume emits light."""
    shines = volume.emission is not None and medium.emission > 0.0
    return shines and any(channel.any() for channel in volume.emission_channels())


def attenuates(volume: Volume, medium: Medium) -> bool:
    """Whether a volume absorbs or scatters light."""
    return bool(np.any(medium.sigma_t > 0.0) and volume.peak > 0.0)


def make_tiles(window: tuple[int, int, int, int], bands: int) -> list[tuple[int, int, int, int]]:
    """A window of the image in tiles of whole bands, row by row; bands: along an edge of a tile."""
    x0, y0, x1, y1 = window
    size = bands * BAND

    def spans(first: int, end: int) -> list[tuple[int, int]]:
        starts = [first, *range(first // BAND * BAND + size, end, size)]
        return list(zip(starts, [*starts[1:], end]))

    return [(left, top, right, bottom) for top, bottom in spans(y0, y1) for left, right in spans(x0, x1)]


@dataclass(frozen=True, kw_only=True)
class SortedScene:
    """What of a scene is rendered, and what lights any of it.

    volumes, groups: as of Plan. lights: of all kinds. glowing: surfaces that are lamps. planned, left_out: sentences.
    """

    volumes: list[tuple[Volume, Medium]]
    groups: list[list[int]]
    lights: list[Light]
    surfaces: Sequence[Surface]
    glowing: list[MeshLight]
    planned: list[str]
    left_out: list[str]

    @property
    def members(self) -> list[list[tuple[Volume, Medium]]]:
        """Volume and Medium of each volume in each group."""
        return [[self.volumes[v] for v in group] for group in self.groups]

    @property
    def corners(self) -> np.ndarray:
        """Corners (N, 3) of the volumes' boxes in the world."""
        return box_corners([volume for volume, _ in self.volumes]).reshape(-1, 3)


def sort_scene(
    volumes: Sequence[tuple[Volume, Medium]], lights: Sequence[Light], surfaces: Sequence[Surface] = ()
) -> SortedScene:
    """Sort what is rendered from what is not.

    Raises SceneError if there is nothing to render, and if a grid is invalid.
    """
    if not volumes:
        raise SceneError("there is no volume to render")
    planned: list[str] = []
    left_out: list[str] = []
    known: Rescaled = {}
    volumes = [in_range(volume, medium, known) for volume, medium in volumes]
    rendered = [pair for pair in volumes if attenuates(*pair) or emits(*pair)]
    for volume, medium in volumes:
        if emits(volume, medium):
            planned.append(f"{volume.name}: emission")
        elif not np.any(medium.sigma_t > 0.0):
            left_out.append(f"{volume.name}: its extinction is 0")
        elif not volume.peak > 0.0:
            raise SceneError(f"{volume.name}: the density grid is zero everywhere")
    names = [volume.name for volume, _ in rendered]
    names += [surface.name for surface in surfaces if surface.reflectance.any()]
    glowing = mesh_lights(surfaces, box_corners([volume for volume, _ in rendered]).reshape(-1, 3)) if rendered else []
    return SortedScene(
        volumes=rendered,
        groups=overlapping(rendered)[0],
        lights=linked_lights([*lights, *glowing], names, left_out),
        surfaces=surfaces,
        glowing=glowing,
        planned=planned,
        left_out=left_out,
    )


def see_sky(scene: SortedScene, camera: Camera, cancel: CancelToken = NEVER) -> OpenSky | None:
    """As `open_sky`, of the volumes, from where the camera sees them; None where no surface hides an environment.

    Raises Cancelled.
    """
    if not (scene.surfaces and scene.volumes and Families.of(scene.lights).environments):
        return None
    eye = vantage(scene.surfaces, scene.corners, camera)
    return open_sky(scene.surfaces, scene.corners, eye, cancel)


def sort_lights(scene: SortedScene, sky: OpenSky | None, settings: Settings) -> SceneLights:
    """As what lights are computed; sky: of `see_sky`."""
    planned: list[str] = []
    left_out: list[str] = []
    unhidden: list[Environment] = []
    surfaces = scene.surfaces
    suns, environments = split_lights(scene.lights, settings, planned, left_out)
    if sky is not None and environments:
        seen = "each point" if sky.visibility else "the middle"
        planned += [f"{environment.name}: as {seen} of the volumes sees it" for environment in environments]
        unhidden, environments = environments, [sky.behind(environment) for environment in environments]
    # Surfaces shadow each part of a soft sun differently.
    if surfaces or not abilities(settings.model).every_light or "soft_suns" not in settings.optimizations:
        suns = [replace(sun, part_of=None) for sun in suns]
    suns, lamps = _needed_suns(suns, settings, left_out), shining(Families.of(scene.lights).lamps, left_out)
    others: list[Sun | Environment] = [*suns, *environments]
    volumes = [volume for volume, _ in scene.volumes]
    boxes = dict(zip([volume.name for volume in volumes], box_corners(volumes)))
    if "faint_lamps" in settings.optimizations:
        lamps = without_faint(lamps, others, boxes, left_out)
    left_out += [
        f"{len(joined.parts) - 1} of {len(joined.parts)} predictions of {joined.sun.name}: one for all of its parts"
        for joined in predicted_suns(suns)
        if len(joined.parts) > 1
    ]
    shared = "soft_shadows" in settings.optimizations
    predicts_lamps = settings.multiple and abilities(settings.model).every_light
    planned += [f"{lamp.name}: shadows and single scattering from its own position" for lamp in lamps]
    clusters = [[[k] for k in range(len(lamps))] for _ in scene.groups]
    if "distant_lamps" in settings.optimizations and len(lamps) > 1:
        members = [[scene.volumes[v][0] for v in group] for group in scene.groups]
        clusters = [joined_lamps(lamps, others, {own.name: boxes[own.name] for own in group}) for group in members]
    if lamps and settings.multiple and not predicts_lamps:
        left_out.append(f"multiple scattering of {len(lamps)} lamps: the network {settings.model} knows suns alone")
    if predicts_lamps:
        left_out += [
            f"{len(lamps) - len(own)} of {len(lamps)} predictions of lamps: one for all from about the same direction"
            for own in clusters
            if len(own) < len(lamps)
        ]
    return SceneLights(
        suns=suns,
        environments=environments,
        lamps=lamps,
        lamp_clusters=clusters,
        lamp_shares=lamp_shares(lamps, others, boxes) if shared else np.ones(len(lamps)),
        predicts_lamps=predicts_lamps,
        reflects=reflects_light(without_lamps(surfaces, scene.glowing), settings, planned, left_out),
        sky=unhidden,
        planned=planned,
        left_out=left_out,
    )


def plan_tiles(
    scene: SortedScene, lights: SceneLights, suns: Sequence[Sun], camera: Camera, settings: Settings
) -> tuple[list[tuple[int, int, int, int]], int]:
    """Tiles of the camera's window, and the bytes that a render needs, estimated; suns: that are rendered."""
    rendered = scene.volumes
    shadows = coarser_shadows(rendered, camera, settings)
    memory = grids_bytes([(volume, emits(volume, medium)) for volume, medium in rendered], suns, shadows)
    members = [of for of, seen in zip(scene.members, seen_groups(scene.members, camera, settings)) if seen]
    groups = [[volume for volume, _ in group] for group in members]
    memory += sum(merged_bytes(group, box_corners(group)) for group in groups if len(group) > 1)
    coarser = coarser_groups(members, bool(lights.lamps), camera, settings)
    memory += field_bytes(groups, coarser, len(suns) + len(lights.lamps), lights.from_everywhere)
    if lights.sky:
        # That of surfaces, and that which they hide in places.
        memory += 2 * SKY_BYTES
    memory += sum(lamp_bytes(volume, lights.lamps) for volume, _ in rendered)
    memory += len(groups) * len(suns) * abilities(settings.model).light_bytes
    depth_samples = settings.depth_samples * (settings.most_detail if lights.lamps and lights.predicts_lamps else 1)
    overlapping = max(map(len, scene.groups), default=1)
    ray = ray_bytes(depth_samples, overlapping, len(suns) + len(lights.lamps))
    x0, y0, x1, y1 = camera.window
    memory += (x1 - x0) * (y1 - y0) * IMAGE_BYTES
    threads, needed = settings.threads or os.cpu_count() or 1, memory
    for bands in TILE_BANDS:
        tiles = make_tiles(camera.window, bands)
        pixels = min(threads, len(tiles)) * _largest(tiles)
        needed = memory + pixels * ray
        wanted = (TILES_PER_THREAD if bands > 2 else SMALL_TILES_PER_THREAD) * threads if threads > 1 else 1
        if len(tiles) >= wanted and needed <= settings.memory_limit:
            break
    return tiles, needed


def fit_memory(
    scene: SortedScene, lights: SceneLights, camera: Camera, settings: Settings, adapts: bool = True
) -> tuple[SortedScene, list[str]]:
    """The scene as `fitting_volumes` makes it fit into the memory limit, and its sentences. Raises as that."""

    def needed(volumes: list[tuple[Volume, Medium]]) -> int:
        return plan_tiles(replace(scene, volumes=volumes), lights, lights.suns, camera, settings)[1]

    volumes, warnings = fitting_volumes(scene.volumes, needed, settings.memory_limit, adapts)
    return replace(scene, volumes=volumes), warnings


def decide(*, scene: SortedScene, lights: SceneLights, lit: Sequence[int], camera: Camera, settings: Settings) -> Plan:
    """The plan of a render; lit: numbers of the suns whose light surfaces let through to the volumes."""
    planned, left_out = [*scene.planned, *lights.planned], [*scene.left_out, *lights.left_out]
    # One sun remains even if all are dark; its single scattering is 0.
    bright = [lights.suns[n] for n in lit]
    suns = bright or lights.suns[:1]
    if len(lit) < len(lights.suns):
        dark = len(lights.suns) - len(lit)
        left_out.append(f"{dark} suns: surfaces shadow the volumes from them completely")
    channels = _channel_groups(scene.volumes, settings)
    if len(channels) == 1:
        left_out.append("two of three color channels: extinction is gray")
    multiple, scattered_emission, unseen = [], [], 0
    for members, seen in zip(scene.members, seen_groups(scene.members, camera, settings)):
        if not seen:
            multiple.append(False)
            scattered_emission.append(False)
            unseen += len(members)
            continue
        directed = [*bright, *(lights.lamps if lights.predicts_lamps else ())]
        linked = lights.from_everywhere or bool(linking(directed, [volume.name for volume, _ in members]).any())
        predicted, scattered = _plan_group(members, linked, settings, planned, left_out)
        # The network for environments predicts their single scattering, too.
        predicted |= lights.from_everywhere and _scatters(members, settings)
        multiple.append(predicted)
        scattered_emission.append(scattered)
    if unseen:
        left_out.append(f"light that volumes outside the picture scatter more than once: {unseen}")
    coarser = coarser_groups(scene.members, bool(lights.lamps), camera, settings)
    tiles, memory = plan_tiles(scene, lights, suns, camera, settings)
    if len(tiles) > 1:
        planned.append(f"{len(tiles)} tiles of up to {_largest(tiles)} pixels")
    changed = {"suns": suns, "planned": planned, "left_out": left_out}
    return Plan(
        **(vars(lights) | changed),
        volumes=scene.volumes,
        channels=channels,
        groups=scene.groups,
        multiple=multiple,
        scattered_emission=scattered_emission,
        coarser=coarser,
        once_per_ray=once_per_ray(scene.members, [own.transport for own in coarser], camera, settings),
        coarser_shadows=coarser_shadows(scene.volumes, camera, settings),
        optimizations=settings.optimizations,
        memory=memory,
        tiles=tiles,
    )


def make_plan(
    volumes: Sequence[tuple[Volume, Medium]],
    lights: Sequence[Light],
    camera: Camera,
    settings: Settings,
    surfaces: Sequence[Surface] = (),
    cancel: CancelToken = NEVER,
) -> Plan:
    """The plan of a scene whose suns all shine on its volumes. Raises as `sort_scene`, `fit_memory`, Cancelled."""
    scene = sort_scene(volumes, lights, surfaces)
    placed = sort_lights(scene, see_sky(scene, camera, cancel), settings)
    scene, warnings = fit_memory(scene, placed, camera, settings)
    scene.left_out.extend(warnings)
    return decide(scene=scene, lights=placed, lit=range(len(placed.suns)), camera=camera, settings=settings)


def _needed_suns(suns: Sequence[Sun], settings: Settings, left_out: list[str]) -> list[Sun]:
    """Suns that emit light, parallel ones merged; adds sentences about the others to `left_out`."""
    if "needless_suns" not in settings.optimizations:
        return list(suns)
    bright = shining(suns, left_out)
    merged = merge_parallel(bright)
    if len(merged) < len(bright):
        left_out.append(f"{len(bright) - len(merged)} suns parallel to another: merged")
    return merged


def _channel_groups(volumes: list[tuple[Volume, Medium]], settings: Settings) -> list[Channels]:
    """Group the channels in which every volume has the same extinction: they share rays, lattices and network calls."""
    groups: list[Channels] = []
    for c in range(3):
        sigma_t = np.array([medium.sigma_t[c] for _, medium in volumes])
        for group in groups:
            if "equal_channels" in settings.optimizations and np.array_equal(group.sigma_t, sigma_t):
                group.indices.append(c)
                break
        else:
            groups.append(Channels([c], sigma_t))
    return groups


def _plan_group(
    members: list[tuple[Volume, Medium]], lit: bool, settings: Settings, planned: list[str], left_out: list[str]
) -> tuple[bool, bool]:
    """Whether multiple scattering is predicted in a group of volumes, and whether it scatters its own emission.

    Adds sentences to `planned` and `left_out`.
    """
    names = group_name(members)
    scatters = _scatters(members, settings)
    predicted = settings.multiple and scatters and lit
    scattered_emission = settings.multiple and scatters and any(emits(*pair) for pair in members)
    if scattered_emission:
        planned.append(f"{names}: scattered emission")
    if not predicted:
        reason = "its albedo or density is 0" if not scatters else "no light shines"
        left_out.append(f"{names}: multiple scattering, {reason if settings.multiple else 'turned off'}")
    elif len(members) > 1:
        planned.append(f"{names}: multiple scattering, as one medium")
    else:
        stages = len(distinct_albedos(members[0][1], [0, 1, 2], settings.optimizations))
        planned.append(f"{names}: multiple scattering" + (f" of {stages} albedos" if stages > 1 else ""))
    return predicted, scattered_emission


def _scatters(members: list[tuple[Volume, Medium]], settings: Settings) -> bool:
    """Whether a group of volumes scatters light."""
    return any(
        attenuates(volume, medium) and bool(distinct_albedos(medium, [0, 1, 2], settings.optimizations))
        for volume, medium in members
    )


def _largest(tiles: list[tuple[int, int, int, int]]) -> int:
    """Pixels of the largest tile."""
    return max((x1 - x0) * (y1 - y0) for x0, y0, x1, y1 in tiles)
