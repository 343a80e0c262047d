"""Light that volumes emit, as it reaches the camera."""

from typing import FrozenSet, Optional

import numpy as np

from .march import BEHIND, extinction, mean_transmittance
from .omissions import ALL
from .ray_steps import RaySteps, blocks_near_density, step_counts, sums_within


def emitted(
    grids, channels, factors, origins, directions, near, far, leave_out: FrozenSet[str] = ALL
) -> Optional[np.ndarray]:
    """(R, C): the integral of T(t) e(x(t)) dt along rays, C of the channels' colours; None where nothing emits.

    T is the transmittance through all grids and e their emission; both are constant within a step.
    channels: a plan's Channels; factors: (V,) of each grid's emission; origins, directions: float64 (R, 3);
    near, far: (R,) interval that holds all grids; leave_out: as in Settings.
    """
    glowing = [v for v, grid in enumerate(grids) if grid.emission and factors[v] > 0.0]
    if not glowing:
        return None
    steps = RaySteps(grids, origins, directions, near, far, step_counts(grids, channels.sigma_t, directions, near, far))
    blocks = blocks_near_density(grids, steps, always_first=False, skip_empty="empty_space" in leave_out)
    # What still comes through to each step, times its length.
    behind = BEHIND if "behind_opaque" in leave_out else np.inf
    tau = extinction(grids, channels.sigma_t, steps, blocks, behind).sum(axis=0) * steps.dt[blocks.ray][:, None]
    within = sums_within(tau)
    through = np.exp(-blocks.before(within[:, -1])[:, None] - (within - tau)) * mean_transmittance(np.float32(0.0), tau)
    through *= steps.dt[blocks.ray][:, None] * (blocks.steps() < steps.count[blocks.ray][:, None])
    light = np.zeros((blocks.rays, len(channels.indices)))
    for v in glowing:
        for number, channel in enumerate(channels.indices):
            glow = steps.mean(lambda index: grids[v].sample_emission(channel, index), v, blocks.ray, blocks.number)
            light[:, number] += factors[v] * blocks.sums((glow * through).sum(axis=1))
    return light
