# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasterization of triangles onto a regular grid of sample points."""

from collections.abc import Iterator

import numpy as np

from ..runtime.cancellation import NEVER, CancelToken

# Pairs of triangle and sample point tested at a time.
PAIRS_PER_BATCH = 1 << 18


def rasterize(
    place: np.ndarray, value: np.ndarray, size: np.ndarray, cancel: CancelToken = NEVER
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield (flat index, value, triangle), each (N,), at the integer points of a raster that triangles cover.

    place: (T, 3, 2) corners in raster coordinates, column and row. value: (T, 3), interpolated linearly. size: int
    (2,), columns and rows. Raises Cancelled.
    """
    first = np.ceil(np.clip(place.min(axis=1), 0, size)).astype(int)
    last = np.floor(np.clip(place.max(axis=1), -1, size - 1)).astype(int)
    cancel.check()
    spans = np.maximum(last - first + 1, 0)
    counts = spans.prod(axis=1)
    some = np.flatnonzero(counts)
    ends = np.cumsum(counts[some])
    start = 0
    while start < len(some):
        cancel.check()
        done = ends[start - 1] if start else 0
        end = max(int(np.searchsorted(ends, done + PAIRS_PER_BATCH, side="right")), start + 1)
        triangle = np.repeat(some[start:end], counts[some[start:end]])
        number = np.arange(len(triangle)) - np.repeat(
            ends[start:end] - counts[some[start:end]] - done, counts[some[start:end]]
        )
        row, column = np.divmod(number, spans[triangle, 0])
        column += first[triangle, 0]
        row += first[triangle, 1]
        corners = place[some[start:end]]
        which = np.repeat(np.arange(end - start), counts[some[start:end]])
        # Edge functions, proportional to barycentric coordinates.
        weights = []
        for one, two in ((1, 2), (2, 0), (0, 1)):
            x, y = corners[:, one].T
            along_x, along_y = (corners[:, two] - corners[:, one]).T
            weights.append(along_x[which] * (row - y[which]) - along_y[which] * (column - x[which]))
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
