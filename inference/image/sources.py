# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimators of each group of volumes in each light, ready before tiles are rendered, and what their light becomes."""

import functools
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..marching.extended_lights import EquivalentDirections
from ..network.albedos import Albedos
from ..network.conditions import PredictedLight
from ..network.estimators import (
    EmissionEstimator,
    EnvironmentEstimator,
    Estimator,
    LightEstimator,
    LitPoints,
    Quantity,
    Turn,
)
from ..network.placed_lights import PlacedLamp, PlacedLamps, PlacedSkies, PlacedSun
from ..plan.lights import PredictedSun
from ..plan.plan import Channels, last_albedo
from ..render_cache import ScatteringGroup
from ..scene.camera import Camera
from ..scene.environment import Environment
from ..transport.scattered_fluence import ScatteredFluence
from .context import ChannelPass, PreparedScene, RenderContext
from .lamp_pass import asked_lamps
from .predicted_error import SCATTERED_EMISSION, environment_deviation


@dataclass(frozen=True)
class Row:
    """One quantity of a source's light, and the colour channels in which it is the same.

    once: whether the light scatters for the first time. albedo: float32 (V,), of the last scattering in each of the
    volumes. scattered: the same times the light's strength. place: as for `DepthSamples.scattered`. relative: standard
    deviation of its error over it, where no network tells it.
    """

    once: bool
    channels: list[int]
    albedo: np.ndarray
    scattered: np.ndarray
    place: int
    relative: float

    @property
    def quantity(self) -> Quantity:
        """As which an estimator tells it."""
        return self.once, self.channels[0]


@dataclass(frozen=True)
class Source:
    """One group of volumes in one light, or one volume of it, or several groups of one volume each that are alike.

    groups: their numbers, ascending. members: numbers of the volumes. frames: float64 (G, 4), of several groups:
    factors of world positions and what is added to them, for which the estimator is asked about the first. rows: of
    its light. varies: whether the albedo of any of the volumes does, or they differ. voxel: shortest edge of the
    group's voxels. lights: how many suns and lamps share the single scattering that tells where its light varies; 0
    where that does not tell. needs_detail: whether its light varies along rays more than nodes of the depth samples
    tell. masked: whether the light of earlier sources hides its errors. once_per_ray: whether it is told once for
    all depth samples of a ray in a group.
    """

    groups: Sequence[int]
    members: Sequence[int]
    estimator: Estimator
    rows: list[Row]
    varies: bool
    voxel: float
    frames: np.ndarray | None = None
    lights: float = 0
    needs_detail: bool = False
    masked: bool = False
    once_per_ray: bool = False

    @cached_property
    def albedos(self) -> np.ndarray:
        """float32 (V, K), of the rows."""
        return np.stack([row.albedo for row in self.rows], axis=1)

    @cached_property
    def scattered(self) -> np.ndarray:
        """float32 (V, K), of the rows."""
        return np.stack([row.scattered for row in self.rows], axis=1)

    @property
    def places(self) -> list[int]:
        """Of the rows."""
        return [row.place for row in self.rows]

    @property
    def tells_single(self) -> bool:
        """Whether its estimator tells single scattering, too."""
        return any(row.once for row in self.rows)

    def corrected(self, factors: np.ndarray) -> "Source":
        """The source with factors (3,) of its light in each colour channel."""
        rows = [
            replace(row, scattered=(row.scattered * factors[row.channels[0]]).astype(np.float32)) for row in self.rows
        ]
        return replace(self, rows=rows)

    def within(self, volumes: Collection[int]) -> "Source":
        """What of several groups lies in some volumes, by number."""
        if self.frames is None:
            return self
        here = np.flatnonzero(np.isin(self.members, list(volumes)))
        rows = [replace(row, albedo=row.albedo[here], scattered=row.scattered[here]) for row in self.rows]
        groups, members = ([numbers[n] for n in here] for numbers in (self.groups, self.members))
        return replace(self, groups=groups, members=members, rows=rows, frames=self.frames[here])

    @property
    def channels(self) -> int:
        """How many channels its rows stand for, each quantity counted by itself."""
        return sum(len(row.channels) for row in self.rows)

    def combined(self, rows: np.ndarray) -> Iterator[np.ndarray]:
        """What has to be smooth (P,) of rows (K, P): one light, or where colours differ that of each of them."""
        if not (self.varies or self.estimator.coloured):
            yield self.mean(rows)
            return
        for channels in dict.fromkeys(tuple(row.channels) for row in self.rows):
            alike = [number for number, row in enumerate(self.rows) if tuple(row.channels) == channels]
            yield rows[alike].mean(axis=0)

    def mean(self, rows: np.ndarray) -> np.ndarray:
        """Mean (P,) over all channels of rows (K, P)."""
        return sum(len(row.channels) / self.channels * values for row, values in zip(self.rows, rows))


