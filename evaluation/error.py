# SPDX-License-Identifier: GPL-3.0-or-later
"""How far a rendered layer is from a reference that is itself noisy.

The reference comes as two independent halves A and B. A squared error against one half includes that half's noise; the
product (L - A)(L - B) does not, because the noises of A and B are independent of each other and of L:

    E[(L - A)(L - B)] = (L - reference)^2.

Images are linear radiance, (H, W) or (H, W, channels), premultiplied, on black.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

# Errors of neighbouring pixels are correlated, so that the bootstrap resamples tiles; resampling pixels would give too
# narrow intervals.
TILE = 8
RESAMPLES = 2000


@dataclass
class Estimate:
    """A value and its bootstrapped 95 % confidence interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{self.value:.4f} [{self.low:.4f}, {self.high:.4f}]"


def error_text(value: float, low: float | None = None, high: float | None = None) -> str:
    """An error and its 95 % interval for a table; "below" its upper end where noise hides the error."""
    hidden, interval = f"{value:.3f}" == "0.000", low is not None and high is not None
    if hidden:
        return f"below {high:.3f}" if interval and f"{high:.3f}" != "0.000" else "below the noise"
    return f"{value:.3f} ({low:.3f}–{high:.3f})" if interval else f"{value:.3f}"


def relative_rmse(layer: ArrayLike, a: ArrayLike, b: ArrayLike, mask: ArrayLike, seed: int = 0) -> Estimate:
    """sqrt(mean((L - A)(L - B))) / mean((A + B) / 2) over the pixels of `mask`.

    layer, a, b: (H, W) or (H, W, C). mask: bool (H, W). seed: of the bootstrap. Returns 0 if noise makes the mean
    product negative: the error is then below what the halves can resolve. Raises ValueError for shapes that differ, an
    empty mask and a black reference.
    """
    image, first, second, covered = _checked(layer, a, b, mask)
    squared = ((image - first) * (image - second)).mean(axis=-1)
    reference = ((first + second) / 2).mean(axis=-1)

    def statistic(sums: np.ndarray) -> np.ndarray:
        count, square, brightness = sums
        return np.sqrt(np.maximum(square / count, 0.0)) / (brightness / count)

    return _estimate(statistic, covered, seed, squared, reference)


def relative_bias(layer: ArrayLike, a: ArrayLike, b: ArrayLike, mask: ArrayLike, seed: int = 0) -> Estimate:
    """mean(L - (A + B) / 2) / mean((A + B) / 2) over the pixels of `mask`; positive if too bright.

    Arguments and errors as for `relative_rmse`.
    """
    image, first, second, covered = _checked(layer, a, b, mask)
    reference = ((first + second) / 2).mean(axis=-1)
    difference = image.mean(axis=-1) - reference

    def statistic(sums: np.ndarray) -> np.ndarray:
        _, deviation, brightness = sums
        return deviation / brightness

    return _estimate(statistic, covered, seed, difference, reference)


def paper_metric(layer: ArrayLike, a: ArrayLike, b: ArrayLike) -> float:
    """The paper's metric: 100 x RMSE of luma after ACES tone mapping of pi L, over the whole image.

    layer, a, b: (H, W) or (H, W, 3). The factor of pi is there because the published implementation's radiance is pi
    times the physical radiance. Tone mapping is not linear, so that very noisy halves give a slightly too large value.
    """
    luma, first, second = (_tone_mapped_luma(np.asarray(image, np.float64)) for image in (layer, a, b))
    return 100.0 * float(np.sqrt(max(0.0, np.mean((luma - first) * (luma - second)))))


def _tone_mapped_luma(radiance: np.ndarray) -> np.ndarray:
    """Rec. 709 luma of Narkowicz's fit of the ACES curve, applied to pi x radiance."""
    x = np.pi * np.maximum(radiance, 0.0)
    mapped = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)
    return mapped if mapped.ndim == 2 else mapped @ np.array([0.2126, 0.7152, 0.0722])


def _checked(
    layer: ArrayLike, a: ArrayLike, b: ArrayLike, mask: ArrayLike
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Images as float64 (H, W, C) and the mask as bool (H, W)."""
    images = [np.asarray(image, np.float64) for image in (layer, a, b)]
    covered = np.asarray(mask, bool)
    shapes = {image.shape for image in images}
    if len(shapes) != 1 or images[0].shape[:2] != covered.shape:
        raise ValueError(f"images and mask differ in size: {sorted(shapes)}, mask {covered.shape}")
    if not covered.any():
        raise ValueError("the mask is empty: no pixel shows the volume")
    first, second, third = (image if image.ndim == 3 else image[..., None] for image in images)
    if not (second + third)[covered].sum() > 0.0:
        raise ValueError("the reference is black where the layer shows the volume")
    return first, second, third, covered


def _estimate(
    statistic: Callable[[np.ndarray], np.ndarray], mask: np.ndarray, seed: int, *per_pixel: np.ndarray
) -> Estimate:
    """`statistic` of (pixel count, sums of `per_pixel`) over the mask, with its bootstrap over tiles.

    statistic: takes (1 + len(per_pixel), ...) sums and works along the trailing axes.
    """
    sums = np.stack([tile_sums(values * mask) for values in (np.ones(mask.shape), *per_pixel)])
    sums = sums[:, sums[0] > 0]
    tiles = sums.shape[1]
    drawn = np.random.default_rng(seed).integers(0, tiles, size=(RESAMPLES, tiles))
    low, high = np.percentile(statistic(sums[:, drawn].sum(axis=-1)), [2.5, 97.5])
    return Estimate(float(statistic(sums.sum(axis=-1))), float(low), float(high))


def tile_sums(image: np.ndarray) -> np.ndarray:
    """Sums over TILE x TILE pixels, flattened; tiles at the right and lower edges may be smaller."""
    rows, columns = np.arange(0, image.shape[0], TILE), np.arange(0, image.shape[1], TILE)
    return np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1).ravel()
