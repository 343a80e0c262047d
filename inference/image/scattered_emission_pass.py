# SPDX-License-Identifier: GPL-3.0-or-later
"""Adds the light that volumes emit and scatter."""

import numpy as np

from ..marching.depth_samples import DepthSamples
from .context import ChannelPass, PreparedScene, RenderContext, Tile
from .framebuffer import add_at

# Depth samples that are evaluated at a time.
POINTS_PER_BATCH = 1 << 16


def add_scattered_emission(
    context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, tile: Tile, samples: DepthSamples
) -> None:
    """Add the light that volumes emit and scatter to the tile's multiple scattering. Raises Cancelled."""
    plan, report = scene.plan, context.report
    for g, group in enumerate(plan.groups):
        if not plan.scattered_emission[g]:
            continue
        with report.stage("emission"):
            emission = context.cache.scattered_emission(
                plan.members(g), [scene.grids[v] for v in group], g, context.cancel, context.kernels
            )
        warnings = emission.warnings(plan.group_name(g))
        report.warnings += [warning for warning in warnings if warning not in report.warnings]
        for v in group:
            medium, inside = plan.volumes[v][1], np.flatnonzero(samples.fraction[:, v] > 0.0)
            for start in range(0, len(inside), POINTS_PER_BATCH):
                context.cancel.check()
                points = inside[start : start + POINTS_PER_BATCH]
                positions, directions = samples.positions(points), samples.directions[samples.ray[points]]
                weight = samples.weight[points] * samples.fraction[points, v]
                for c in channel_pass.channels.indices:
                    light = emission.scattered(c, positions, directions, medium.anisotropy) * medium.albedo[c]
                    add_at(tile.framebuffer.multiple[:, c], samples.pixel[samples.ray[points]], weight * light)