@dataclass(frozen=True)
class AskedGroup:
    """A group of volumes whose light is asked for in some colour channels.

    number: of the group. places: of each of the three channels, as for `DepthSamples.scattered`. camera: on whose
    rays they are, or None. like: numbers of all groups that are told together, as of `PreparedScene.alike`; the group
    alone without. Methods raise Cancelled.
    """

    context: RenderContext
    scene: PreparedScene
    number: int
    channels: Channels
    places: Sequence[int]
    camera: Camera | None = None
    like: Sequence[int] = ()

    @property
    def group(self) -> ScatteringGroup:
        """What its volumes are to networks."""
        group = self.scene.groups[self.number]
        assert group is not None
        return group

    @property
    def sigma_t(self) -> float:
        """Its extinction."""
        return float(self.group.medium.sigma_t[self.channels.indices[0]])

    def suns(self) -> Iterator[Source]:
        """Of all suns, the parts of a soft one together."""
        for predicted in self.scene.plan.predicted_suns():
            if self.scene.plan.lights_group(predicted.sun, self.number):
                light = PlacedSun(predicted.sun, self.group.predictor.cube, self.scene.occluders)
                anisotropy, cancel = self.group.medium.anisotropy, self.context.cancel
                asked = self.group.medium, self.sigma_t, self.channels.indices, light, self.scene.occluders
                yield self._predicted(
                    light,
                    self.group.predictor.albedos(*asked, self.context.tasks, self.scene.plan.optimizations),
                    strength=predicted.sun.irradiance,
                    features=functools.partial(features_of_sun, predicted),
                    turn=EquivalentDirections(self.camera, predicted.sun, anisotropy, cancel),
                )

    def lamps(self) -> list[Source]:
        """Of all lamps, some of them joined: the brightest first, which mask errors of others."""
        scene, middle, bright = self.scene, self.group.predictor.cube.centre[None], []
        for asked in asked_lamps(self.context, scene, self.channels, self.number):
            if not scene.plan.lights_group(scene.plan.lamps[asked.numbers[0]], self.number):
                continue
            light = asked.light
            cells = {n: cell for n, cell in enumerate(scene.lamp_cells) if set(cell) & set(asked.numbers)}
            parts = [[asked.numbers.index(k) for k in cell] for cell in cells.values()]
            source = self._predicted(
                light,
                asked.albedos,
                strength=asked.strength,
                features=functools.partial(features_of_lamps, light, list(cells), parts),
                turn=lambda directions, image: directions,
                lamp_depths=functools.partial(depths_of_lamps, list(cells)) if light.apart else None,
            )
            source = replace(source, lights=source.lights / (len(cells) if light.apart else 1), masked=True)
            bright.append((float(light.irradiance(middle)[0] * asked.strength.mean()), source))
        bright.sort(key=lambda pair: -pair[0])
        return [source for _, source in bright]

    def _predicted(
        self,
        light: PredictedLight,
        albedos: Albedos,
        *,
        strength: np.ndarray,
        features: Callable[[LitPoints], np.ndarray | None],
        turn: Turn,
        lamp_depths: Callable[[LitPoints], np.ndarray | None] | None = None,
    ) -> Source:
        """strength, features, turn, lamp_depths: as of LightEstimator."""
        context, scene, predictor = self.context, self.scene, self.group.predictor
        with context.progress.stage("lattices", 1):
            prepared = predictor.prepare(self.sigma_t, light, scene.occluders, context.tasks)
        estimator = LightEstimator(
            strength=strength,
            albedos=albedos,
            predictor=prepared,
            features=features,
            irradiance=light.irradiance,
            turn=turn,
            lamp_depths=lamp_depths,
            uncertainty=scene.uncertainty_network,
        )
        context.cancel.check()
        lights = len(scene.plan.suns) + len(scene.plan.lamps)
        return self._source(estimator, self._model_error, lights=lights, needs_detail=prepared.alone)

    def environments(self, environments: Sequence[Environment]) -> Source:
        """Of environments together."""
        context, scene, indices = self.context, self.scene, self.channels.indices
        context.progress.message(f"light from everywhere in {scene.plan.group_name(self.number)}")
        assert scene.environment_network is not None
        # The light of surfaces begins at them: what they hide neither dims nor scatters it.
        opened = scene.opened(self.number)
        assert opened is not None
        with context.progress.stage("lattices", 1):
            predictor = opened.predictor.prepare_environment(
                scene.environment_network, environments, self.sigma_t, scene.occluders, context.tasks
            )
        context.cancel.check()
        albedos = opened.predictor.albedos(
            self.group.medium,
            self.sigma_t,
            indices,
            PlacedSkies(environments, opened.predictor.cube),
            tasks=context.tasks,
            optimizations=scene.plan.optimizations,
        )
        return self._source(EnvironmentEstimator(indices, albedos, predictor), environment_deviation)

    def _model_error(self, albedo: float) -> float:
        network = self.scene.network
        return (network and network.deviation) or 0.0

    def _source(
        self, estimator: Estimator, relative: Callable[[float], float], lights: int = 0, needs_detail: bool = False
    ) -> Source:
        """relative: standard deviation of the error over the light, of an albedo."""
        groups = self.like or [self.number]
        members = [v for g in groups for v in self.scene.plan.groups[g]]
        varies = self.group.volume.scattering is not None
        return Source(
            groups=groups,
            members=members,
            frames=self._frames() if len(groups) > 1 else None,
            estimator=estimator,
            rows=rows_of(self.scene, members, estimator, self.places, relative),
            varies=varies,
            voxel=min(self.scene.grids[v].voxel for v in members),
            lights=lights,
            needs_detail=needs_detail,
            once_per_ray=estimator.varies_slowly
            and not varies
            and all(self.scene.plan.once_per_ray[g] for g in groups),
        )

    def _frames(self) -> np.ndarray:
        """As of Source."""
        groups = [self.scene.groups[g] for g in self.like]
        cubes, own = [group.predictor.cube for group in groups if group is not None], self.group.predictor.cube
        factors = own.edge / np.array([[cube.edge] for cube in cubes])
        return np.hstack([factors, own.centre - factors * np.array([cube.centre for cube in cubes])])


