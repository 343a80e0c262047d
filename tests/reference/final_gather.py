# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that arrives at points from directions around the camera ray."""

import numpy as np

from inference.features.final_gather import (
    AZIMUTHS,
    DIRECTIONS,
    GROWTH,
    MIN_SHARE,
    RAYS,
    RINGS,
    SCALE,
    STEPS,
    THICKNESS,
    VALUES,
    FinalGather,
    gather_directions,
)
from inference.scene.phase_function import reduced_anisotropy

# Where rays look up the nearest cell.
SHIFTS = np.mod(np.outer([0.819, 0.671, 0.549], np.arange(RAYS) + 0.5), 1.0).astype(np.float32) - np.float32(0.5)


def gathered(gather: FinalGather, positions: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """As calling a FinalGather, in the kernel's order of operations: rounding decides which cell is the nearest."""
    positions, turned = positions.astype(np.float32), turned.astype(np.float32)
    local = gather_directions(gather.anisotropy)
    towards = np.stack([sum(row[:, i, None] * local[i] for i in range(3)) for row in np.moveaxis(turned, 1, 0)], -1)
    cells, coarse = np.float32(len(gather.media) - 3), len(gather.light)
    flux = np.float32(3.0 * reduced_anisotropy(gather.anisotropy))
    sigma, scale = np.float32(gather.sigma_hat), np.float32(SCALE)
    start, least = positions[:, None] + np.float32(0.5), np.float32(1e-6)
    thickness, growth = np.float32(THICKNESS), np.float32(GROWTH)
    shrinkage = np.float32(1.0) / growth
    distance, tau, single, reduced, scattered = np.zeros((5, *towards.shape[:2]), np.float32)
    extinction = sigma * _sample(gather.media, start * cells)[..., 0]
    step = np.broadcast_to(np.minimum(1 / cells, thickness / np.maximum(extinction, least)), tau.shape)
    for _ in range(STEPS):
        place = start + (distance + np.float32(0.5) * step)[..., None] * towards
        density, sun = np.moveaxis(sigma * _sample(gather.media, place * cells), -1, 0)
        gained, sun = density * step, np.maximum(sun, 0.0)
        cell = np.clip(place * np.float32(coarse) + SHIFTS.T, 0.0, coarse - 1).astype(int)
        fluence, *flow = np.moveaxis(gather.light[tuple(np.moveaxis(cell, -1, 0))], -1, 0)
        source = fluence - flux * sum(part * along for part, along in zip(flow, np.moveaxis(towards, -1, 0)))
        passed = np.exp(-tau) * -np.expm1(-gained)
        single += passed * np.exp(-sun)
        scattered += passed * np.maximum(source, np.float32(MIN_SHARE) * fluence)
        reduced += np.exp(-scale * (tau + sun)) * -np.expm1(-scale * gained)
        tau += gained
        distance = distance + step
        thin = thickness * (1 + tau) / np.maximum(density, least)
        step = np.minimum(step * growth, np.maximum(thin, step * shrinkage))
    found = np.stack([single, reduced, scattered, np.exp(-tau)], axis=-1)
    pairs = found.reshape(len(found), RINGS // 2, 2, AZIMUTHS, VALUES)
    both = np.concatenate([pairs[:, :, 0].mean(axis=2, keepdims=True), pairs[:, :, 1]], axis=2)
    return both.reshape(len(found), DIRECTIONS, VALUES)


def _sample(padded: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Trilinear values (..., 2) at places (..., 3) in cells, of which the first, behind the padding, begins at 0."""
    at = np.clip(cells + np.float32(0.5), 0.0, len(padded) - 2)
    cell = at.astype(int)
    i, j, k = np.moveaxis(cell, -1, 0)
    x, y, z = np.moveaxis(at - cell, -1, 0)[..., None]
    rows = [
        padded[i + a, j, k + c] + y * (padded[i + a, j + 1, k + c] - padded[i + a, j, k + c])
        for c in (0, 1)
        for a in (0, 1)
    ]
    low, high = rows[0] + x * (rows[1] - rows[0]), rows[2] + x * (rows[3] - rows[2])
    return low + z * (high - low)
