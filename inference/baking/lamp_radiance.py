# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering of the light of lamps at any points of a group of volumes, towards any direction."""

from dataclasses import replace

import numpy as np

from ..image.context import PreparedScene, RenderContext
from ..image.lamp_pass import lamps_of_group, prepare_lamp_march
from ..marching.depth_samples import entry_point
from ..marching.marcher import Marcher
from ..marching.ray_features import COLUMNS, RayFeatures
from ..marching.ray_march import MarchOptions
from ..network.prepared_predictors import LampLight, PreparedLampPredictor
from ..network.ray_points import RayPoints
from ..plan.plan import Channels
from .point_radiance import rays_outwards, spans


class LampRadiance:
    """As `PointRadiance`, in the light of the plan's lamps instead of its suns. Raises Cancelled."""

    def __init__(self, context: RenderContext, scene: PreparedScene, g: int, channels: Channels) -> None:
        group, plan = scene.groups[g], scene.plan
        assert group is not None
        self._context, self._count = context, len(scene.lamps)
        clusters = zip(plan.lamp_clusters[g], lamps_of_group(scene, g))
        self._clusters = [one for one in clusters if plan.lights_group(plan.lamps[one[0][0]], g)]
        members, media = plan.groups[g], scene.media(channels, [])
        self._media = [media[v] for v in members]
        march = prepare_lamp_march(context, scene, channels)
        assert march is not None and march.fluence is not None
        # Of the group alone.
        own = [replace(lamp, depths=[[each[v] for v in members] for each in lamp.depths]) for lamp in scene.lamps]
        march = replace(march, lamps=own, fluence=[march.fluence[g]])
        # Every ray needs its features at its start, however faint it is.
        optimizations = context.settings.leave_out - {"faint_rays"}
        options = MarchOptions(1, None, None, [list(range(len(members)))], optimizations, entry_point)
        stopping = context.tasks.stopping
        self._march = Marcher(self._media, options, channels.indices, stopping, march)
        self._predictors = []
        sigma_t, extent = float(group.medium.sigma_t[channels.indices[0]]), group.predictor.extent()
        for _, lamp in self._clusters:
            with context.report.stage("fields"), context.progress.stage("lattices", 1):
                albedos = group.predictor.albedos(
                    group.medium,
                    sigma_t,
                    channels.indices,
                    lamp,
                    scene.occluders,
                    context.tasks,
                    plan.optimizations,
                )
                light = LampLight(lamp, scene.lamp_radius, albedos.values)
                found = group.predictor.prepare_lamp(sigma_t, light, extent, scene.occluders, context.tasks)
                self._predictors.append((found, albedos))

    def __call__(self, positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Radiance float32 (3, N) that an albedo of 1 scatters towards the camera, as of `PointRadiance`."""
        context, radiance = self._context, np.zeros((3, len(positions)), np.float32)
        features = self._features(positions, directions)
        for (cluster, lamp), (predictor, albedos) in zip(self._clusters, self._predictors):
            of_lamp = features.mean(slice(None), 0, cluster, lamp.shares(positions))

            def task(
                span: slice,
                predictor: PreparedLampPredictor = predictor,
                asked: list[float] = albedos.values,
                of_lamp: np.ndarray = of_lamp,
            ) -> tuple[slice, np.ndarray]:
                points = RayPoints(positions[span], directions[span], ray_features=of_lamp[span])
                return span, predictor.predict(points, asked)

            with context.report.stage("network"), context.progress.stage("network"):
                for span, values in context.tasks.map(task, spans(len(positions))):
                    for c, row in albedos.by_channel(values, positions[span], directions[span]):
                        radiance[c, span] += row * np.float32(lamp.power[c])
                    context.progress.advance("network", values.shape[1])
            context.report.count("network points", len(positions))
        return radiance

    def _features(self, positions: np.ndarray, directions: np.ndarray) -> RayFeatures:
        """Ray features at points, their lights the lamps."""
        batch, context = rays_outwards(self._media, positions, directions), self._context
        # Where a ray meets no density, nothing lies ahead.
        values = np.zeros((len(positions), 1, self._count, COLUMNS), np.float32)

        def task(span: slice) -> tuple[np.ndarray, np.ndarray, int]:
            segment = self._march(batch.take(span))
            assert segment.lamps is not None and segment.lamps.features is not None
            return span.start + segment.sample_ray, segment.lamps.features.values, segment.steps_evaluated

        with context.report.stage("march"), context.progress.stage("march"):
            for rays, found, steps in context.tasks.map(task, spans(len(positions))):
                values[rays] = found
                context.report.count("steps evaluated", steps)
                context.progress.advance("march", steps)
        return RayFeatures(values)
