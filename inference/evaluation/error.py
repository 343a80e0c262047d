"""How far a rendered layer is from a reference that is itself noisy.

The reference comes as two independent halves A and B. A squared error against one half
keeps that half's noise; the product (L - A)(L - B) does not, because the noises of A and B
are independent of each other and of L:
    E[(L - A)(L - B)] = (L - reference)^2.

Framebuffer are linear radiance, (H, W) or (H, W, channels), premultiplied, on black.
"""

from dataclasses import dataclass

import numpy as np

# Errors of neighbouring pixels go together (a cloud's edge too bright, its core too dark), so the
# bootstrap draws whole tiles; drawing single pixels would promise intervals that are too narrow.
TILE = 8
RESAMPLES = 2000


@dataclass
class Estimate:
    """A figure and its bootstrap 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self):
        return f"{self.value:.4f} [{self.low:.4f}, {self.high:.4f}]"


def relative_rmse(layer, a, b, mask, seed=0) -> Estimate:
    """sqrt(mean((L - A)(L - B))) / mean((A + B) / 2) over the pixels of `mask`.

    layer, a, b: (H, W) or (H, W, C). mask: bool (H, W).
    Where noise makes the mean product negative the error is below what the halves can
    resolve and 0 is returned.
    Raises ValueError for shapes that differ, an empty mask or a black reference.
    """
    layer, a, b, mask = _checked(layer, a, b, mask)
    squared = ((layer - a) * (layer - b)).mean(axis=-1)
    reference = ((a + b) / 2).mean(axis=-1)

    def statistic(sums):
        count, square, brightness = sums
        return np.sqrt(np.maximum(square / count, 0.0)) / (brightness / count)

    return _estimate(statistic, mask, seed, squared, reference)


def relative_bias(layer, a, b, mask, seed=0) -> Estimate:
    """mean(L - (A + B) / 2) / mean((A + B) / 2) over the pixels of `mask`; positive: too bright.

    Arguments and errors as for `relative_rmse`.
    """
    layer, a, b, mask = _checked(layer, a, b, mask)
    reference = ((a + b) / 2).mean(axis=-1)
    difference = layer.mean(axis=-1) - reference

    def statistic(sums):
        _, deviation, brightness = sums
        return deviation / brightness

    return _estimate(statistic, mask, seed, difference, reference)


def paper_metric(layer, a, b) -> float:
    """The paper's figure: 100 x RMSE of luma after ACES tone mapping of pi L, over the whole image.

    layer, a, b: (H, W) or (H, W, 3). The published implementation's radiance is pi times
    physical, hence the factor. Split halves as above; tone mapping bends the noise of each half
    a little, so very noisy halves read slightly too high.
    """
    layer, a, b = (_tone_mapped_luma(np.asarray(image, np.float64)) for image in (layer, a, b))
    return 100.0 * float(np.sqrt(max(0.0, np.mean((layer - a) * (layer - b)))))


def _tone_mapped_luma(radiance: np.ndarray) -> np.ndarray:
    """Rec. 709 luma of Narkowicz's fit of the ACES curve, applied to pi x radiance."""
    x = np.pi * np.maximum(radiance, 0.0)
    mapped = np.clip(x * (2.51 * x + 0.03) / (x * (2.43 * x + 0.59) + 0.14), 0.0, 1.0)
    return mapped if mapped.ndim == 2 else mapped @ np.array([0.2126, 0.7152, 0.0722])


def _checked(layer, a, b, mask):
    """Framebuffer as float64 (H, W, C) and the mask as bool (H, W)."""
    images = [np.asarray(image, np.float64) for image in (layer, a, b)]
    mask = np.asarray(mask, bool)
    shapes = {image.shape for image in images}
    if len(shapes) != 1 or images[0].shape[:2] != mask.shape:
        raise ValueError(f"images and mask differ in size: {sorted(shapes)}, mask {mask.shape}")
    if not mask.any():
        raise ValueError("the mask is empty: no pixel shows the volume")
    layer, a, b = (image if image.ndim == 3 else image[..., None] for image in images)
    if not (a + b)[mask].sum() > 0.0:
        raise ValueError("the reference is black where the layer shows the volume")
    return layer, a, b, mask


def _estimate(statistic, mask, seed, *per_pixel) -> Estimate:
    """`statistic` of (pixel count, sums of `per_pixel`) over the mask, with its tile bootstrap.

    statistic: takes (1 + len(per_pixel), ...) sums and works along the trailing axes.
    """
    sums = np.stack([tile_sums(values * mask) for values in (np.ones(mask.shape), *per_pixel)])
    sums = sums[:, sums[0] > 0]
    tiles = sums.shape[1]
    drawn = np.random.default_rng(seed).integers(0, tiles, size=(RESAMPLES, tiles))
    low, high = np.percentile(statistic(sums[:, drawn].sum(axis=-1)), [2.5, 97.5])
    return Estimate(float(statistic(sums.sum(axis=-1))), float(low), float(high))


def tile_sums(image: np.ndarray) -> np.ndarray:
    """Sums over TILE x TILE pixels, flattened; tiles at the right and lower edge may be smaller."""
    rows, columns = np.arange(0, image.shape[0], TILE), np.arange(0, image.shape[1], TILE)
    return np.add.reduceat(np.add.reduceat(image, rows, axis=0), columns, axis=1).ravel()
