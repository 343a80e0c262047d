# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers of a network, products with a matrix of weights and sums, by a compiled kernel.

numpy's own library for products does not know every processor and is up to five times slower there.
"""

import numpy as np

from ..kernels.library import call
from ..kernels.structures import PANEL

# Multiplications per call of the kernel: some 50 ms on the slowest processors.
MOST_PER_CALL = 500_000_000


class Layer:
    """A matrix that others are multiplied with from the left, and what is added to each row.

    matrix: float32 (inner, columns). bias: float32 (columns,), or None for 0. rectified: whether sums below 0 become 0.
    """

    def __init__(self, matrix: np.ndarray, bias: np.ndarray | None = None, rectified: bool = False):
        inner, self.columns = matrix.shape
        self._rectified, count = rectified, -(-self.columns // PANEL)
        padded = np.zeros((inner + 1, count * PANEL), np.float32)
        padded[:inner, : self.columns] = matrix
        if bias is not None:
            padded[inner, : self.columns] = bias
        self._panels = np.ascontiguousarray(padded[:inner].reshape(inner, count, PANEL).transpose(1, 0, 2))
        self._bias = padded[inner]

    def __call__(self, left: np.ndarray, added: np.ndarray | None = None, out: np.ndarray | None = None) -> np.ndarray:
        """left @ matrix + bias + added, float32 (N, columns). left: float32 (N, inner). added: float32 (N, columns).

        out: float32 (N, columns), contiguous, to hold the result.
        """
        left, inner = np.ascontiguousarray(left, np.float32), self._panels.shape[1]
        shape = len(left), self.columns
        if out is None:
            out = np.empty(shape, np.float32)
        if left.shape[1] != inner or out.shape != shape or added is not None and added.shape != shape:
            raise ValueError(f"{left.shape} does not fit a matrix of {inner} rows and {self.columns} columns")
        if added is not None:
            added = np.ascontiguousarray(added, np.float32)
        rows = max(MOST_PER_CALL // max(inner * self.columns, 1), 1)
        for first in range(0, len(out), rows):
            batch = slice(first, first + rows)
            call(
                "multiply",
                rows=len(out[batch]),
                inner=inner,
                columns=self.columns,
                left=left[batch],
                right=self._panels,
                bias=self._bias,
                added=None if added is None else added[batch],
                rectified=self._rectified,
                out=out[batch],
            )
        return out
