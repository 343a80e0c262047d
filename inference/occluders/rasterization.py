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
        at = np.stack([column, row], axis=1) + first[triangle]
        edges = []
        for one, two in ((1, 2), (2, 0), (0, 1)):
            along, off = place[triangle, two] - place[triangle, one], at - place[triangle, one]
            edges.append(along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0])
        # Edge functions, proportional to barycentric coordinates.
        weights = np.stack(edges, axis=1)
        area = weights.sum(axis=1)
        hit = (area != 0.0) & (np.all(weights >= 0.0, axis=1) | np.all(weights <= 0.0, axis=1))
        yield (
            at[hit, 1] * size[0] + at[hit, 0],
            (weights[hit] * value[triangle[hit]]).sum(axis=1) / area[hit],
            triangle[hit],
        )
        start = end
