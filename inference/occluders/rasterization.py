# SPDX-License-Identifier: GPL-3.0-or-later
"""Rasterization of triangles onto a regular grid of sample points."""

from collections.abc import Iterator, Sequence

import numpy as np

from ..kernels.library import call
from ..runtime.cancellation import NEVER, CancelToken

# Pairs of triangle and sample point tested at a time, by numpy and by one call of the kernel.
PAIRS_PER_BATCH, PAIRS_PER_CALL = 1 << 18, 1 << 22
# Pairs from which on triangles are taken from the nearest to the farthest, and hidden ones left out.
MANY_PAIRS = 4 * PAIRS_PER_BATCH
# Triangles of small surfaces that are taken together: each call of numpy takes as long as thousands of triangles.
TRIANGLES_PER_BATCH = 1 << 15


def batches(surfaces: Sequence[np.ndarray]) -> Iterator[np.ndarray]:
    """Triangles (T, 3, 3) of surfaces in their order, those of small surfaces joined, without copies of large ones."""
    ends = np.cumsum([len(triangles) for triangles in surfaces])
    begin = 0
    while begin < len(surfaces):
        before = ends[begin - 1] if begin else 0
        end = max(int(np.searchsorted(ends, before + TRIANGLES_PER_BATCH, side="right")), begin + 1)
        yield np.concatenate(surfaces[begin:end]) if end - begin > 1 else surfaces[begin]
        begin = end


def rasterize_nearest(
    corners: np.ndarray, value: np.ndarray, size: np.ndarray, cancel: CancelToken = NEVER
) -> tuple[np.ndarray, np.ndarray]:
    """Largest value float64 (rows, columns) at the integer points of a raster, and int, the triangle that has it.

    -inf and -1 where there is no triangle. Parameters as of `rasterize`. Raises Cancelled.

    Where triangles cover each other many times, those that a pyramid of the values found so far hides are left out
    (Greene, Kass and Miller 1993).
    """
    first, last = _spans(corners, size)
    counts, most = np.maximum(last - first + 1, 0).prod(axis=1), value.max(axis=1, initial=-np.inf)
    order = np.flatnonzero(counts)
    pairs = counts.sum()
    if pairs > MANY_PAIRS:
        order, pairs = order[np.argsort(-most[order], kind="stable")], PAIRS_PER_BATCH
    largest, number = np.full(size[::-1], -np.inf), np.full(size[::-1], -1, np.int64)
    while len(order):
        end = max(int(np.searchsorted(np.cumsum(counts[order]), pairs, side="right")), 1)
        taken, order = order[:end], order[end:]
        for part in np.split(taken, np.flatnonzero(np.diff(np.cumsum(counts[taken]) // PAIRS_PER_CALL)) + 1):
            cancel.check()
            fill(corners[part], value[part], part, (first[part], last[part]), (largest, number))
        if len(order):
            order = order[most[order] > _least(largest, first[order], last[order])]
        pairs *= 2
    return largest, number


def fill(
    corners: np.ndarray,
    value: np.ndarray,
    numbers: np.ndarray,
    spans: tuple[np.ndarray, np.ndarray],
    raster: tuple[np.ndarray, np.ndarray],
) -> None:
    """Add triangles to a raster whose points keep the largest value, and the last triangle that has it.

    corners: (T, 3, 2), value: (T, 3), as of `rasterize`. numbers: int (T,), of the triangles. spans: int (T, 2) each,
    first and last column and row of the boxes around them, within the raster. raster: values float64 (rows, columns),
    and numbers int64 (rows, columns), modified.
    """
    call(
        "fill_raster",
        triangles=len(corners),
        rows=raster[0].shape[0],
        columns=raster[0].shape[1],
        corners=np.ascontiguousarray(corners, np.float64),
        value=np.ascontiguousarray(value, np.float64),
        first=np.ascontiguousarray(spans[0], np.int64),
        last=np.ascontiguousarray(spans[1], np.int64),
        taken=np.ascontiguousarray(numbers, np.int64),
        largest=raster[0],
        number=raster[1],
    )


def rasterize(
    corners: np.ndarray, value: np.ndarray, size: np.ndarray, cancel: CancelToken = NEVER
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield (flat index, value, triangle), each (N,), at the integer points of a raster that triangles cover.

    corners: (T, 3, 2), in raster coordinates, column and row. value: (T, 3), interpolated linearly. size: int
    (2,), columns and rows. Raises Cancelled.
    """
    first, last = _spans(corners, size)
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


def _least(values: np.ndarray, first: np.ndarray, last: np.ndarray) -> np.ndarray:
    """At most the least of values (rows, columns) in rectangles, (R,), which include first and last, column and row.

    first, last: int (R, 2).
    """
    least = np.empty(len(first))
    # In level k of the pyramid an element is the least of 2^k x 2^k; a rectangle meets at most 2 x 2 of its level.
    levels = np.ceil(np.log2((last - first).max(axis=1) + 1)).astype(int)
    for level in range(levels.max() + 1):
        at = levels == level
        (i, j), (k, l) = first[at].T >> level, last[at].T >> level
        least[at] = np.min([values[j, i], values[j, k], values[l, i], values[l, k]], axis=0)
        values = np.pad(values, [(0, n % 2) for n in values.shape], constant_values=np.inf)
        values = np.minimum(values[::2], values[1::2])
        values = np.minimum(values[:, ::2], values[:, 1::2])
    return least


def _spans(corners: np.ndarray, size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """First and last column and row int (T, 2) that the boxes around triangles (T, 3, 2) meet in a raster."""
    first = np.ceil(np.clip(corners.min(axis=1), 0, size)).astype(int)
    return first, np.floor(np.clip(corners.max(axis=1), -1, size - 1)).astype(int)
