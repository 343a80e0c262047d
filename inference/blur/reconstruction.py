# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels of a blurred picture joined with those around them.

Where a picture is blurred, neighbouring pixels show the same through different eyes. Each pixel becomes a mean of those
around it, weighted by exp(-d (P + P') d / 2) for the displacement d and the sharpness P and P' of both pixels (an
axis-aligned filter, Mehta and others 2012, 10.1145/2366145.2366182, along any axes). A sharp pixel neither gives nor
takes anything.
"""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from ..kernels.library import call

#: Pixels on each side that are joined at most, and rows that a call joins.
REACH, ROWS = 4, 8
# Pixels on each side among which all eyes look, and the part of their rays that is none.
BESIDE, HIDDEN = 2, 1e-4


def join(images: Sequence[np.ndarray], sharpness: np.ndarray, each: Callable[..., Iterable[None]]) -> list[np.ndarray]:
    """Images float32 (rows, columns, ...) whose pixels are joined.

    sharpness: float32 (rows, columns, 4), inverse covariances xx, xy and yy times weights, and the weights. each: maps
    a function over numbers, possibly in parallel.
    """
    rows, columns = sharpness.shape[:2]
    # Pixels that show nothing are as sharp as what is around them.
    empty = sharpness[..., 3] == 0.0
    sums = np.where(empty[..., None], _around(sharpness), sharpness)
    inverse = sums[..., :3] / np.where(sums[..., 3:] > 0.0, sums[..., 3:], np.float32(1.0))
    inverse = np.ascontiguousarray(inverse, np.float32)
    image = np.concatenate([values.reshape(rows, columns, -1) for values in images], axis=2, dtype=np.float32)
    joined = np.empty_like(image)

    def fill(first: int) -> None:
        call(
            "join_pixels",
            rows=rows,
            columns=columns,
            values=image.shape[2],
            first=first,
            end=min(first + ROWS, rows),
            reach=REACH,
            sharpness=inverse,
            image=image,
            joined=joined,
        )

    for _ in each(fill, range(0, rows, ROWS)):
        pass
    ends = np.cumsum([int(np.prod(values.shape[2:], dtype=int)) for values in images])[:-1]
    return [part.reshape(values.shape) for part, values in zip(np.split(joined, ends, axis=2), images)]


def sharpness_where_swept(sharpness: np.ndarray, swept: np.ndarray) -> np.ndarray:
    """Sharpness of pixels, as of `join`, where surfaces that move hide what is behind them for a part of the time.

    swept: of the surfaces alone, its weights the parts of the pixels' rays that they end. Which part of the time a
    surface hides a pixel, few rays do not tell: such pixels are joined along its way, no farther than where all eyes
    look, so that what is behind stays sharp.
    """
    if not swept.any():
        return sharpness
    around, pixels = _around(swept, BESIDE), _around(np.ones_like(swept[..., :1]), BESIDE)[..., 0]
    partly = (around[..., 3] > 0.0) & (around[..., 3] < pixels * (1.0 - HIDDEN))
    around[..., [0, 2]] += around[..., 3:] / np.float32(BESIDE**2)
    return np.where(partly[..., None], around, sharpness + swept)


def _around(values: np.ndarray, reach: int = REACH) -> np.ndarray:
    """Sums over the pixels within reach, of values (rows, columns, ...)."""
    for axis in (0, 1):
        padded = np.pad(values, [(reach + 1, reach) if a == axis else (0, 0) for a in range(values.ndim)])
        sums = np.cumsum(padded, axis=axis, dtype=np.float64)
        count = values.shape[axis]
        span = [sums.take(range(first, first + count), axis=axis) for first in (2 * reach + 1, 0)]
        values = (span[0] - span[1]).astype(np.float32)
    return values
