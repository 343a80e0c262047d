# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that surfaces throw back or emit, as volumes see it: an environment of their own.

Every surface that is seen from the middle of the volumes shines with

    L = L_emitted + reflectance / pi * E,

where E is its irradiance by suns, lamps and the sky, behind volumes and other surfaces, and by what volumes scatter.
Their scattered light is that of a ball in their middle that shines alike in all directions: the power that they take
from all light, that of the surfaces included, times the share that leaves them again. Within volumes, the coarse
transport tells what surfaces receive of suns and sky, and a slab of the volume above throws a part of a surface's own
light back to it; of lamps they receive half of what the ball gives. Surfaces light one another as they are seen from
the nearest of some viewpoints in the volumes, through such slabs. All places see surfaces in the directions in which
the middle does, but each place as bright as they are there.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..environments.environment_light import image_in_frame
from ..features.stencil import frames
from ..grids.bound_medium import BoundMedium
from ..grids.grid import Grid
from ..marching.lamp_in_media import LampInMedia
from ..numerics.small_matmul import inverse, product
from ..occluders.lamp_shadow_map import LampShadowMap
from ..occluders.seen_surfaces import SeenPoints, SeenSurfaces, see_surfaces
from ..occluders.shadow_map import ShadowMap
from ..occluders.surface_views import SurfaceViews
from ..plan.directional_lights import directional_lights
from ..plan.lights import DIRECTIONS, linking
from ..plan.plan import distinct_albedos
from ..render_cache import ScatteringGroup
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Medium, Sun, Surface, Volume
from ..scene.environment import Environment, pixel_solid_angles
from ..scene.sparse_grid import SparseGrid
from .context import PreparedScene

# Shadows on surfaces farther away than this many times the size of the volumes are those of volumes alone.
SHADED_REACH = 8.0
# Cells of a shadow map by which points are moved away from their own surface.
CLEARANCE = 3.0
# Surfaces that rise less than this above others, in sizes of the volumes, do not shade them; if the others have more
# planes than this, any may shade them.
FLAT, MAX_PLANES = 1e-3, 64
# Directions from a surface within a volume, of equal shares of the irradiance of even light, in the frame of its
# normal, and points along each at which the density is read.
SLOPES = [
    np.array([np.sqrt(u) * np.cos(angle), np.sqrt(u) * np.sin(angle), np.sqrt(1.0 - u)])
    for u in (1.0 / 6.0, 3.0 / 6.0, 5.0 / 6.0)
    for angle in (np.arange(4) + 2.0 * u) * (np.pi / 2.0)
]
SLAB = 32
# Cells along an edge of each face of the shadow map that tells which voxels surfaces hide.
HIDING = 512
# Points along an edge of each volume at which a sun's shadows are read.
LATTICE = 8
# Times that light between volumes and surfaces, and from surface to surface, is followed.
ROUNDS = 12


@dataclass(frozen=True)
class _Ball:
    """What stands for the volumes where they light surfaces and shade them.

    centre: (3,). radius: in world units. area: (3,), across a beam, of what they take of it. leaving: (3,), share of
    that which leaves them again.
    """

    centre: np.ndarray
    radius: float
    area: np.ndarray
    leaving: np.ndarray

    def form(self, seen: SeenSurfaces) -> np.ndarray:
        """Irradiance (P,) of surfaces by an intensity of 1 W/sr in all directions."""
        away = self.centre - seen.points
        square = np.maximum((away**2).sum(axis=1), 1e-30)
        cosine = np.maximum((away * seen.normals).sum(axis=1), 0.0) / np.sqrt(square)
        return cosine / np.maximum(square, self.radius**2)