def features_of_sun(sun: PredictedSun, points: LitPoints) -> np.ndarray | None:
    """What rays have gathered of a sun at points, float32 (N, COLUMNS); None where they have not."""
    gathered = points.suns
    return None if gathered is None else gathered.mean(points.places, points.group, sun.parts, sun.shares)


def features_of_lamps(
    light: PlacedLamp | PlacedLamps, cells: Sequence[int], parts: Sequence[Sequence[int]], points: LitPoints
) -> np.ndarray | None:
    """As `features_of_sun`, of lamps in some cells, by number; parts: which of them are in each cell."""
    gathered, shares = points.lamps, np.ones((1, len(parts)))
    if gathered is None:
        return None
    if len(parts) > 1:
        of_lamps = light.shares(points.positions)
        shares = np.stack([of_lamps[:, part].sum(axis=1) for part in parts], axis=1)
    return gathered.mean(points.places, points.group, cells, shares)


def depths_of_lamps(cells: Sequence[int], points: LitPoints) -> np.ndarray | None:
    """Optical depths float32 (K, N) at points towards the lamp in each of K cells; None where rays gathered none."""
    return None if points.lamps is None else points.lamps.values[points.places, points.group][:, cells, 0].T


def rows_of(
    scene: PreparedScene,
    members: Sequence[int],
    estimator: Estimator,
    places: Sequence[int],
    relative: Callable[[float], float],
) -> list[Row]:
    """What an estimator tells of some volumes, once for channels that scatter the same light.

    places: of each of the three channels. relative: as for `AskedGroup`.
    """
    last = np.array([last_albedo(*scene.plan.volumes[v]) for v in members])
    scattered = (last * estimator.strength).astype(np.float32)
    alike: dict[tuple, list[int]] = {}
    for once, channels in estimator.quantities:
        for c in channels:
            alike.setdefault((once, channels[0], places[c], scattered[:, c].tobytes()), []).append(c)
    return [
        Row(
            once=once,
            channels=channels,
            albedo=last[:, channels[0]].astype(np.float32),
            scattered=scattered[:, channels[0]],
            place=place,
            relative=float(relative(float(last[:, channels[0]].mean()))),
        )
        for (once, _, place, _), channels in alike.items()
    ]


