# SPDX-License-Identifier: GPL-3.0-or-later
"""Radiance in voxels, predicted where the picture needs it and interpolated in between.

Prediction goes from coarse lattices of voxels to fine ones. Where a prediction agrees with the interpolation of the
next coarser lattice, or where hardly any light reaches the viewer, finer lattices are interpolated.
"""

from collections.abc import Callable, Sequence

import numpy as np

# Distances of neighbours in the lattices, in voxels. The first two are predicted wherever the picture shows anything.
STRIDES = (4, 2, 1)
# The same for light of environments, which varies less.
SKY_STRIDES = (8, *STRIDES)
# Largest error of interpolation, as a share of the mean radiance, in a voxel that is in full view.
TOLERANCE = 0.012
# So few voxels are all predicted: their neighbours tell too little of how smooth their light is.
FEW = 4096
# Importance up to which only the first lattice is predicted.
UNSEEN = 1e-5
# Optical thickness of a voxel, times this, from which it counts in full.
THIN = 4.0
# Light beyond the edge of a volume, as a share of that near by: limits of its continuation.
LEAST, MOST = np.float32(0.3), np.float32(2.0)


# Share of the voxels of the finest lattice that is predicted besides those of coarser ones, about: for so many voxels
# along an edge of a cube. Light varies less from voxel to voxel where there are more.
FINEST_SHARE, EDGE, FINEST_POWER, FINEST_LIMITS = 0.1, 70.0, -2.4, (0.08, 0.8)
# Share of the voxels that the picture shows, and so of the predictions behind the first lattice, about.
SEEN = 0.7


def expected_predictions(voxels: float, strides: Sequence[int], seen: float = SEEN) -> float:
    """How many of so many wanted voxels `radiance_in_voxels` predicts, about; seen: share that the picture shows."""
    if voxels <= FEW or len(strides) == 1:
        return voxels
    finest = float(np.clip(FINEST_SHARE * (voxels ** (1.0 / 3.0) / EDGE) ** FINEST_POWER, *FINEST_LIMITS))
    return voxels * (strides[0] ** -3 + seen * (finest + sum(stride**-3 for stride in strides[1:-1])))


def importance_of(thickness: np.ndarray, transmittance: np.ndarray) -> np.ndarray:
    """How much voxels count in the picture, 0 to 1, float32 (nx, ny, nz).

    thickness: optical, of voxels. transmittance: towards the viewer. Both (nx, ny, nz).
    """
    return np.minimum(np.float32(THIN) * thickness, np.float32(1.0)) * transmittance


def radiance_in_voxels(
    wanted: np.ndarray,
    importance: np.ndarray,
    predict: Callable[[np.ndarray], np.ndarray],
    strides: Sequence[int],
    beside: np.ndarray | None = None,
) -> tuple[np.ndarray, int]:
    """Radiance float32 (nx, ny, nz, 3) in the wanted voxels, 0 in others, and the number of voxels predicted.

    wanted: bool (nx, ny, nz). importance: see `importance_of`. predict: radiance (3, N) of voxels int (N, 3).
    strides: distances of neighbours in the lattices, as STRIDES; 1 alone where no voxel is interpolated. beside: other
    radiance (nx, ny, nz, 3) that is in the picture, beside which an error counts less.
    """
    predicted, values, error = 0, np.zeros((0, 0, 0, 3), np.float32), np.zeros((0, 0, 0), np.float32)
    known = np.zeros((0, 0, 0), bool)
    if np.count_nonzero(wanted) <= FEW:
        strides = (1,)
    for stride in strides:
        here = wanted[::stride, ::stride, ::stride]
        between, near = _upsampled(values, known, here.shape)
        chosen = here.copy()
        if stride in strides[1:2]:
            chosen &= ~near | (_block_maxima(importance, stride) > UNSEEN)
        if stride not in strides[:2]:
            counts = _block_maxima(importance, stride)
            grey = between.mean(axis=3)
            if beside is not None:
                grey += near * beside[::stride, ::stride, ::stride].mean(axis=3)
            mean = float((counts * grey)[here].sum() / max(float((counts * near)[here].sum()), 1e-30))
            chosen &= ~near | (_around(error, here.shape) * counts > TOLERANCE * mean)
        values = np.where((here & ~chosen)[..., None], between, np.float32(0.0))
        places = np.argwhere(chosen)
        if len(places):
            values[chosen] = predict(places * stride).T
        predicted += len(places)
        # Interpolated voxels have no error that is known: finer lattices around them are interpolated, too.
        error = np.where(chosen & near, np.abs(values.mean(axis=3) - between.mean(axis=3)), np.float32(0.0))
        known = here
    return values, predicted


