# SPDX-License-Identifier: GPL-3.0-or-later
"""Opaque surfaces on the coarse cells of the scattered light."""

import numpy as np

from .rasterization import rasterize

# Offset of the sample lines in cells, so that none runs through the edges of axis-aligned meshes.
OFFSET = np.array([0.00137, -0.00241, 0.00173])
# Layers of cells within surfaces to which values are extrapolated.
LAYERS = 3


class CellBoundaries:
    """Links between the centres of neighbouring cells of the working cube that black surfaces cut.

    below, above: float64 (3, n, n, n), distances in cells to the surface that cuts the link from each cell to the next
    along each axis: from the cell, and from the next cell; infinite where no surface cuts the link. facing: (3, n, n,
    n), |cosine| between the axis and the surface's normal, so that the links represent the surface's area; 0 where no
    surface cuts. inside: bool (n, n, n), cells within a closed surface.
    """

    def __init__(self, triangles: np.ndarray, cells: int):
        """triangles: (T, 3, 3) corners in the cube's frame. cells: n."""
        shape = (3, cells, cells, cells)
        self.below, self.above, self.facing = np.full(shape, np.inf), np.full(shape, np.inf), np.zeros(shape)
        self.inside = np.ones(shape[1:], bool)
        corners = (np.asarray(triangles, np.float64) + 0.5) * cells - 0.5 + OFFSET
        for axis in range(3):
            self._cut(axis, np.roll(corners, -axis, axis=2), cells)

    @property
    def empty(self) -> bool:
        """Whether no link is cut."""
        return not self.facing.any()

    def _cut(self, axis: int, corners: np.ndarray, cells: int) -> None:
        """Cut links along an axis; corners: (T, 3, 3), that axis first and the following two after it."""
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        facing = np.abs(normals[:, 0]) / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
        shape = (cells * cells, cells)
        nearest, farthest, most = np.full(shape, np.inf), np.full(shape, -np.inf), np.zeros(shape)
        passed = np.zeros((cells * cells, cells + 1), int)
        for column, height, triangle in rasterize(corners[..., 1:], corners[..., 0], np.array([cells, cells])):
            np.add.at(passed, (column, np.clip(np.ceil(height), 0, cells).astype(int)), 1)
            met = (height >= 0.0) & (height < cells - 1)
            at = column[met], height[met].astype(int)
            np.minimum.at(nearest, at, height[met])
            np.maximum.at(farthest, at, height[met])
            np.maximum.at(most, at, facing[triangle[met]])
        number = np.arange(cells)
        self.below[axis] = _back(nearest - number, axis, cells)
        self.above[axis] = _back(number + 1.0 - farthest, axis, cells)
        self.facing[axis] = _back(most, axis, cells)
        # A line enters closed surfaces as often as it leaves them.
        within = (np.cumsum(passed, axis=1)[:, :-1] % 2 == 1) & (passed.sum(axis=1, keepdims=True) % 2 == 0)
        self.inside &= _back(within, axis, cells)

    def end(self, axis: int, coupling: np.ndarray, total: np.ndarray, diffusion: np.ndarray, h: float) -> None:
        """Cut links along an axis, which comes first in the arrays, and let both sides lose what reaches the surface.

        coupling, total: of `diffusion.couple`, modified. diffusion: D of each cell. h: edge of a cell. The loss is that
        through a face of the cube at the same distance.
        """
        below, above, facing = (
            np.moveaxis(values[axis], axis, 0)[:-1] for values in (self.below, self.above, self.facing)
        )
        coupling[:-1][facing > 0.0] = 0.0
        total[:-1] += 0.5 * h * facing / (1.0 + below * h / (2.0 * diffusion[:-1]))
        total[1:] += 0.5 * h * facing / (1.0 + above * h / (2.0 * diffusion[1:]))

    def extrapolate_inside(self, values: np.ndarray) -> np.ndarray:
        """Values (n, n, n), extrapolated into surfaces from the cells outside, so that interpolation sees no step."""
        filled, weights = np.where(self.inside, 0.0, values), (~self.inside).astype(np.float64)
        for _ in range(LAYERS):
            sums, counts = _around(filled), _around(weights)
            new = (weights == 0.0) & (counts > 0.0)
            filled[new], weights[new] = sums[new] / counts[new], 1.0
        return np.where(weights > 0.0, filled, values)


def _back(values: np.ndarray, axis: int, cells: int) -> np.ndarray:
    """(n * n columns, n) along an axis as (n, n, n)."""
    order = np.empty(3, int)
    order[[(axis + 2) % 3, (axis + 1) % 3, axis]] = 0, 1, 2
    return values.reshape(cells, cells, cells).transpose(order)


def _around(values: np.ndarray) -> np.ndarray:
    """Sums over each cell and its 26 neighbours."""
    for axis in range(3):
        padded = np.pad(values, [(int(a == axis),) * 2 for a in range(3)])
        v = np.moveaxis(padded, axis, 0)
        values = np.moveaxis(v[:-2] + v[1:-1] + v[2:], 0, axis)
    return values
