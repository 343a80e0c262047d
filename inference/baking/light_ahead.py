# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that arrives at the points of a grid along one direction, in one sweep for all of them.

Parallel rays are marched together, slice by slice across the axis that they follow most. Slices are sheared to the rays
and back, so that interpolation never accumulates.
"""

import numpy as np

from ..kernels.library import call

# Scales of extinction: forward scattering reaches further than direct light.
SCALES = np.array([1.0, 0.334], np.float32)
# Rows of cells are padded to a multiple of this.
LANES = 8


def light_ahead(
    extinction: np.ndarray, sources: np.ndarray, index_direction: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Integrals of exp(-a tau) S a d(tau) ahead of each point, for each scale a of SCALES, and exp(-tau).

    extinction: float32 (nx, ny, nz) per world unit. sources: float32 (K, nx, ny, nz), S. index_direction: (3,),
    d(index)/d(length) along rays. tau: optical depth from the point. Returns float32 (K, A, nx, ny, nz) and (nx, ny,
    nz).
    """
    main = int(np.abs(index_direction).argmax())
    axes = [main, *(axis for axis in range(3) if axis != main)]
    count, rows, columns = (extinction.shape[axis] for axis in axes)
    slopes = np.delete(index_direction, main) / index_direction[main]
    # Places of the first cells of each slice among the rays.
    offsets = -np.arange(count)[:, None] * slopes
    offsets -= np.floor(offsets.min(axis=0))
    starts = offsets.astype(np.int64)
    row = -(-(columns + 2) // LANES) * LANES
    size = starts.max(axis=0) + [rows + 1, row]
    sums = len(sources) * len(SCALES)
    rays = np.zeros((sums + 1, *size), np.float32)
    rays[-1] = 1.0
    found = np.empty((sums + 1, *extinction.shape), np.float32)
    call(
        "sweep_ahead",
        shape=np.array([count, rows, columns]),
        strides=np.array([extinction.strides[axis] // extinction.itemsize for axis in axes]),
        cells=extinction.size,
        sign=1 if index_direction[main] > 0 else -1,
        sources=len(sources),
        scales=len(SCALES),
        extinction=extinction,
        light=sources,
        scale=SCALES,
        half_step=0.5 / abs(index_direction[main]),
        row=row,
        starts=starts,
        fractions=(offsets - starts).astype(np.float32),
        size=size,
        rays=rays,
        ahead=found,
        scratch=np.zeros((len(sources) + 1 + sums + 1, rows + 2, row), np.float32),
    )
    return found[:-1].reshape(len(sources), len(SCALES), *extinction.shape), found[-1]
