# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering at any points of a group of volumes, towards any direction."""

from collections.abc import Iterator, Sequence

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..image.context import PreparedScene, RenderContext
from ..marching.depth_samples import entry_point
from ..marching.extended_lights import EquivalentDirections
from ..marching.marcher import Marcher
from ..marching.ray_features import COLUMNS, RayFeatures
from ..marching.ray_march import MarchOptions
from ..marching.ray_steps import RayBatch
from ..network.albedos import Albedos
from ..network.predictor import POINTS_PER_TASK
from ..network.prepared_predictors import PreparedPredictor
from ..network.ray_points import RayPoints
from ..plan.plan import Channels
from ..scene.description import Sun
from ..transport.scattered_fluence import ScatteredFluence


class PointRadiance:
    """The light that one group of volumes scatters, having scattered it before; ready to be evaluated.

    Prepared for some colour channels and all suns of the scene. Raises Cancelled.
    """

    def __init__(self, context: RenderContext, scene: PreparedScene, g: int, channels: Channels) -> None:
        group, plan = scene.groups[g], scene.plan
        assert group is not None
        self._context, self._predictor = context, group.predictor
        self.group, self.channels, self.suns = g, channels, plan.predicted_suns()
        self._lit = [plan.lights_group(one.sun, g) for one in self.suns]
        self._medium, self._optimizations = group.medium, plan.optimizations
        self._albedos: dict[int, Albedos] = {}
        self._anisotropy = group.medium.anisotropy
        self._sigma_t, self._occluders = float(group.medium.sigma_t[channels.indices[0]]), scene.occluders
        fluence = None
        if scene.network is not None and scene.network.needs_ray_features:
            with context.report.stage("fields"), context.progress.stage("transport", len(self.suns)):
                context.progress.message(f"multiple scattering of {plan.group_name(g)}")
                joined = [one.sun for one in self.suns]
                fluence = group.predictor.fluence(self._sigma_t, joined, scene.occluders, context.tasks)
                of_part = {part: number for number, one in enumerate(self.suns) for part in one.parts}
                fluence = fluence and fluence.of_parts([of_part[l] for l in range(len(plan.suns))])
        media = scene.media(channels, list(range(len(plan.suns))))
        self._media: list[BoundMedium] = [media[v] for v in plan.groups[g]]
        self._ready: dict[int, PreparedPredictor] = {}
        self._march = None if fluence is None else self._prepare_march(scene, fluence)

    def _prepare_march(self, scene: PreparedScene, fluence: ScatteredFluence) -> Marcher:
        context = self._context
        # Every ray needs its features at its start, however faint it is.
        options = MarchOptions(
            1,
            [fluence],
            scene.occluders.shadow_maps,
            [list(range(len(self._media)))],
            context.settings.leave_out - {"faint_rays"},
            entry_point,
        )
        return Marcher(self._media, options, self.channels.indices, context.tasks.stopping)

    def __call__(self, positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Radiance float32 (3, N) that an albedo of 1 scatters towards the camera.

        positions, directions: float64 (N, 3) in the world, points with density and unit directions of camera rays.
        Channels other than `channels` are 0. Raises Cancelled.
        """
        context, radiance = self._context, np.zeros((3, len(positions)), np.float32)
        features = self._features(positions, directions)
        for l, one in enumerate(self.suns):
            if not self._lit[l]:
                continue
            prepared, sun = self._prepared(l), one.sun
            of_sun = None if features is None else features.mean(slice(None), 0, one.parts, one.shares)
            with context.report.stage("network"), context.progress.stage("network"):
                albedos = self._albedos_of(l)
                for span, values in self._predicted((prepared, albedos), sun, positions, directions, of_sun):
                    for c, row in albedos.by_channel(values, positions[span], directions[span]):
                        radiance[c, span] += row * np.float32(sun.irradiance[c])
                    context.progress.advance("network", values.shape[1])
            context.report.count("network points", len(positions))
        return radiance

    def _albedos_of(self, l: int) -> Albedos:
        """Albedos in the light of one sun."""
        if l not in self._albedos:
            self._albedos[l] = self._predictor.albedos(
                self._medium,
                self._sigma_t,
                self.channels.indices,
                self.suns[l].sun,
                self._occluders,
                self._context.tasks,
                self._optimizations,
            )
        return self._albedos[l]

    def _prepared(self, l: int) -> PreparedPredictor:
        """The predictor of one sun, prepared once unless it is large."""
        found = self._ready.get(l)
        if found is None:
            context, predictor = self._context, self._predictor
            with context.report.stage("fields"), context.progress.stage("lattices", 1):
                found = predictor.prepare(
                    self._sigma_t, self.suns[l].sun, predictor.extent(), self._occluders, context.tasks
                )
            # Lookup lattices of networks without ray features differ from sun to sun.
            if self._march is not None:
                self._ready[l] = found
        return found

    def _predicted(
        self,
        asked: tuple[PreparedPredictor, Albedos],
        sun: Sun,
        positions: np.ndarray,
        directions: np.ndarray,
        features: np.ndarray | None,
    ) -> Iterator[tuple[slice, np.ndarray]]:
        """Yield batches of points and their radiance (A, n) in the light of one sun of irradiance 1.

        asked: what predicts, and for which albedos.
        """
        prepared, albedos = asked
        if sun.spread is not None:
            directions = EquivalentDirections.of(directions, sun, self._anisotropy)

        def task(span: slice) -> tuple[slice, np.ndarray]:
            some = None if features is None else features[span]
            points = RayPoints(positions[span], directions[span], ray_features=some)
            return span, prepared.predict(points, albedos.values)

        return self._context.tasks.map(task, spans(len(positions)))

    def _features(self, positions: np.ndarray, directions: np.ndarray) -> RayFeatures | None:
        """Ray features at points, for networks that need them."""
        march = self._march
        if march is None or not len(positions):
            return None
        batch, context = rays_outwards(self._media, positions, directions), self._context
        # Where a ray meets no density, nothing lies ahead.
        suns = sum(len(one.parts) for one in self.suns)
        values = np.zeros((len(positions), 1, suns, COLUMNS), np.float32)

        def task(span: slice) -> tuple[np.ndarray, np.ndarray, int]:
            segment = march(batch.take(span))
            assert segment.sample_features is not None
            return span.start + segment.sample_ray, segment.sample_features.values, segment.steps_evaluated

        with context.report.stage("march"), context.progress.stage("march"):
            for rays, found, steps in context.tasks.map(task, spans(len(positions))):
                values[rays] = found
                context.report.count("steps evaluated", steps)
                context.progress.advance("march", steps)
        return RayFeatures(values)


def rays_outwards(media: Sequence[BoundMedium], positions: np.ndarray, directions: np.ndarray) -> RayBatch:
    """Rays from points (N, 3) along directions (N, 3) to the ends of some media."""
    ends = [medium.grid.interval(positions, directions)[1] for medium in media if medium.matters]
    # Points at the very end of a volume have nothing ahead of them.
    least = 1e-6 * min(medium.grid.voxel for medium in media)
    return RayBatch(positions, directions, np.zeros(len(positions)), np.maximum(np.max(ends, axis=0), least))


def spans(count: int) -> list[slice]:
    """`count` points in parts, one per network call."""
    return [slice(start, start + POINTS_PER_TASK) for start in range(0, count, POINTS_PER_TASK)]
