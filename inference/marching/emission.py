"""Light that volumes emit, as it reaches the camera."""


import numpy as np

from ..grids.bound_medium import BoundMedium
from ..scene.optimizations import ALL
from .ray_march import BEHIND, extinction, mean_transmittance
from .ray_steps import RayBatch, RaySteps, blocks_near_density, step_counts, sums_within


def emitted_radiance(
    media: list[BoundMedium], rays: RayBatch, channels: list[int], leave_out: frozenset[str] = ALL
) -> np.ndarray | None:
    """(R, C): the integral of T(t) e(x(t)) dt along rays for C colour channels; None where nothing emits.

    T is the transmittance through all media and e their emission; both are constant within a step.
    rays: whose intervals hold all media. leave_out: as in Settings.
    """
    emitting = [v for v, medium in enumerate(media) if medium.emits]
    if not emitting:
        return None
    steps = RaySteps(media, rays, step_counts(media, rays))
    blocks = blocks_near_density(media, steps, always_first=False, skip_empty="empty_space" in leave_out)
    # Transmittance to each step times the step's length.
    behind = BEHIND if "behind_opaque" in leave_out else np.inf
    tau = extinction(media, steps, blocks, behind).sum(axis=0) * steps.dt[blocks.ray][:, None]
    within = sums_within(tau)
    through = np.exp(-blocks.before(within[:, -1])[:, None] - (within - tau)) * mean_transmittance(np.float32(0.0), tau)
    through *= steps.dt[blocks.ray][:, None] * (blocks.steps() < steps.count[blocks.ray][:, None])
    radiance = np.zeros((blocks.rays, len(channels)))
    for v in emitting:
        for number, channel in enumerate(channels):
            emission = steps.mean(lambda index: media[v].grid.sample_emission(channel, index), v, blocks.ray, blocks.number)
            radiance[:, number] += media[v].medium.emission * blocks.sums((emission * through).sum(axis=1))
    return radiance
