# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering of the light of environments at any points of a group of volumes, towards any direction."""

from collections.abc import Sequence

import numpy as np

from ..image.context import PreparedScene, RenderContext
from ..marching.depth_samples import entry_point
from ..marching.marcher import Marcher
from ..marching.ray_march import MarchOptions
from ..network.ray_points import RayPoints
from ..plan.plan import Channels
from ..scene.environment import Environment
from .point_radiance import rays_outwards, spans


class EnvironmentRadiance:
    """As `PointRadiance`, in the light of environments instead of suns. Raises Cancelled.

    single: whether light that is scattered once belongs to it, which the renderer that shows the light does not know.
    """

    def __init__(
        self,
        context: RenderContext,
        scene: PreparedScene,
        g: int,
        channels: Channels,
        environments: Sequence[Environment],
        single: bool = False,
    ):
        group, plan = scene.groups[g], scene.plan
        assert group is not None and scene.environment_network is not None
        self._context, self.channels, self._single = context, channels, single
        media = scene.media(channels, [])
        self._media = [media[v] for v in plan.groups[g]]
        sigma_t = float(group.medium.sigma_t[channels.indices[0]])
        context.progress.message(f"light from everywhere in {plan.group_name(g)}")
        with context.report.stage("fields"), context.progress.stage("lattices", 1):
            # The light of surfaces begins at them: what they hide neither dims nor scatters it.
            opened = (scene.open_groups[g] if scene.open_groups else None) or group
            self._predictor = opened.predictor.prepare_environment(
                scene.environment_network, environments, sigma_t, opened.predictor.extent(), context.tasks
            )
            self._albedos = opened.predictor.albedos(
                group.medium,
                sigma_t,
                channels.indices,
                environments,
                tasks=context.tasks,
                optimizations=plan.optimizations,
            )
        # Every point needs the optical depth of its ray, however faint that is.
        optimizations = context.settings.leave_out - {"faint_rays"}
        options = MarchOptions(1, None, None, [list(range(len(self._media)))], optimizations, entry_point)
        self._march = Marcher(self._media, options, channels.indices, context.tasks.stopping)

    def __call__(self, positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Radiance float32 (3, N) that an albedo of 1 scatters towards the camera, as of `PointRadiance`."""
        context, predictor = self._context, self._predictor
        radiance = np.zeros((3, len(positions)), np.float32)
        albedos = self._albedos
        # Optical depths ahead of the points and behind them.
        along = np.stack([self._depths(positions, towards) for towards in (directions, -directions)], axis=1)

        def task(span: slice) -> tuple[slice, np.ndarray]:
            return span, predictor.predict(RayPoints(positions[span], directions[span]), along[span], albedos.values)

        with context.report.stage("network"), context.progress.stage("network"):
            for span, values in context.tasks.map(task, spans(len(positions))):
                # The first is single scattering.
                light = values[1:] + values[0] if self._single else values[1:]
                for c, row in albedos.by_channel(light, positions[span], directions[span]):
                    radiance[c, span] = row[:, c if predictor.channels > 1 else 0]
                context.progress.advance("network", values.shape[1])
        context.report.count("network points", len(positions))
        return radiance

    def _depths(self, positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Optical depths float32 (N,) of the group from points outwards."""
        context = self._context
        batch = rays_outwards(self._media, positions, directions)
        depths = np.zeros(len(positions), np.float32)

        def task(span: slice) -> tuple[slice, np.ndarray, int]:
            segment = self._march(batch.take(span))
            return span, segment.optical_depth.sum(axis=1), segment.steps_evaluated

        with context.report.stage("march"), context.progress.stage("march"):
            for span, found, steps in context.tasks.map(task, spans(len(positions))):
                depths[span] = found
                context.report.count("steps evaluated", steps)
                context.progress.advance("march", steps)
        return depths
