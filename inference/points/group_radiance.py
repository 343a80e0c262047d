# SPDX-License-Identifier: GPL-3.0-or-later
"""The light that one group of volumes scatters at any points, towards any direction."""

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..image.context import PreparedScene, RenderContext
from ..image.lamp_pass import prepare_lamp_march
from ..image.sources import AskedGroup, Source, solve_transport
from ..marching.depth_samples import entry_point
from ..marching.marcher import Marcher
from ..marching.ray_features import COLUMNS, RayFeatures
from ..marching.ray_march import LampMarch, MarchOptions, RaySegment
from ..marching.ray_steps import RayBatch
from ..network.estimators import LitPoints
from ..network.predictor import POINTS_PER_TASK
from ..plan.plan import Channels
from ..transport.scattered_fluence import ScatteredFluence

#: Steps of a ray from a point, about, by which the progress of marching is counted.
STEPS_PER_POINT = 60.0


class GroupRadiance:
    """The light that one group of volumes scatters, ready to be evaluated. Raises Cancelled.

    g: number of the group. channels: in which. Light that scatters for the first time is left out but for that which
    surfaces throw back, since renderers leave it out that end paths there.
    """

    def __init__(self, context: RenderContext, scene: PreparedScene, g: int, channels: Channels) -> None:
        plan = scene.plan
        self._context, self._scene, self._members = context, scene, plan.groups[g]
        self._channels = channels
        asked = AskedGroup(context=context, scene=scene, number=g, channels=channels, places=(0, 0, 0))
        returned = scene.thrown_back
        skies = [environment for environment in scene.environments if environment is not returned]
        context.progress.message(f"multiple scattering of {plan.group_name(g)}")
        fluence = solve_transport(context, scene, channels, [g])
        lamps = prepare_lamp_march(context, scene, channels) if scene.lamps and plan.predicts_lamps else None
        with context.report.stage("fields"):
            self.sources = list(asked.suns())
            if lamps is not None:
                self.sources += asked.lamps()
            if scene.environment_network is not None and skies:
                self.sources.append(asked.environments(skies))
            self._returned: Source | None = None
            if scene.environment_network is not None and returned is not None:
                self._returned = asked.environments([returned])
        own = None if lamps is None else self._of_group(lamps, g)
        self._march = self._begin = None
        if fluence is not None or own is not None:
            self._march, self._begin = (
                self._prepare_march(None if fluence is None else fluence[g], own, at_start)
                for at_start in (False, True)
            )
        self._through = self._prepare_march(None, None)

    def _of_group(self, lamps: LampMarch, g: int) -> LampMarch:
        """Lamps as the group alone knows them."""
        assert lamps.fluence is not None
        own = [lamp.within(self._members) for lamp in lamps.lamps]
        return replace(lamps, lamps=own, fluence=[lamps.fluence[g]])

    def _media(self, lit: bool) -> list[BoundMedium]:
        media = self._scene.media(self._channels, lit)
        return [media[v] for v in self._members]

    def _prepare_march(
        self, fluence: ScatteredFluence | None, lamps: LampMarch | None, at_start: bool = False
    ) -> Marcher:
        """Marches rays from points outwards through the group alone."""
        context, lit = self._context, fluence is not None
        # Every ray needs its features at its start, however faint it is.
        options = MarchOptions(
            depth_samples=1,
            fluence=[fluence] if lit else None,
            shadow_maps=self._scene.occluders.shadow_maps if lit else None,
            groups=[list(range(len(self._members)))],
            optimizations=context.settings.optimizations - {"faint_rays"},
            quadrature=entry_point,
            at_start=at_start,
        )
        indices, stopping = self._channels.indices, context.tasks.stopping
        return Marcher(self._media(lit), options, indices, stopping, lamps)

    def __call__(self, positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Radiance float32 (3, N) that an albedo of 1 scatters towards the camera.

        positions, directions: float64 (N, 3) in the world, points with density and unit directions of camera rays.
        Channels other than those asked for are 0. Raises Cancelled.
        """
        context, parts = self._context, spans(len(positions))
        points = self._gathered(positions, directions)
        starts = [part.start for part in parts]
        radiance = np.zeros((3, len(positions)), np.float32)
        for source in self._all:
            with context.report.stage("network"), context.progress.stage("network"):
                for start, told in zip(starts, self._told(source, points, parts)):
                    for row in source.rows:
                        if row.quantity in told and (not row.once or source is self._returned):
                            values = told[row.quantity]
                            for c in row.channels:
                                strength = np.float32(source.estimator.strength[c])
                                radiance[c, start : start + len(values)] += values * strength
                    context.progress.advance("network", len(next(iter(told.values()), ())))
            context.report.count("network points", len(positions))
        return radiance

    @property
    def work(self) -> dict[str, float]:
        """What of each stage of the progress a point takes, about."""
        around = [source.estimator.needs_depths for source in self._all]
        return {"march": STEPS_PER_POINT * (2 * any(around) + (not all(around))), "network": len(around)}

    @property
    def parts(self) -> "tuple[GroupRadiance | None, GroupRadiance | None]":
        """Of lights, and of environments, each None where there are none of these."""
        found = []
        for skies in (False, True):
            part = copy.copy(self)
            part.sources = [source for source in self.sources if source.estimator.needs_depths == skies]
            part._returned = self._returned if skies else None
            found.append(part if part._all else None)
        return found[0], found[1]

    def unscattered(self, positions: np.ndarray) -> np.ndarray:
        """Light (N,) that arrives at world positions (N, 3) without scattering, about. Raises Cancelled."""
        points = self._gathered(positions, np.broadcast_to([0.0, 0.0, 1.0], positions.shape).copy(), brief=True)
        return np.sum([source.estimator.unscattered(points) for source in self._all], axis=0)

    @property
    def _all(self) -> list[Source]:
        return [*self.sources, *([self._returned] if self._returned else [])]

    def _told(self, source: Source, points: LitPoints, parts: Sequence[np.ndarray | slice]) -> Iterator[dict]:
        """Yield what a source tells of each part of the points."""
        estimator = source.estimator

        def task(part: np.ndarray | slice) -> dict:
            some = points.take(part)
            return estimator.radiance(estimator.predict(some), some)

        return self._context.tasks.map(task, parts)

    def _gathered(self, positions: np.ndarray, directions: np.ndarray, brief: bool = False) -> LitPoints:
        """Points with what estimators read of their rays; the arguments are as for a call."""
        points, count = LitPoints(positions, directions), len(positions)
        march = self._begin if brief else self._march
        if march is not None and count and any(not source.estimator.needs_depths for source in self._all):
            # Where a ray meets no density, nothing lies ahead.
            suns, lamps = (
                np.zeros((count, 1, lights, COLUMNS), np.float32)
                for lights in (len(self._scene.plan.suns), len(self._scene.marched_lamps))
            )

            def keep(first: int, segment: RaySegment) -> None:
                ray = first + segment.sample_ray
                if segment.sample_features is not None:
                    suns[ray] = segment.sample_features.values
                if segment.lamps is not None and segment.lamps.features is not None:
                    lamps[ray] = segment.lamps.features.values

            self._follow(march, positions, directions, keep, brief)
            points = replace(points, suns=RayFeatures(suns), lamps=RayFeatures(lamps))
        if any(source.estimator.needs_depths for source in self._all):
            along = np.zeros((count, 2), np.float32)
            for column, towards in enumerate((directions, -directions)):

                def measure(first: int, segment: RaySegment, column: int = column) -> None:
                    depth = segment.optical_depth.sum(axis=1)
                    along[first : first + len(depth), column] = depth

                self._follow(self._through, positions, towards, measure)
            points = replace(points, depths=along)
        return points

    def _follow(
        self,
        march: Marcher,
        positions: np.ndarray,
        directions: np.ndarray,
        keep: Callable[[int, RaySegment], None],
        brief: bool = False,
    ) -> None:
        """March rays outwards; keep: takes the number of the first ray and what each batch gathered."""
        context = self._context
        batch = rays_outwards(self._media(False), positions, directions)
        if brief:
            shortest = min(medium.grid.voxel for medium in self._media(False))
            batch = replace(batch, far=np.minimum(batch.far, shortest))

        def task(span: slice) -> tuple[int, RaySegment]:
            rays = batch.take(span)
            return span.start, march.march_steps(rays, np.ones(len(rays.near), int)) if brief else march(rays)

        with context.report.stage("march"), context.progress.stage("march"):
            for first, segment in context.tasks.map(task, spans(len(positions))):
                keep(first, segment)
                context.report.count("steps evaluated", segment.steps_evaluated)
                context.progress.advance("march", 0.0 if brief else STEPS_PER_POINT * len(segment.alpha))


def rays_outwards(media: Sequence[BoundMedium], positions: np.ndarray, directions: np.ndarray) -> RayBatch:
    """Rays from points (N, 3) along directions (N, 3) to the ends of some media."""
    ends = [medium.grid.interval(positions, directions)[1] for medium in media if medium.matters]
    # Points at the very end of a volume have nothing ahead of them.
    least = 1e-6 * min(medium.grid.voxel for medium in media)
    return RayBatch(positions, directions, np.zeros(len(positions)), np.maximum(np.max(ends, axis=0), least))


def spans(count: int) -> list[slice]:
    """`count` points in parts, one per network call."""
    return [slice(start, start + POINTS_PER_TASK) for start in range(0, count, POINTS_PER_TASK)]
