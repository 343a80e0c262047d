# SPDX-License-Identifier: GPL-3.0-or-later
"""What camera rays gather of the light of lamps."""

from dataclasses import dataclass

from ..grids.bound_medium import BoundMedium
from ..marching.lamp_march import LampInMedia, LampSegment, march_lamps
from ..marching.ray_march import MarchOptions, RaySegment
from ..marching.ray_steps import RayBatch
from ..plan.plan import Channels
from ..transport.scattered_fluence import ScatteredFluence
from .context import PreparedScene, RenderContext


@dataclass(frozen=True)
class LampMarch:
    """Marches rays for the light of lamps through the media of a channel pass.

    options: with the scattered fluence of the lamps, if networks are to know of them. radius: as for `march_lamps`.
    """

    media: list[BoundMedium]
    lamps: list[LampInMedia]
    options: MarchOptions
    radius: float

    def __call__(self, rays: RayBatch, segment: RaySegment) -> LampSegment:
        """What rays gather, at the samples of a segment."""
        samples = segment.sample_ray, segment.sample_distance
        return march_lamps(self.media, rays, self.lamps, self.options, samples, self.radius)


def prepare_lamp_march(
    context: RenderContext, scene: PreparedScene, channels: Channels, media: list[BoundMedium]
) -> LampMarch | None:
    """What marches rays for the light of the plan's lamps, or None without any. Raises Cancelled."""
    plan = scene.plan
    if not scene.lamps:
        return None
    fluence: list[ScatteredFluence | None] | None = None
    if plan.predicts_lamps:
        fluence = [None] * len(scene.groups)
        with context.report.stage("fields"):
            for g, group in scene.predicted(channels):
                sigma_t = float(group.medium.sigma_t[channels.indices[0]])
                with context.progress.stage("transport", len(scene.lamps)):
                    fluence[g] = group.predictor.lamp_fluence(sigma_t, scene.lamps, scene.occluders, context.tasks)
        if all(one is None for one in fluence):
            fluence = None
    options = MarchOptions(context.settings.depth_samples, fluence, None, plan.groups, context.settings.leave_out)
    return LampMarch(media, scene.lamps, options, scene.lamp_radius)
