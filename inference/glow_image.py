"""The image of what volumes scatter of the light that they emit."""

import numpy as np

from .images import add_at

# Depth samples whose scattered emission is looked up at a time.
GLOW_POINTS = 1 << 16


def add_glow(plan, channels, kept, grids, samples, work, report, multiple):
    """Add what the volumes scatter of light that they emit to the image."""
    for g, group in enumerate(plan.groups):
        if not plan.scattered_glow[g]:
            continue
        with report.stage("emission"):
            glow = kept.glow(plan.pairs(), g, [grids[v] for v in group], work.check)
        warnings = glow.warnings(" and ".join(plan.volumes[v][0].name for v in group))
        report.warnings += [warning for warning in warnings if warning not in report.warnings]
        for v in group:
            medium, inside = plan.volumes[v][1], np.flatnonzero(samples.fraction[:, v] > 0.0)
            for start in range(0, len(inside), GLOW_POINTS):
                work.check()
                points = inside[start : start + GLOW_POINTS]
                positions, directions = samples.positions(points), samples.directions[samples.ray[points]]
                weight = samples.weight[points] * samples.fraction[points, v]
                for c in channels.indices:
                    light = glow.scattered(c, positions, directions, medium.anisotropy) * medium.albedo[c]
                    add_at(multiple[:, c], samples.pixel[samples.ray[points]], weight * light)
