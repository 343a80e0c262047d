"""The boxes around voxels in which Cycles evaluates the shader of a Volume object.

A shader that emits light where every grid is 0 fills them, which shows. Measured with Cycles 4.5: they are the leaves
of 8 x 8 x 8 voxels that hold a voxel above 0.001, or lie beside one across a face.
"""

import numpy as np

LEAF = 8
CLIPPING = 1e-3


def leaves_around(grids: dict, low):
    """(grids, low): aligned grids by name with zeros around them up to the bounds of Cycles' leaves.

    low: int (3,), index of their first voxel in the file.
    """
    shape = np.array(next(iter(grids.values())).shape)
    first = (np.asarray(low) - 1) // LEAF * LEAF
    last = -((-np.asarray(low) - shape - 1) // LEAF) * LEAF
    around = list(zip(np.asarray(low) - first, last - low - shape))
    return {name: np.pad(values, around) for name, values in grids.items()}, first


def boxes(grids: dict) -> np.ndarray:
    """float32 (nx, ny, nz): 1 in the leaves that Cycles fills, of grids from `leaves_around`."""
    filled = np.any([values > CLIPPING for values in grids.values()], axis=0)
    grown = filled.copy()
    for axis in range(3):
        grown |= np.roll(filled, 1, axis) | np.roll(filled, -1, axis)
    split = [size for n in grown.shape for size in (n // LEAF, LEAF)]
    leaves = grown.reshape(split).any(axis=(1, 3, 5))
    return np.kron(leaves, np.ones((LEAF,) * 3)).astype(np.float32)
