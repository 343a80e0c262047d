# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasterization of triangles onto a regular grid of sample points."""

from collections.abc import Iterator

import numpy as np

from ..runtime.cancellation import NEVER, CancelToken

# Pairs of triangle and sample point tested at a time.
PAIRS_PER_BATCH = 1 << 18


def rasterize(
    corners: np.ndarray, value: np.ndarray, size: np.ndarray, cancel: CancelToken = NEVER
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield (flat index, value, triangle), each (N,), at the integer points of a raster that triangles cover.

    corners: (T, 3, 2), in raster coordinates, column and row. value: (T, 3), interpolated linearly. size: int
    (2,), columns and rows. Raises Cancelled.
    """
    first = np.ceil(np.clip(corners.min(axis=1), 0, size)).astype(int)
    last = np.floor(np.clip(corners.max(axis=1), -1, size - 1)).astype(int)
    cancel.check()
    spans = np.maximum(last - first + 1, 0)
    counts = spans.prod(axis=1)
    covering = np.flatnonzero(counts)
    ends = np.cumsum(counts[covering])
    start = 0
    while start < len(covering):
        cancel.check()
        done = ends[start - 1] if start else 0
        end = max(int(np.searchsorted(ends, done + PAIRS_PER_BATCH, side="right")), start + 1)
        triangle = np.repeat(covering[start:end], counts[covering[start:end]])
        number = np.arange(len(triangle)) - np.repeat(
            ends[start:end] - counts[covering[start:end]] - done, counts[covering[start:end]]
        )
        row, column = np.divmod(number, spans[triangle, 0])
        column += first[triangle, 0]
        row += first[triangle, 1]
        vertices = corners[covering[start:end]]
        owner = np.repeat(np.arange(end - start), counts[covering[start:end]])
        # Edge functions, proportional to barycentric coordinates.
        weights = []
        for tail, head in ((1, 2), (2, 0), (0, 1)):
            x, y = vertices[:, tail].T
            along_x, along_y = (vertices[:, head] - vertices[:, tail]).T
            weights.append(along_x[owner] * (row - y[owner]) - along_y[owner] * (column - x[owner]))
        a, b, c = weights
        hit = np.flatnonzero(((a >= 0.0) & (b >= 0.0) & (c >= 0.0)) | ((a <= 0.0) & (b <= 0.0) & (c <= 0.0)))
        a, b, c = a[hit], b[hit], c[hit]
        area = a + b + c
        if not area.all():
            hit, a, b, c, area = (values[area != 0.0] for values in (hit, a, b, c, area))
        triangle = triangle[hit]
        yield (
            row[hit] * size[0] + column[hit],
            (a * value[triangle, 0] + b * value[triangle, 1] + c * value[triangle, 2]) / area,
            triangle,
        )
        start = end
