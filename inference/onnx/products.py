# SPDX-License-Identifier: GPL-3.0-or-later
"""Products with a matrix of weights, by a compiled kernel.

numpy's own library for products does not know every processor and is up to five times slower there.
"""

import numpy as np

from ..kernels.library import call
from ..kernels.structures import PANEL

# Multiplications per call of the kernel: about 50 ms on the slowest processors.
MOST_PER_CALL = 500_000_000


class Weights:
    """A matrix that other matrices are multiplied with from the left.

    matrix: float32 (inner, columns).
    """

    def __init__(self, matrix: np.ndarray):
        inner, columns = matrix.shape
        self._matrix = matrix
        panels = np.zeros((-(-columns // PANEL), inner, PANEL), np.float32)
        for number, panel in enumerate(panels):
            block = matrix[:, number * PANEL : (number + 1) * PANEL]
            panel[:, : block.shape[1]] = block
        self._panels = panels

    def product(self, left: np.ndarray) -> np.ndarray:
        """left @ matrix, float32 (n, columns); left: float32 (n, inner)."""
        left = np.ascontiguousarray(left, np.float32)
        (count, inner), columns = left.shape, self._matrix.shape[1]
        if inner != len(self._matrix):
            raise ValueError(f"{inner} columns cannot be multiplied with {len(self._matrix)} rows")
        out = np.empty((count, columns), np.float32)
        rows = max(MOST_PER_CALL // max(inner * columns, 1), 1)
        for first in range(0, count, rows):
            batch, products = left[first : first + rows], out[first : first + rows]
            call(
                "multiply",
                rows=len(batch),
                inner=inner,
                columns=columns,
                left=batch,
                right=self._panels,
                out=products,
            )
        return out
