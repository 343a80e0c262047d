# SPDX-License-Identifier: GPL-3.0-or-later
"""Adds the light that volumes emit and scatter."""

from collections.abc import Mapping

import numpy as np

from ..marching.depth_samples import DepthSamples
from ..plan.plan import last_albedo
from ..transport.scattered_emission import ScatteredEmission
from .context import ChannelPass, PreparedScene, RenderContext, Tile
from .framebuffer import add_at
from .predicted_error import SCATTERED_EMISSION

# Depth samples that are evaluated at a time.
POINTS_PER_BATCH = 1 << 16


def prepare_scattered_emission(context: RenderContext, scene: PreparedScene) -> dict[int, ScatteredEmission]:
    """Light that volumes emit and scatter, by the number of their group. Raises Cancelled."""
    plan, report = scene.plan, context.report
    found = {}
    for g, group in enumerate(plan.groups):
        if plan.scattered_emission[g]:
            with report.stage("emission"):
                found[g] = context.cache.scattered_emission(
                    plan.members(g), [scene.grids[v] for v in group], g, context.cancel
                )
            report.warn(found[g].warnings(plan.group_name(g)))
    return found


def add_scattered_emission(
    context: RenderContext,
    scene: PreparedScene,
    channel_pass: ChannelPass,
    tile: Tile,
    samples: DepthSamples,
    prepared: Mapping[int, ScatteredEmission],
) -> None:
    """Add the light that volumes emit and scatter to the tile's multiple scattering. Raises Cancelled.

    prepared: from `prepare_scattered_emission`.
    """
    plan = scene.plan
    for g, emission in prepared.items():
        for v in plan.groups[g]:
            (volume, medium), inside = plan.volumes[v], np.flatnonzero(samples.fraction[:, v] > 0.0)
            last = last_albedo(volume, medium)
            for start in range(0, len(inside), POINTS_PER_BATCH):
                context.cancel.check()
                points = inside[start : start + POINTS_PER_BATCH]
                positions, directions = samples.positions(points), samples.directions[samples.ray[points]]
                weight = samples.weight[points] * samples.fraction[points, v]
                for c in channel_pass.channels.indices:
                    if samples.scattering is not None:
                        place = channel_pass.scattering_place(c)
                        weight = samples.weight[points] * samples.scattering[points, v, place]
                    light = emission.scattered(c, positions, directions, medium.anisotropy) * last[c]
                    pixel = samples.pixel[samples.ray[points]]
                    add_at(tile.framebuffer.multiple[:, c], pixel, weight * light)
                    add_at(tile.framebuffer.deviation, pixel, weight * light * (SCATTERED_EMISSION / 3.0))
