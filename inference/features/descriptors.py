# SPDX-License-Identifier: GPL-3.0-or-later
"""Features of fields at the stencil's points around each x."""

from collections.abc import Iterator

import numpy as np

from ..numerics.small_matmul import product
from .mip_lattices import Lattices
from .stencil import Stencil, frames

# Points looked up together, so that intermediate results stay in the cache and matrix products small (`small_matmul`).
POINTS_PER_STEP = 192


class FieldLookup:
    """A feature at the stencil around points, for one sun, or for light from elsewhere at each point."""

    def __init__(self, stencil: Stencil, lattices: Lattices, sun: np.ndarray):
        """sun: (3,) unit vector in the cube's frame."""
        self.lattices, self.sun = lattices, np.asarray(sun, np.float64)
        # Per point of the stencil: fine cells per cube edge, origin in fine cells, strides, and where its mip begins.
        levels = [lattices.levels[m] for m in stencil.mips]
        scale = np.array([level.scale for level in levels], np.float32)
        origin = np.array([level.origin * level.scale for level in levels], np.float32)
        self.stride = np.array([level.values.strides for level in levels], np.int32).T // lattices.values.itemsize
        self.row = self.stride[1].astype(np.float32)
        sizes = np.array([level.values.size for level in lattices.levels])
        begin = (np.cumsum(sizes) - sizes)[stencil.mips]
        first = np.array([level.first for level in levels]).T
        self.begin = (begin - (self.stride * first).sum(axis=0)).astype(np.int32)
        # Fine cells are linear in a point's position, frame and jitter: a product per axis gives those of all points.
        low, count = len(stencil.low), len(stencil.mips)
        self.terms = np.zeros((3, 7, count), np.float32)
        self.terms[:, 0], self.terms[:, 4] = scale, 1.0
        self.terms[:, 1:4, :low] = stencil.low.T * scale[:low]
        towards = np.zeros(count, np.float32)
        towards[low:] = stencil.high * scale[low:]
        self.terms[:, 5] = self.sun[:, None].astype(np.float32) * towards - origin
        self.terms[:, 6] = towards

    def __call__(
        self,
        positions: np.ndarray,
        omega: np.ndarray,
        view: np.ndarray,
        jitter: np.ndarray | None = None,
        towards: np.ndarray | None = None,
    ) -> np.ndarray:
        """The lattices' feature at points: float32 (N, points of the stencil).

        positions: (N, 3) in the cube's frame. omega: (V, 3) camera-ray directions. view: int (N,), direction of each
        point. jitter: (N, 3) in [-1/2, 1/2), offset of each point's lookups in fine cells; averaged over it, the
        nearest cell is linear interpolation, and cells leave no bands. towards: (V, 3), where the light of each
        direction comes from, if not from the sun.
        """
        features = np.empty((len(positions), self.begin.size), np.float32)
        for span, index in self.cells(positions, omega, view, jitter, towards):
            self.lattices.read(index, features[span])
        return features

    def cells(
        self,
        positions: np.ndarray,
        omega: np.ndarray,
        view: np.ndarray,
        jitter: np.ndarray | None = None,
        towards: np.ndarray | None = None,
    ) -> Iterator[tuple[slice, np.ndarray]]:
        """Spans of the points, and what a call reads at them: int32 (n, points of the stencil), into `values`."""
        count = len(positions)
        point = np.zeros((3, count, 6 if towards is None else 7), np.float32)
        point[..., 0], point[..., 5] = positions.T, 1.0
        if jitter is not None:
            point[..., 4] = jitter.T
        if towards is not None:
            point[..., 6] = (towards - self.sun).T.take(view, axis=1)
        turned = frames(omega, self.sun if towards is None else towards).astype(np.float32)
        for axis, rows in enumerate(turned.transpose(1, 0, 2)):
            point[axis, :, 1:4] = rows.take(view, axis=0)
        terms = self.terms[:, : point.shape[2]]
        for start in range(0, count, POINTS_PER_STEP):
            span = slice(start, start + POINTS_PER_STEP)
            # Rows and columns of a level are exact in single precision.
            cell = np.floor(point[1, span] @ terms[1])
            cell *= self.row
            cell += np.floor(point[2, span] @ terms[2])
            index = (point[0, span] @ terms[0]).astype(np.int32)
            index *= self.stride[0]
            index += cell.astype(np.int32)
            index += self.begin
            yield span, index


def distinct_rows(rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Run-length encoding of rows (N, k).

    Returns the numbers int (V,) of the rows that differ from the previous row, and int32 (N,) which of these each row
    equals.
    """
    new = np.ones(len(rows), bool)
    new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return np.flatnonzero(new), np.cumsum(new, dtype=np.int32) - np.int32(1)


def angle_to_sun(omega: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Angles gamma float32 (N,) between camera rays (N, 3) and the direction to the sun (3,), or of each (N, 3)."""
    omega, sun = np.asarray(omega, np.float64), np.asarray(sun, np.float64)
    cosine = product(omega, sun) if sun.ndim == 1 else (omega * sun).sum(axis=1)
    return np.arccos(np.clip(cosine, -1.0, 1.0)).astype(np.float32)
