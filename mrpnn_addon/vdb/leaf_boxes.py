# SPDX-License-Identifier: GPL-3.0-or-later
"""The boxes around voxels in which Cycles evaluates the shader of a Volume object.

A shader that emits where every grid is 0 fills them visibly. Measured in Cycles 4.5: they are the leaves of 8 x 8 x 8
voxels that contain a voxel above 0.001 or its neighbour across a face; where a leaf is one value throughout, files hold
a tile, across whose faces nothing is filled. Cycles 5.0 has one box around all such voxels, from one voxel below the
lowest centre to two above the highest.
"""

import bpy
import numpy as np

LEAF = 8
FIVE = bpy.app.version >= (5, 0, 0)
CLIPPING = 1e-3


def leaves_around(
    grids: dict[str, np.ndarray], low: np.ndarray, backgrounds: dict[str, float]
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """(grids, low): aligned grids by name, padded with their backgrounds, or 0, to the bounds of Cycles' leaves.

    low: int (3,), the file's index of their first voxel.
    """
    shape = np.array(next(iter(grids.values())).shape)
    low, beside = np.asarray(low), 2 if FIVE else 1
    first = (low - beside) // LEAF * LEAF
    last = -((-low - shape - beside) // LEAF) * LEAF
    around = list(zip(low - first, last - low - shape))
    padded = {
        name: np.pad(values, around, constant_values=backgrounds.get(name, 0.0)) for name, values in grids.items()
    }
    return padded, first


def boxes(grids: dict[str, np.ndarray], backgrounds: dict[str, float]) -> np.ndarray:
    """float32 (nx, ny, nz): 1 inside Cycles' boxes, for grids from `leaves_around`."""
    # Voxels that hold the background are not active.
    active = [(values > CLIPPING) & (values != backgrounds.get(name, 0.0)) for name, values in grids.items()]
    filled = np.any(active, axis=0)
    if FIVE:
        return _one_box(filled)
    split = [size for n in filled.shape for size in (n // LEAF, LEAF)]
    varied = np.any([_varied(values.reshape(split)) for values in grids.values()], axis=0)
    beside = filled & np.kron(varied, np.ones((LEAF,) * 3, bool))
    grown = filled.copy()
    for axis in range(3):
        grown |= np.roll(beside, 1, axis) | np.roll(beside, -1, axis)
    leaves = grown.reshape(split).any(axis=(1, 3, 5))
    return np.kron(leaves, np.ones((LEAF,) * 3)).astype(np.float32)


def _varied(leaves: np.ndarray) -> np.ndarray:
    """bool (nx, ny, nz): which leaves, (nx, 8, ny, 8, nz, 8), hold several values."""
    return leaves.max(axis=(1, 3, 5)) > leaves.min(axis=(1, 3, 5))


def _one_box(filled: np.ndarray) -> np.ndarray:
    share = np.ones(1, np.float32)
    for axis in range(3):
        found = np.flatnonzero(filled.any(axis=tuple(a for a in range(3) if a != axis)))
        along = np.zeros(filled.shape[axis], np.float32)
        if len(found):
            # A box ends at the centres of its outer voxels, which count half.
            along[found[0] - 1 : found[-1] + 3] = 0.5
            along[found[0] : found[-1] + 2] = 1.0
        share = share[..., None] * along
    return share[0]