def continued(light: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Light (nx, ny, nz, 3) with the neighbours of known voxels filled in, as straight lines through these go on.

    known: bool (nx, ny, nz). A line is that through the means of the known voxels within one and two voxels.
    """
    counts = _around_sums(known.astype(np.float32))
    shell = np.nonzero(~known & (counts > 0.0))
    counts, far_counts = counts[shell], _around_sums(counts)[shell]
    found = np.where(known[..., None], light, np.float32(0.0))
    for c in range(3):
        if c and np.array_equal(light[..., c], light[..., c - 1]):
            found[(*shell, c)] = found[(*shell, c - 1)]
            continue
        sums = _around_sums(np.ascontiguousarray(found[..., c]))
        near, far = sums[shell] / counts, _around_sums(sums)[shell] / far_counts
        found[(*shell, c)] = np.clip(near + (near - far), LEAST * near, MOST * near)
    return found


def _around_sums(values: np.ndarray) -> np.ndarray:
    """Sums over each voxel and its 26 neighbours."""
    for axis in range(3):
        total = values.copy()
        before, after = (
            tuple(cut if a == axis else slice(None) for a in range(3)) for cut in (slice(None, -1), slice(1, None))
        )
        total[after] += values[before]
        total[before] += values[after]
        values = total
    return values


def _upsampled(values: np.ndarray, known: np.ndarray, shape: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """A lattice (nx, ny, nz, 3) interpolated on one twice as fine, from known neighbours; and where there are any."""
    if not known.size:
        return np.zeros((*shape, 3), np.float32), np.zeros(shape, bool)
    sums = np.concatenate([values, known[..., None]], axis=3).astype(np.float32)
    for axis, size in enumerate(shape):
        coarse = sums.shape[axis]
        after = np.concatenate([sums.take(range(1, coarse), axis), np.zeros_like(sums.take([0], axis))], axis)
        pairs = np.stack([sums, np.float32(0.5) * (sums + after)], axis + 1)
        doubled = pairs.reshape([2 * coarse if a == axis else n for a, n in enumerate(sums.shape)])
        sums = doubled.take(range(size), axis)
    weight = sums[..., 3:]
    return sums[..., :3] / np.maximum(weight, np.float32(1e-6)), weight[..., 0] > 0.0


def _around(error: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Largest error of a lattice near each place of one twice as fine."""
    for axis, size in enumerate(shape):
        edge = np.zeros_like(error.take([0], axis))
        padded = np.concatenate([edge, error, edge], axis)
        count = error.shape[axis]
        error = np.maximum(error, np.maximum(padded.take(range(count), axis), padded.take(range(2, count + 2), axis)))
        error = error.repeat(2, axis).take(range(size), axis)
    return error


def _block_maxima(values: np.ndarray, size: int) -> np.ndarray:
    """Largest values of blocks of size^3, smaller ones at the end."""
    values = np.pad(values, [(0, -n % size) for n in values.shape])
    parts = [part for n in values.shape for part in (n // size, size)]
    return values.reshape(parts).max(axis=(1, 3, 5))
