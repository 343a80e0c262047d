# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps whose light camera rays gather, and pixels within which it varies."""

from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..grids.dense_grid import DenseGrid
from ..marching.joined_lamps import PredictedLamp, predicted_lamps
from ..marching.lamp_in_media import LampInMedia
from ..marching.mean_lamp_depth import MeanLampDepth
from ..marching.ray_march import LampMarch
from ..marching.ray_steps import RayBatch
from ..network.albedos import Albedos
from ..network.placed_lights import PlacedLamp, PlacedLamps
from ..numerics.alike import alike_vector
from ..plan.plan import Channels
from ..scene.camera import Camera
from ..scene.camera_rays import image_rays, pixel_size
from ..transport.scattered_fluence import ScatteredFluence
from .context import ChannelPass, PreparedScene, RenderContext

# Pixels whose ray passes a lamp at so many of their widths, from and up to, show the mean over so many rays squared.
AROUND = ((0.0, 0.75, 16), (0.75, 2.5, 4))

# Optical thickness of a voxel up to which a lamp's depths are interpolated between voxels, and most voxels of a volume.
THICKEST_VOXEL, MOST_VOXELS = 0.75, 1 << 25
# Steps in density of a camera ray through the box of a volume, over the voxels along its longest edge.
CROSSED = 0.2

# Where rays, of origins and directions (N, 3) and cosines (N,), meet volumes: near and far (N,).
Intervals = Callable[[np.ndarray, np.ndarray, np.ndarray], tuple[np.ndarray, np.ndarray]]


def prepare_lamp_march(
    context: RenderContext, scene: PreparedScene, channels: Channels, pixels: int = 0
) -> LampMarch | None:
    """The plan's lamps and their scattered light in some colour channels; None without any. Raises Cancelled.

    pixels: whose rays may meet volumes; 0 for other rays than a camera's.
    """
    if not scene.lamps:
        return None
    fluence: list[ScatteredFluence | None] = [None] * len(scene.groups)
    if scene.plan.predicts_lamps:
        with context.report.stage("fields"):
            for g, group in scene.predicted(channels):
                sigma_t = float(group.medium.sigma_t[channels.indices[0]])
                asked = asked_lamps(context, scene, channels, g)
                # Lamps that shine in none of the channels are in no part.
                of_part = {k: number for number, lamps in enumerate(asked) for k in lamps.numbers}
                with context.progress.stage("transport", len(asked)):
                    lights = [lamps.light for lamps in asked]
                    joined = group.predictor.fluence(sigma_t, lights, scene.occluders, context.tasks)
                fluence[g] = joined and joined.of_parts([of_part.get(cell[0], 0) for cell in scene.lamp_cells])
    predicted = any(scattered is not None for scattered in fluence)
    means = _mean_depths(context, scene, channels, pixels)
    return LampMarch(scene.marched_lamps, fluence if predicted else None, scene.lamp_radius, means)


def lamps_nearby(scene: PreparedScene, channels: Channels) -> list[LampInMedia]:
    """Lamps so near a group of volumes that the coarse transport alone is their multiple scattering in it."""
    if not scene.plan.predicts_lamps:
        return []
    near = [
        k
        for g, group in scene.predicted(channels)
        for cluster, lamp in zip(scene.plan.lamp_clusters[g], lamps_of_group(scene, g))
        if group.predictor.transport_share(PlacedLamp(lamp, group.predictor.cube, scene.lamp_radius)) >= 1.0
        for k in cluster
    ]
    return [scene.lamps[k] for k in sorted(set(near))]


def _mean_depths(
    context: RenderContext, scene: PreparedScene, channels: Channels, pixels: int
) -> list[MeanLampDepth | None]:
    """Of each lamp, where that is worth it. Raises Cancelled."""
    media = scene.media(channels, lit=False)
    if len(media) != 1 or "soft_shadows" not in scene.plan.optimizations:
        return [None] * len(scene.marched_lamps)
    means: list[MeanLampDepth | None] = []
    with context.report.stage("shadows"):
        for lamp in scene.marched_lamps:
            wanted = _worthwhile(lamp, media[0], pixels)
            means.append(context.cache.mean_lamp_depth(lamp, media[0], context.tasks) if wanted else None)
            context.report.count("lamps whose shadows are averaged at voxels", wanted)
    return means