def surface_light(
    scene: PreparedScene, surfaces: Sequence[Surface], eye: np.ndarray, cancel: CancelToken = NEVER
) -> tuple[Environment | None, Environment | None]:
    """What surfaces around a place (3,) in a scene's volumes emit, and what they throw back; None where it is black.

    Raises Cancelled.
    """
    seen = see_surfaces(surfaces, eye, cancel)
    if not (seen.reflectance.any() or seen.emission.any()):
        return None, None
    ball, views = _ball(scene), SurfaceViews(seen, eye, scene.corners)
    within = np.stack([_within(grid, seen) for grid in scene.grids])
    inside = within.any(axis=0)
    passed, crossed, thrown_back = _slabs(scene, seen, within)
    irradiance, open_share = _light_within(scene, seen, within, passed, cancel)
    power, lamp_power = np.zeros(3), np.zeros(3)
    form = ball.form(seen)
    shading = shading_surfaces(surfaces, seen, scene.corners)
    plan, names = scene.plan, [surface.name for surface in surfaces]
    # Which lights light each surface, and any of the volumes.
    sunlit, lamplit = (linking(lights, names)[seen.owner] for lights in (plan.suns, plan.lamps))
    sunned, lamped = (plan.linking(lights).any(axis=0) for lights in (plan.suns, plan.lamps))
    for channels in scene.plan.channels:
        c, media = channels.indices, scene.media(channels)
        for number, sun in enumerate(scene.plan.suns):
            cancel.check()
            light = sun_light(sun, seen) * sunlit[:, number]
            light *= sun_visibility(shading, sun, seen, scene.corners, cancel)
            passing = passed_sun(media, number, seen.points, c, inside)
            irradiance[:, c] += light[:, None] * passing * sun.irradiance[c]
            taken = ball.area[c] * sun.irradiance[c] * sunned[number]
            power[c] += taken * _sunlit_share(media, number, scene.occluders.shadow_map(sun))
        for number, lamp in enumerate(scene.lamps):
            cancel.check()
            irradiance[:, c] += lamp_light(lamp, media, seen, c) * lamp.lamp.power[c] * lamplit[:, number, None]
            for channel in c if lamped[number] else ():
                turned = [bound.sigma_t * _turned(bound.medium, channel) for bound in media]
                captured = lamp.captured(scene.grids, turned) * lamp.lamp.power[channel]
                power[channel] += captured
                lamp_power[channel] += captured
    if scene.plan.sky:
        sky, fluence = _sky_light(scene.plan.sky, seen)
        if shading:
            sky *= _sky_visibility(shading, plan.sky, seen, scene.corners, cancel)[:, None]
        # What volumes take from the sky in front of a surface, they take from its irradiance.
        shaded = np.maximum(sky - form[:, None] * ball.area * fluence / (4.0 * np.pi), 0.0)
        irradiance += np.where(inside[:, None], open_share * sky, shaded)
        power += ball.area * _open_fluence(plan.environments)
    irradiance += 0.5 * (form * inside)[:, None] * ball.leaving * lamp_power / (4.0 * np.pi)
    returned = np.zeros_like(irradiance)
    for _ in range(ROUNDS):
        light = seen.emission + returned
        taken = ball.area * views.fluence(light)
        # Volumes in front of a surface take light from it, as from that of the sky, and give their own.
        given = (form * ~inside)[:, None] / (4.0 * np.pi)
        of_others = np.maximum(crossed * views.irradiance(light) - given * taken, 0.0)
        total = (irradiance + of_others) / (1.0 - seen.reflectance * thrown_back)
        returned = seen.reflectance / np.pi * (total + given * ball.leaving * (power + taken))
    emitted = views.environment(seen.emission, "light that surfaces emit")
    return emitted, views.environment(returned, "light that surfaces throw back")


def open_volume(volume: Volume, surfaces: Sequence[Surface], eye: np.ndarray, cancel: CancelToken = NEVER) -> Volume:
    """A volume without what surfaces hide from a point (3,); without its emission. Raises Cancelled."""
    hidden = LampShadowMap(surfaces, eye, HIDING, cancel)
    dense = volume.density.dense() if isinstance(volume.density, SparseGrid) else volume.density
    matrix, density = volume.world_from_index, np.empty_like(dense)
    scattering = [np.array(grid.dense() if isinstance(grid, SparseGrid) else grid) for grid in volume.scattering or ()]
    y, z = np.meshgrid(*(np.arange(n) for n in dense.shape[1:]), indexing="ij")
    across = product(np.stack([y.ravel(), z.ravel()], axis=1), matrix[:3, 1:3].T) + matrix[:3, 3]
    for x, slab in enumerate(dense):
        cancel.check()
        density[x] = slab
        some = np.flatnonzero(slab)
        visible = hidden.visibility(across[some] + x * matrix[:3, 0])
        density[x].reshape(-1)[some] *= visible
        for grid in scattering:
            grid[x].reshape(-1)[some] *= visible
    if not density.any():
        return Volume(dense, volume.world_from_index, volume.name, scattering=volume.scattering)
    return Volume(density, volume.world_from_index, volume.name, scattering=tuple(scattering) or None)


