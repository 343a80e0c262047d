# SPDX-License-Identifier: GPL-3.0-or-later
"""Neighbouring samples of deep pixels are joined where that changes what shows in front of any depth by little."""

import numpy as np

# What may change in front of any depth: of the opacity, and of each colour relative to the pixel's brightest.
TOLERANCE = 0.003


def thinned(knots: np.ndarray, added: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Which of the intervals between the knots of P pixels begin a sample, and how many each sample joins.

    knots: (P, n + 1), ascending depths. added: (P, n, 4), colour and opacity that each interval adds to the pixel. Both
    results are (P, n), the second 0 where no sample begins. Pairs of neighbours are joined, then pairs of pairs, where
    all that they join lies within TOLERANCE of the sample that takes its place.
    """
    pixels, count = added.shape[:2]
    size = 1 << max(count - 1, 0).bit_length()
    knots = np.concatenate([knots, np.repeat(knots[:, -1:], size - count, axis=1)], axis=1)
    before = np.zeros((pixels, size + 1, 4))
    np.cumsum(np.concatenate([added, np.zeros((pixels, size - count, 4))], axis=1), axis=1, out=before[:, 1:])
    tolerance = np.full((pixels, 4), TOLERANCE)
    tolerance[:, :3] *= np.maximum(before[:, -1, :3].max(axis=1, keepdims=True), 1e-30)
    joined, whole = np.ones((pixels, size), np.int64), np.ones((pixels, size), bool)
    length = 2
    while length <= size:
        starts = np.arange(0, size, length)
        whole = whole[:, ::2] & whole[:, 1::2]
        some, block = np.nonzero(whole)
        first = starts[block]
        end = first + length
        inside = first[:, None] + np.arange(1, length)
        begun, span = before[some, first], before[some, end] - before[some, first]
        share = share_of(knots[some[:, None], inside], (knots[some, first], knots[some, end]), begun[:, 3], span[:, 3])
        error = before[some[:, None], inside] - begun[:, None]
        error -= share[..., None] * span[:, None]
        good = (np.abs(error, out=error) <= tolerance[some, None]).all(axis=(1, 2))
        whole[some[~good], block[~good]] = False
        joined[some[good], first[good] + length // 2] = 0
        joined[some[good], first[good]] = length
        length *= 2
    joined = joined[:, :count]
    # Beyond the last interval there is nothing to join.
    joined = np.where(joined > 0, np.minimum(joined, count - np.arange(count)), 0)
    return joined > 0, joined


def share_of(
    depth: np.ndarray, ends: tuple[np.ndarray, np.ndarray], before: np.ndarray, added: np.ndarray
) -> np.ndarray:
    """Share (N, K) of a sample's light in front of depths (N, K) within it.

    ends: where it begins and ends, (N,) each. before, added: opacity (N,) in front of it, and what it adds to that.
    """
    front, back = ends
    extent = np.where(back > front, back - front, 1.0)[:, None]
    fraction = np.where((back > front)[:, None], (depth - front[:, None]) / extent, 1.0)
    opacity = np.clip(added / np.maximum(1.0 - before, 1e-12), 0.0, 1.0 - 1e-12)[:, None]
    told = opacity > 1e-9
    grown = -np.expm1(fraction * np.log1p(-opacity)) / np.where(told, opacity, 1.0)
    return np.where(told, grown, fraction)
