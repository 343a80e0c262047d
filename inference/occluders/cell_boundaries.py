"""Opaque surfaces as diffused light meets them on a coarse lattice of cells."""

import numpy as np

from .rasterization import rasterize

# Cells' middles are moved so far, in cells, when surfaces are looked for: none runs through the edges of regular meshes.
OFF = np.array([0.00137, -0.00241, 0.00173])
# Layers of cells within surfaces that take the light of those outside.
LAYERS = 3


class CellBoundaries:
    """Links between the middles of neighbouring cells of the cube that black surfaces cut.

    below, above: float64 (3, n, n, n), on the link of each cell to the next along each axis the distance in cells from
    the cell to the surface and from the next cell to it, infinite where none cuts it. facing: (3, n, n, n), |cosine|
    between the axis and the surface's normal, so that links stand for as much surface as there is; 0 where none cuts.
    inside: bool (n, n, n), cells within a closed surface.
    """

    def __init__(self, triangles: np.ndarray, cells: int):
        """triangles: (T, 3, 3) corners in the cube's frame."""
        shape = (3, cells, cells, cells)
        self.below, self.above, self.facing = np.full(shape, np.inf), np.full(shape, np.inf), np.zeros(shape)
        self.inside = np.ones(shape[1:], bool)
        place = (np.asarray(triangles, np.float64) + 0.5) * cells - 0.5 + OFF
        for axis in range(3):
            self._cut(axis, np.roll(place, -axis, axis=2), cells)

    @property
    def empty(self) -> bool:
        return not self.facing.any()

    def _cut(self, axis: int, place, cells: int):
        """Links along an axis; place: corners, that axis first and then the following two."""
        normals = np.cross(place[:, 1] - place[:, 0], place[:, 2] - place[:, 0])
        facing = np.abs(normals[:, 0]) / np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
        shape = (cells * cells, cells)
        nearest, farthest, most = np.full(shape, np.inf), np.full(shape, -np.inf), np.zeros(shape)
        passed = np.zeros((cells * cells, cells + 1), int)
        for column, height, triangle in rasterize(place[..., 1:], place[..., 0], np.array([cells, cells])):
            np.add.at(passed, (column, np.clip(np.ceil(height), 0, cells).astype(int)), 1)
            met = (height >= 0.0) & (height < cells - 1)
            at = column[met], height[met].astype(int)
            np.minimum.at(nearest, at, height[met])
            np.maximum.at(farthest, at, height[met])
            np.maximum.at(most, at, facing[triangle[met]])
        number = np.arange(cells)
        for into, values in ((self.below, nearest - number), (self.above, number + 1.0 - farthest), (self.facing, most)):
            into[axis] = _back(values, axis, cells)
        # A line that crosses closed surfaces crosses them as often to get in as to get out.
        within = (np.cumsum(passed, axis=1)[:, :-1] % 2 == 1) & (passed.sum(axis=1, keepdims=True) % 2 == 0)
        self.inside &= _back(within, axis, cells)

    def end(self, axis: int, coupling, total, spread, h: float) -> None:
        """Cut the links along one axis, which is the arrays' first, and let each side lose what meets the surface.

        coupling, total: of `diffusion.couple`, changed; spread: D. The loss is that of a cube's face as far away.
        """
        below, above, facing = (np.moveaxis(values[axis], axis, 0)[:-1] for values in (self.below, self.above, self.facing))
        coupling[:-1][facing > 0.0] = 0.0
        total[:-1] += 0.5 * h * facing / (1.0 + below * h / (2.0 * spread[:-1]))
        total[1:] += 0.5 * h * facing / (1.0 + above * h / (2.0 * spread[1:]))

    def spread_inside(self, values) -> np.ndarray:
        """Values (n, n, n), those within surfaces taken from cells outside, so that lookups between the two see no step."""
        spread, known = np.where(self.inside, 0.0, values), (~self.inside).astype(np.float64)
        for _ in range(LAYERS):
            sums, counts = _around(spread), _around(known)
            new = (known == 0.0) & (counts > 0.0)
            spread[new], known[new] = sums[new] / counts[new], 1.0
        return np.where(known > 0.0, spread, values)


def _back(values, axis: int, cells: int):
    """(n * n columns, n) along an axis as (n, n, n)."""
    order = np.empty(3, int)
    order[[(axis + 2) % 3, (axis + 1) % 3, axis]] = 0, 1, 2
    return values.reshape(cells, cells, cells).transpose(order)


def _around(values):
    """Sums over each cell and its 26 neighbours."""
    for axis in range(3):
        padded = np.pad(values, [(int(a == axis),) * 2 for a in range(3)])
        v = np.moveaxis(padded, axis, 0)
        values = np.moveaxis(v[:-2] + v[1:-1] + v[2:], 0, axis)
    return values