def _ball(scene: PreparedScene) -> _Ball:
    groups: Sequence[ScatteringGroup | None] = scene.open_groups or scene.groups
    area, leaving = np.zeros((2, 3))
    for group in groups:
        if group is None:
            continue
        for c, (sigma_t, albedo) in enumerate(zip(group.medium.sigma_t, group.medium.albedo)):
            kept = _turned_share(albedo, group.medium.anisotropy)
            taken, mean = group.predictor.taken_area(float(sigma_t * kept))
            area[c] += taken
            leaving[c] += taken * _leaving_share(1.0 - (1.0 - albedo) / max(kept, 1e-9), mean)
    radius = 0.25 * float(np.ptp(scene.corners, axis=0).mean())
    middle = 0.5 * (scene.corners.min(axis=0) + scene.corners.max(axis=0))
    return _Ball(middle, radius, area, leaving / np.maximum(area, 1e-30))


def _sunlit_share(media: Sequence[BoundMedium], sun: int, shadow_map: ShadowMap | None) -> float:
    """Of the light that volumes take from a sun, the share that surfaces leave to them."""
    if shadow_map is None:
        return 1.0
    taken, lit = 1e-300, 0.0
    for bound in media:
        index = _lattice(bound.grid)
        light = bound.grid.sample_density(index).astype(np.float64) * bound.sigma_t
        light *= np.exp(-bound.sun_depths[sun](index, bound.sigma_t)) if bound.sigma_t > 0.0 else 1.0
        light *= np.prod(np.ptp(bound.grid.corners(), axis=0))
        points = product(index.T - bound.offset, inverse(bound.linear).T)
        taken += light.sum()
        lit += (light * shadow_map.visibility_at(points)).sum()
    return lit / taken


def _lattice(grid: Grid) -> np.ndarray:
    """Continuous indices float32 (3, N) throughout a grid's support."""
    low, high = grid.box
    along = (np.arange(LATTICE) + 0.5) / LATTICE
    axes = (low + (high - low) * along[:, None]).T
    return np.stack(np.meshgrid(*axes, indexing="ij")).reshape(3, -1).astype(np.float32)


def _within(grid: Grid, seen: SeenSurfaces) -> np.ndarray:
    """Which points of surfaces lie within a volume: bool (P,)."""
    enter, leave = grid.interval(seen.points, seen.normals)
    return (enter <= 0.0) & (leave > 0.0)


def _light_within(
    scene: PreparedScene, seen: SeenSurfaces, within: np.ndarray, passed: np.ndarray, cancel: CancelToken
) -> tuple[np.ndarray, np.ndarray]:
    """Irradiance (P, 3) of surfaces within volumes by suns' scattered light, and share (P, 3) of the sky's that stays.

    within: bool (V, P), points that lie in each volume. passed: (P, 3), share where nothing scatters. Raises Cancelled.
    """
    plan, irradiance, share = scene.plan, np.zeros_like(passed), passed.copy()
    for channels in plan.channels:
        for g, group in scene.predicted(channels):
            some = np.flatnonzero(within[plan.groups[g]].any(axis=0))
            if not len(some):
                continue
            opened = (scene.open_groups[g] if scene.open_groups else None) or group
            suns = [sun for sun in plan.suns if plan.lights_group(sun, g)]
            for albedo, indices in distinct_albedos(group.medium, channels.indices):
                sigma_t, place = float(group.medium.sigma_t[indices[0]]), (some[:, None], np.array(indices))
                surface = opened.predictor.surface_irradiance(seen.points[some], seen.normals[some], sigma_t, albedo)
                for sun in suns:
                    scattered = surface.scattered(sun.direction, scene.occluders.shadow_map(sun), cancel)
                    irradiance[place] += scattered[:, None] * sun.irradiance[indices]
                if plan.environments:
                    share[place] = surface.share(plan.environments, cancel)[:, None]
    return irradiance, share


