# SPDX-License-Identifier: GPL-3.0-or-later
"""What predicts the multiple scattering of each group of volumes in each light, ready before tiles are rendered."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..marching.depth_samples import DepthSamples
from ..marching.extended_lights import EquivalentDirections
from ..network.albedos import Albedos
from ..network.predictor import Bounds, VolumePredictor
from ..network.prepared_predictors import LampLight, PreparedLampPredictor, PreparedPredictor
from ..network.uncertainty import UncertaintyNetwork
from ..plan.plan import Channels, last_albedo
from ..transport.scattered_fluence import ScatteredFluence
from .context import ChannelPass, PreparedScene, RenderContext
from .lamp_pass import lamps_of_group


@dataclass(frozen=True)
class Source:
    """One group of volumes in the light of one sun, of one lamp or of several at once.

    group: its number. lights: places of the sun's parts, or of the lamps, among those that are rendered together.
    shares: float32 (n,), of the light of each, or at points (N, 3) as (N, n). members: numbers of the group's volumes.
    indices: colour channels that are rendered together. albedos: of these channels. last_albedo: float64 (V, 3), as of
    `plan.last_albedo`, of each of the group's volumes. scattered: float32 (V, 3), that times irradiance, or times the
    lamps' power. places: as for `DepthSamples.scattered`. varies: whether the albedo of any of the volumes does, or
    they differ. suns: how many suns and lamps there are altogether. voxel: shortest edge of the group's voxels.
    prepared: what predicts. directions: in which it sees camera rays; None for lamps. uncertainty: what tells the error
    of predictions, or None.
    """

    group: int
    lights: list[int]
    shares: np.ndarray | Callable[[np.ndarray], np.ndarray]
    members: list[int]
    indices: list[int]
    albedos: Albedos
    last_albedo: np.ndarray
    scattered: np.ndarray
    places: list[int]
    varies: bool
    suns: int
    voxel: float
    prepared: PreparedPredictor | PreparedLampPredictor
    directions: EquivalentDirections | None = None
    uncertainty: UncertaintyNetwork | None = None

    @property
    def needs_detail(self) -> bool:
        """Whether its light varies along rays more than nodes of the depth samples tell."""
        return isinstance(self.prepared, PreparedLampPredictor) and self.prepared.alone

    @functools.cached_property
    def alike(self) -> list[list[int]]:
        """Colour channels by number, those together that scatter the same light."""
        found: dict[tuple, list[int]] = {}
        for channels in self.albedos.channels:
            for c in channels:
                found.setdefault((channels[0], self.places[c], self.scattered[:, c].tobytes()), []).append(c)
        return list(found.values())


def solve_transport(
    context: RenderContext, scene: PreparedScene, channels: Channels, suns: list[int]
) -> list[ScatteredFluence | None] | None:
    """Scattered fluence of each group in which multiple scattering is predicted, of some suns.

    None for networks that need no ray features, without suns and without multiple scattering. Raises Cancelled.
    """
    network = scene.network
    wanted = context.settings.multiple and scene.plan.suns
    if network is None or not network.needs_ray_features or not wanted:
        return None
    joined = scene.plan.predicted_suns(suns)
    joined_suns = [one.sun for one in joined]
    of_part = {part: number for number, one in enumerate(joined) for part in one.parts}
    found: list[ScatteredFluence | None] = [None] * len(scene.groups)
    with context.report.stage("fields"):
        for g, group in scene.predicted(channels):
            sigma_t = float(group.medium.sigma_t[channels.indices[0]])
            with context.progress.stage("transport", len(joined_suns)):
                fluence = group.predictor.fluence(sigma_t, joined_suns, scene.occluders, context.tasks)
            found[g] = fluence and fluence.of_parts([of_part[place] for place in range(len(suns))])
    return found


def prepare_prediction(
    context: RenderContext,
    scene: PreparedScene,
    channel_pass: ChannelPass,
    view: Sequence[DepthSamples],
) -> list[Source]:
    """What predicts the multiple scattering of every group and sun of a pass, and every lamp. Raises Cancelled.

    view: depth samples of all tiles, where lookup lattices are to be built for these alone; empty for those that serve
    any view.
    """
    if not context.settings.multiple:
        return []
    plan, indices = scene.plan, channel_pass.channels.indices
    sources: list[Source] = []
    places = [channel_pass.scattering_place(c) if c in indices else 0 for c in range(3)]
    prepared: PreparedPredictor | PreparedLampPredictor
    for g, group in scene.predicted(channel_pass.channels):
        members, medium = plan.groups[g], group.medium
        sigma_t = float(medium.sigma_t[indices[0]])
        last = np.array([last_albedo(*plan.volumes[v]) for v in members])
        of_group = functools.partial(
            Source,
            group=g,
            members=members,
            indices=indices,
            last_albedo=last,
            places=places,
            varies=group.volume.scattering is not None,
            suns=len(plan.suns) + len(plan.lamps),
            voxel=min(scene.grids[v].voxel for v in members),
            uncertainty=scene.uncertainty_network,
        )
        with context.report.stage("fields"):
            bounds = lattice_bounds(context, members, group.predictor, view)
            for one in plan.predicted_suns(channel_pass.suns):
                sun = one.sun
                if not plan.lights_group(sun, g):
                    continue
                with context.progress.stage("lattices", 1):
                    prepared = group.predictor.prepare(sigma_t, sun, bounds, scene.occluders, context.tasks)
                context.report.count("cells of lookup fields", prepared.lattice_cells)
                context.cancel.check()
                source = of_group(
                    lights=one.parts,
                    shares=one.shares,
                    albedos=group.predictor.albedos(
                        medium,
                        sigma_t,
                        indices,
                        sun,
                        scene.occluders,
                        context.tasks,
                        plan.optimizations,
                    ),
                    scattered=(last * sun.irradiance).astype(np.float32),
                    prepared=prepared,
                    directions=EquivalentDirections(scene.camera, sun, medium.anisotropy, context.cancel),
                )
                sources.append(source)
            if not (channel_pass.lamps and plan.predicts_lamps):
                continue
            for cluster, lamp in zip(plan.lamp_clusters[g], lamps_of_group(scene, g)):
                if not plan.lights_group(plan.lamps[cluster[0]], g):
                    continue
                with context.progress.stage("lattices", 1):
                    albedos = group.predictor.albedos(
                        medium, sigma_t, indices, lamp, scene.occluders, context.tasks, plan.optimizations
                    )
                    light = LampLight(lamp, scene.lamp_radius, albedos.values)
                    prepared = group.predictor.prepare_lamp(sigma_t, light, bounds, scene.occluders, context.tasks)
                context.report.count("cells of lookup fields", prepared.lattice_cells)
                context.cancel.check()
                source = of_group(
                    lights=cluster,
                    shares=lamp.shares,
                    albedos=albedos,
                    scattered=(last * lamp.power).astype(np.float32),
                    prepared=prepared,
                )
                sources.append(source)
    return sources


def lattice_bounds(
    context: RenderContext, members: list[int], predictor: VolumePredictor, view: Sequence[DepthSamples]
) -> Bounds:
    """Lowest and highest (3,), in the cube's frame, of the points for which lookup lattices are built."""
    if "unread_fields" not in context.settings.leave_out:
        return np.full(3, -0.5), np.full(3, 0.5)
    inside = [(samples, np.flatnonzero(samples.share(members))) for samples in view]
    bounds = [predictor.bounds(samples.positions(points)) for samples, points in inside if len(points)]
    if not bounds:
        return predictor.extent()
    return np.min([low for low, _ in bounds], axis=0), np.max([high for _, high in bounds], axis=0)