def _worthwhile(lamp: PredictedLamp, medium: BoundMedium, pixels: int) -> bool:
    """Whether depths at voxels serve a lamp in a medium alone, and cost less than looking them up on camera rays."""
    grid = medium.grid
    if len(lamp.emitters) == 1 or lamp.shadow_maps is not None or not isinstance(grid.density, DenseGrid):
        return False
    if grid.density.padded.size > MOST_VOXELS or medium.voxel_thickness > THICKEST_VOXEL:
        return False
    return pixels * CROSSED * max(grid.shape) > grid.density.padded.size * min(grid.occupancy.share, 1.0)


@dataclass(frozen=True)
class AskedLamps:
    """Lamps whose light a group of volumes is asked for at once.

    numbers: in the plan. light: of strength 1. strength: (3,), W. albedos: of the group.
    """

    numbers: Sequence[int]
    light: PlacedLamp | PlacedLamps
    strength: np.ndarray
    albedos: Albedos


def asked_lamps(context: RenderContext, scene: PreparedScene, channels: Channels, g: int) -> list[AskedLamps]:
    """The lamps for a group of volumes: the plan's clusters, and those near it together. Raises Cancelled."""
    group, asked, near = scene.groups[g], [], []
    assert group is not None
    predictor, medium, sigma_t = group.predictor, group.medium, float(group.medium.sigma_t[channels.indices[0]])

    def ask(
        numbers: Sequence[int], light: PlacedLamp | PlacedLamps, strength: np.ndarray, indices: Sequence[int]
    ) -> None:
        conditions = scene.occluders, context.tasks, scene.plan.optimizations
        albedos = predictor.albedos(medium, sigma_t, indices, light, *conditions)
        asked.append(AskedLamps(numbers, replace(light, albedos=albedos.values), strength, albedos))

    joins = "distant_lamps" in scene.plan.optimizations
    for cluster, lamp in zip(scene.plan.lamp_clusters[g], lamps_of_group(scene, g)):
        light = PlacedLamp(lamp, predictor.cube, scene.lamp_radius)
        lit = joins and len(cluster) == 1 and scene.plan.lights_group(scene.plan.lamps[cluster[0]], g)
        if lit and predictor.transport_share(light) >= 1.0:
            near.append((cluster[0], light))
        else:
            ask(cluster, light, lamp.power, channels.indices)
    for own, indices, powers in _sums([light.lamp.power for _, light in near], channels.indices):
        numbers, lights, total = [near[n][0] for n in own], [near[n][1] for n in own], powers.sum(axis=0)
        shares = powers.sum(axis=1) / max(float(total.sum()), 1e-300)
        ask(numbers, lights[0] if len(own) == 1 else PlacedLamps(lights, shares.tolist()), total, indices)
    return asked


def _sums(
    powers: Sequence[np.ndarray], channels: Sequence[int]
) -> list[tuple[Sequence[int], Sequence[int], np.ndarray]]:
    """Lamps of powers (3,) in as few sums as possible within each of which all have one colour.

    Of each sum the numbers of the lamps, the colour channels, and the powers in these, (n, 3). Lamps of many
    colours are summed in each channel by itself.
    """
    by_colour: dict[Hashable, list[int]] = {}
    for number, power in enumerate(powers):
        by_colour.setdefault(alike_vector(power / max(float(power.max()), 1e-300)), []).append(number)
    by_channel: dict[Hashable, list[int]] = {}
    for c in channels:
        column = np.array([power[c] for power in powers])
        by_channel.setdefault(alike_vector(column / max(float(column.max(initial=0.0)), 1e-300)), []).append(c)
    if len(by_colour) <= len(by_channel):
        return [(own, channels, np.array([powers[n] for n in own])) for own in by_colour.values()]
    every = np.array(powers)
    return [
        (np.flatnonzero(every[:, own[0]]).tolist(), own, every[every[:, own[0]] > 0.0] * np.isin(range(3), own))
        for own in by_channel.values()
        if every[:, own[0]].any()
    ]


