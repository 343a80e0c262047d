# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps whose light camera rays gather."""

from ..marching.lamp_march import LampMarch
from ..plan.plan import Channels
from ..transport.scattered_fluence import ScatteredFluence
from .context import PreparedScene, RenderContext


def prepare_lamp_march(context: RenderContext, scene: PreparedScene, channels: Channels) -> LampMarch | None:
    """The plan's lamps and their scattered light in some colour channels; None without any. Raises Cancelled."""
    if not scene.lamps:
        return None
    fluence: list[ScatteredFluence | None] = [None] * len(scene.groups)
    if scene.plan.predicts_lamps:
        with context.report.stage("fields"):
            for g, group in scene.predicted(channels):
                sigma_t = float(group.medium.sigma_t[channels.indices[0]])
                with context.progress.stage("transport", len(scene.lamps)):
                    fluence[g] = group.predictor.lamp_fluence(sigma_t, scene.lamps, scene.occluders, context.tasks)
    predicted = any(one is not None for one in fluence)
    return LampMarch(scene.lamps, fluence if predicted else None, scene.lamp_radius)
