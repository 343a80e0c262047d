# SPDX-License-Identifier: GPL-3.0-or-later
"""Pixels of blurred pictures joined with those around."""

import numpy as np
import pytest

from inference.blur.reconstruction import REACH, join


def joined(image, inverse):
    """The same in numpy, float32 (rows, columns, values); inverse: (rows, columns, 3)."""
    rows, columns = image.shape[:2]
    total, weights = image.astype(np.float64).copy(), np.ones((rows, columns, 1))
    for down in range(-REACH, REACH + 1):
        for across in range(-REACH, REACH + 1):
            here = slice(max(-down, 0), rows - max(down, 0)), slice(max(-across, 0), columns - max(across, 0))
            there = slice(max(down, 0), rows + min(down, 0)), slice(max(across, 0), columns + min(across, 0))
            if (down, across) == (0, 0):
                continue
            xx, xy, yy = np.moveaxis(inverse[here] + inverse[there], -1, 0)
            square = across**2 * xx + 2 * across * down * xy + down**2 * yy
            weight = np.where(square < 16.0, (1.0 - np.minimum(square, 16.0) / 16.0) ** 8, 0.0)[..., None]
            total[here] += weight * image[there]
            weights[here] += weight
    return total / weights


def test_the_kernel_does_what_numpy_does():
    random = np.random.default_rng(0)
    colour, alpha = random.random((21, 17, 3), np.float32), random.random((21, 17), np.float32)
    axes = random.normal(0.0, 1.5, (21, 17, 2, 2)) * random.random((21, 17, 1, 1)) ** 2
    full = axes @ np.swapaxes(axes, -1, -2)
    weight = random.random((21, 17, 1)) + 0.1
    inverse = np.stack([full[..., 0, 0], full[..., 0, 1], full[..., 1, 1]], axis=-1)
    sharpness = np.concatenate([inverse * weight, weight], axis=-1).astype(np.float32)
    found = join([colour, alpha], sharpness, map)
    image = np.concatenate([colour, alpha[..., None]], axis=-1)
    expected = joined(image, inverse)
    assert found[0].shape == (21, 17, 3) and found[1].shape == (21, 17)
    assert np.abs(np.concatenate([found[0], found[1][..., None]], axis=-1) - expected).max() < 1e-4


def test_sharp_pixels_stay_and_what_is_blurred_along_one_axis_is_joined_along_it():
    image = np.zeros((9, 25), np.float32)
    image[4, 12] = 1.0
    sharp = np.ones((9, 25, 4), np.float32) * [40.0, 0.0, 40.0, 1.0]
    assert np.array_equal(join([image], sharp.astype(np.float32), map)[0], image)
    along = (np.ones((9, 25, 4)) * [0.05, 0.0, 40.0, 1.0]).astype(np.float32)
    [found] = join([image], along, map)
    assert found[4, 10] > 0.05 and found[[3, 5]].max() == 0.0
    assert found.sum() == pytest.approx(1.0, rel=0.1)