def solve_transport(
    context: RenderContext,
    scene: PreparedScene,
    channels: Channels,
    groups: Sequence[int] | None = None,
) -> list[ScatteredFluence | None] | None:
    """Scattered fluence of each group in which multiple scattering is predicted, or of some groups, of the suns.

    None for networks that read no ray features, without suns and without multiple scattering. Raises Cancelled.
    """
    if scene.network is None or not (context.settings.multiple and scene.plan.suns):
        return None
    joined = scene.plan.predicted_suns()
    of_part = {part: number for number, predicted in enumerate(joined) for part in predicted.parts}
    fluences: list[ScatteredFluence | None] = [None] * len(scene.groups)
    with context.report.stage("fields"):
        for like in scene.alike(channels) if groups is None else [[g] for g in groups]:
            group = scene.groups[like[0]]
            assert group is not None
            sigma_t = float(group.medium.sigma_t[channels.indices[0]])
            with context.progress.stage("transport", len(joined)):
                lights = [PlacedSun(predicted.sun, group.predictor.cube, scene.occluders) for predicted in joined]
                fluence = group.predictor.fluence(sigma_t, lights, scene.occluders, context.tasks)
            if fluence is None:
                continue
            fluence = fluence.of_parts([of_part[place] for place in range(len(scene.plan.suns))])
            for g in like:
                of_group = scene.groups[g]
                assert of_group is not None
                fluences[g] = fluence if g == like[0] else fluence.placed(of_group.predictor.cube)
    return None if all(fluence is None for fluence in fluences) else fluences


def prepare_sources(context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass) -> list[Source]:
    """What tells the light of every group in every light of a pass. Raises Cancelled."""
    plan, indices = scene.plan, channel_pass.channels.indices
    places = [channel_pass.scattering_place(c) if c in indices else 0 for c in range(3)]
    sources = prepare_emission(context, scene, channel_pass, places)
    groups = [
        AskedGroup(
            context=context,
            scene=scene,
            number=like[0],
            channels=channel_pass.channels,
            places=places,
            camera=scene.camera,
            like=like,
        )
        for like in scene.alike(channel_pass.channels)
    ]
    with context.report.stage("fields"):
        for group in groups if context.settings.multiple else ():
            sources += group.suns()
            if scene.lamps and plan.predicts_lamps:
                sources += group.lamps()
        if scene.environment_network is not None:
            sources += [group.environments(scene.environments) for group in groups]
    return sources


def prepare_emission(
    context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, places: Sequence[int]
) -> list[Source]:
    """What tells the light that volumes emit and scatter. Raises Cancelled."""
    plan, sources = scene.plan, []
    for g, members in enumerate(plan.groups):
        if not plan.scattered_emission[g]:
            continue
        with context.report.stage("emission"):
            emission = context.cache.scattered_emission(
                plan.members(g), [scene.grids[v] for v in members], g, context.cancel
            )
        context.report.warn(emission.warnings(plan.group_name(g)))
        for v in members:
            volume, medium = plan.volumes[v]
            estimator = EmissionEstimator(channel_pass.channels.indices, emission, medium.anisotropy)
            source = Source(
                groups=[g],
                members=[v],
                estimator=estimator,
                rows=rows_of(scene, [v], estimator, places, lambda albedo: SCATTERED_EMISSION),
                varies=volume.scattering is not None,
                voxel=scene.grids[v].voxel,
            )
            sources.append(source)
    return sources