def lamps_of_group(scene: PreparedScene, g: int) -> list[PredictedLamp]:
    """The plan's clusters of lamps for a group of volumes, as one lamp each."""
    volumes = np.concatenate([scene.grids[v].corners() for v in scene.plan.groups[g]])
    middle = 0.5 * (volumes.min(axis=0) + volumes.max(axis=0))
    return predicted_lamps(scene.lamps, scene.plan.lamp_clusters[g], middle)


@dataclass(frozen=True)
class LampMeans:
    """Single scattering of lamps that M rays pass closely, as means over their pixels.

    rays: int (M,), ascending. lamps: bool (M, K), those that each passes. single: (M, V, K, S), as in LampSegment.
    """

    rays: np.ndarray
    lamps: np.ndarray
    single: np.ndarray

    def replace(self, single: np.ndarray, start: int) -> None:
        """Put the means in the place of single scattering (R, V, K, S) of rays from a number on."""
        first, end = np.searchsorted(self.rays, [start, start + len(single)])
        for ray, lamps, mean in zip(self.rays[first:end] - start, self.lamps[first:end], self.single[first:end]):
            single[ray][:, lamps] = mean[:, lamps]


def means_around_lamps(
    scene: PreparedScene,
    channel_pass: ChannelPass,
    camera: Camera,
    batch: RayBatch,
    pixels: tuple[np.ndarray, np.ndarray],
    intervals: Intervals,
) -> list[LampMeans]:
    """Single scattering of lamps in pixels within which it varies; what each gives does not depend on the others.

    batch: R rays. pixels: columns and rows (R,), int, of the image; -1 for rays that stand for no whole pixel. The rays
    within a pixel end where its own does, if that is before the volumes do. Raises Cancelled.
    """
    columns, rows = pixels
    beside = np.full((len(columns), len(scene.marched_lamps)), np.inf)
    for k, lamp in enumerate(scene.marched_lamps):
        away = lamp.centre - batch.origins
        along = (away * batch.directions).sum(axis=1)
        width = np.maximum(pixel_size(camera, np.maximum(along, 0.0)), 1e-30)
        met = (columns >= 0) & (along > batch.near - width) & (along < batch.far + width)
        distance = np.linalg.norm(away - along[:, None] * batch.directions, axis=1)
        beside[met, k] = (distance / width)[met]
    means = []
    for least, most, within in AROUND:
        lamps = (beside >= least) & (beside < most)
        numbers = np.flatnonzero(lamps.any(axis=1))
        x, y = np.meshgrid(*[(np.arange(within) + 0.5) / within] * 2)
        places = (columns[numbers, None] + x.ravel()).ravel(), (rows[numbers, None] + y.ravel()).ravel()
        origins, directions, cosine = image_rays(camera, *places)
        near, far = intervals(origins, directions, cosine)
        _, whole = intervals(batch.origins[numbers], batch.directions[numbers], cosine[:: within**2])
        ends = np.where(batch.far[numbers] < whole, batch.far[numbers], np.inf)
        far = np.minimum(far, np.repeat(ends, within**2))
        single = np.zeros((len(numbers), len(channel_pass.media), lamps.shape[1], len(channel_pass.scattering)))
        for k in np.flatnonzero(lamps.any(axis=0)):
            hit = np.flatnonzero((near < far) & np.repeat(lamps[numbers, k], within**2))
            if len(hit):
                segment = channel_pass.march.of_lamp(k)(RayBatch(origins[hit], directions[hit], near[hit], far[hit]))
                assert segment.lamps is not None
                np.add.at(single[:, :, k], hit // within**2, segment.lamps.single[:, :, 0] / within**2)
        means.append(LampMeans(numbers, lamps[numbers], single))
    return means