def _slabs(scene: PreparedScene, seen: SeenSurfaces, within: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Shares (P, 3) of even light that reach surfaces through volumes straight and at all, and of their own that
    volumes throw back.

    Means over directions, of light that does not turn and of what diffusion lets through and reflects in a slab of the
    optical depth along each, with k^2 = 3 (1 - w) and a = 2 k / 3: 4 a / d and (1 - a^2) (exp(k tau) - exp(-k tau)) /
    d, d = (1 + a)^2 exp(k tau) - (1 - a)^2 exp(-k tau). within: as for `_light_within`; 1, 1 and 0 outside.
    """
    depths = np.zeros((len(SLOPES), len(seen.points), 3))
    absorbing, place = np.zeros_like(depths), (np.arange(SLAB) + 0.5) / SLAB
    for grid, (_, medium), some in zip(scene.grids, scene.plan.volumes, map(np.flatnonzero, within)):
        if not len(some):
            continue
        turned, points = frames(seen.normals[some], np.array([0.3, 0.5, 0.8])), seen.points[some]
        for number, slope in enumerate(SLOPES):
            directions = turned @ slope
            _, leave = grid.interval(points, directions)
            way = np.maximum(leave, 0.0)[:, None] * place
            index = grid.index((points[:, None] + way[..., None] * directions[:, None]).reshape(-1, 3))
            column = grid.sample_density(index.T.astype(np.float32)).reshape(way.shape).mean(axis=1) * leave
            for c in range(3):
                kept = _turned_share(medium.albedo[c], medium.anisotropy)
                depths[number, some, c] += column * medium.sigma_t[c] * kept
                absorbing[number, some, c] += column * medium.sigma_t[c] * (1.0 - medium.albedo[c])
    k = np.sqrt(3.0 * np.clip(absorbing / np.maximum(depths, 1e-30), 1e-6, 1.0))
    a, grown = 2.0 * k / 3.0, np.exp(np.minimum(k * depths, 60.0))
    whole = (1.0 + a) ** 2 * grown - (1.0 - a) ** 2 / grown
    returned = np.maximum((1.0 - a * a) * (grown - 1.0 / grown) / whole, 0.0)
    return np.exp(-depths).mean(axis=0), (4.0 * a / whole).mean(axis=0), returned.mean(axis=0)


def _turned(medium: Medium, channel: int) -> float:
    """`_turned_share` of a medium in a colour channel."""
    return float(_turned_share(medium.albedo[channel], medium.anisotropy))


def _turned_share(albedo: np.ndarray, anisotropy: float) -> np.ndarray:
    """Extinction for light that scatters alike in all directions or goes straight on, over the true one: 1 - w G."""
    return 1.0 - albedo * anisotropy


def _leaving_share(albedo: float, depth: float) -> float:
    """The share of the light that volumes take which leaves them again.

    albedo: of scattering that is alike in all directions. depth: a mean optical depth through them, of which light
    leaves 1 / (1 + depth) without another collision, after Wigner's rational approximation.
    """
    free = 1.0 / (1.0 + depth)
    return max(albedo, 0.0) * free / (1.0 - max(albedo, 0.0) * (1.0 - free))


def sun_light(sun: Sun, seen: SeenPoints) -> np.ndarray:
    """Irradiance (P,) of surfaces by a sun of irradiance 1, without what lies in between."""
    directions, shares = (sun.direction[None], np.ones(1)) if sun.spread is None else sun.spread
    return product(np.maximum(product(seen.normals, directions.T), 0.0), shares)


def _sky_light(sky: Sequence[Environment], seen: SeenSurfaces) -> tuple[np.ndarray, np.ndarray]:
    """Irradiance (P, 3) of surfaces by environments, without what lies in between, and their fluence (3,)."""
    image = image_in_frame(sky, np.eye(3))
    rows = len(image)
    angles = np.broadcast_to(pixel_solid_angles(rows), image.shape[:2])
    light = np.broadcast_to(image * angles[..., None], (*image.shape[:2], 3)).reshape(-1, 3)
    towards = Environment(np.zeros((rows, 2 * rows, 3))).directions().reshape(-1, 3)
    normals, number = np.unique(np.round(seen.normals, 3), axis=0, return_inverse=True)
    irradiance = np.concatenate([product(np.maximum(product(towards, normal), 0.0)[None], light) for normal in normals])
    return irradiance[number.reshape(-1)], light.sum(axis=0)


def _open_fluence(environments: Sequence[Environment]) -> np.ndarray:
    """Mean fluence (3,) in the volumes of environments behind surfaces."""
    weights = [1.0 if environment.weight is None else environment.weight.mean for environment in environments]
    return sum((weight * environment.fluence() for weight, environment in zip(weights, environments)), np.zeros(3))


def _sky_visibility(
    shading: Sequence[Surface],
    sky: Sequence[Environment],
    seen: SeenSurfaces,
    corners: np.ndarray,
    cancel: CancelToken,
) -> np.ndarray:
    """Share (P,) of environments' irradiance that surfaces leave to surfaces, by parallel lights. Raises Cancelled."""
    whole, left = np.full(len(seen.points), 1e-30), np.zeros(len(seen.points))
    for sun in (sun for environment in sky for sun in directional_lights(environment, DIRECTIONS)):
        cancel.check()
        # Of a part of the sky around a surface's horizon, the surface itself hides what its middle tells.
        light = sun_light(sun, seen) * sun.irradiance.mean() * (product(seen.normals, sun.direction) > 0.0)
        whole += light
        left += light * sun_visibility(shading, sun, seen, corners, cancel)
    return left / whole


def _passed(
    media: Sequence[BoundMedium],
    depths: Sequence[np.ndarray],
    channels: Sequence[int],
    within: np.ndarray | bool = False,
) -> np.ndarray:
    """Share (N, C) of light that media let through or scatter forwards; depths: optical ones (N,) of each.

    within: bool (N,), where only the phase function's forward peak counts as that, as in the coarse transport.
    """
    total = np.zeros((len(depths[0]), len(channels)))
    for bound, depth in zip(media, depths):
        own, peak = (
            _turned_share(bound.medium.albedo[list(channels)], forward)
            for forward in (bound.medium.anisotropy, bound.medium.anisotropy**2)
        )
        total += depth[:, None] * np.where(np.reshape(within, (-1, 1)), peak, own)
    return np.exp(-total)


def passed_sun(
    media: Sequence[BoundMedium], sun: int, points: np.ndarray, channels: Sequence[int], within: np.ndarray
) -> np.ndarray:
    """As `_passed`, between world points (N, 3) and a sun."""
    depths = [
        bound.sun_depths[sun](bound.grid.index(points).T.astype(np.float32), bound.sigma_t)
        if bound.sigma_t > 0.0
        else np.zeros(len(points))
        for bound in media
    ]
    return _passed(media, depths, channels, within)


def shading_surfaces(surfaces: Sequence[Surface], seen: SeenPoints, corners: np.ndarray) -> list[Surface]:
    """Those of surfaces that may shade seen points, since they are not behind the planes of all of them."""
    shading, middle, size = [surface for surface in surfaces if surface.shades], corners.mean(axis=0), np.ptp(corners)
    offsets = ((seen.points - middle) * seen.normals).sum(axis=1) / size
    planes = np.unique(np.round(np.column_stack([seen.normals, offsets]), 6), axis=0)
    if len(planes) > MAX_PLANES:
        return shading

    def rises(surface: Surface) -> bool:
        corners = (surface.triangles.reshape(-1, 3) - middle) / size
        return bool(np.any(product(corners, planes[:, :3].T) - planes[:, 3] > FLAT))

    return [surface for surface in shading if rises(surface)]


def sun_visibility(
    shading: Sequence[Surface],
    sun: Sun,
    seen: SeenPoints,
    corners: np.ndarray,
    cancel: CancelToken,
) -> np.ndarray:
    """Visibility (P,) of a sun from surfaces; 1 far away from the volumes. Raises Cancelled."""
    direction, blocking = sun.direction, [*(surface.triangles for surface in shading), sun.screen(corners)]
    if not any(map(len, blocking)):
        return np.ones(len(seen.points))
    low, high = corners.min(axis=0), corners.max(axis=0)
    reach = SHADED_REACH * (high - low).max()
    inside = np.all((seen.points > low - reach) & (seen.points < high + reach), axis=1)
    near, visible = np.flatnonzero(inside & (sun_light(sun, seen) > 0.0)), np.ones(len(seen.points))
    if len(near):
        points = seen.points[near]
        ends = np.stack([points.min(axis=0), points.max(axis=0)], axis=1)
        box = np.array(np.meshgrid(*ends, indexing="ij")).reshape(3, -1).T
        shadow_map = ShadowMap(blocking, direction, np.concatenate([box, corners]), cancel)
        cell = 1.0 / np.linalg.norm(shadow_map.linear[0])
        lifted = points + CLEARANCE * cell * seen.normals[near]
        visible[near] = shadow_map.visibility_at(lifted)
    return visible


def lamp_light(
    lamp: LampInMedia, media: Sequence[BoundMedium], seen: SeenPoints, channels: Sequence[int]
) -> np.ndarray:
    """Irradiance (P, C) of surfaces by a lamp of power 1."""
    irradiance = np.zeros((len(seen.points), len(channels)))
    for e, emitter in enumerate(lamp.emitters):
        away = emitter.position - seen.points
        distance = np.maximum(np.linalg.norm(away, axis=1), 1e-30)
        light = emitter.fluence(seen.points) * np.maximum((away * seen.normals).sum(axis=1) / distance, 0.0)
        depths = [
            depth(bound.grid.index(seen.points).T.astype(np.float32), bound.sigma_t)
            for bound, depth in zip(media, lamp.depths[e])
        ]
        if lamp.surface_shadow_maps is not None:
            shadow_map = lamp.surface_shadow_maps[e]
            cell = 2.0 * distance / shadow_map.distances.shape[1]
            light *= shadow_map.visibility(seen.points + (CLEARANCE * cell)[:, None] * seen.normals)
        irradiance += light[:, None] * _passed(media, depths, channels)
    return irradiance
