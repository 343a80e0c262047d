# SPDX-License-Identifier: GPL-3.0-or-later
"""A binary tree of boxes, for rays that meet few of many."""

import numpy as np

# Bits of each coordinate in the order of boxes, and what boxes are larger than what they hold, over their coordinates.
BITS, MARGIN = 20, 1e-9
# Where boxes lie that hold nothing.
NOWHERE = 1e300


def box_tree(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Boxes float64 (2 L, 2, 3), lowest and highest corners, and what each of L leaves holds, int64 (L,), or -1.

    corners: (V, N, 3), around which V boxes lie. L is a power of two. Box 1 is the root, the parts of box n are 2 n and
    2 n + 1, and the leaves follow from L on, in the order of their places along a Morton curve (Morton 1966).
    """
    low, high = corners.min(axis=1), corners.max(axis=1)
    margin = MARGIN * np.maximum(np.abs(low), np.abs(high)) + MARGIN * (high - low)
    low, high = low - margin, high + margin
    middle = 0.5 * low + 0.5 * high
    extent = np.maximum(np.ptp(middle, axis=0).max(), 1e-300)
    cells = np.clip((middle - middle.min(axis=0)) / extent * 2.0**BITS, 0, 2**BITS - 1).astype(np.int64)
    code = np.zeros(len(low), np.int64)
    for bit in range(BITS):
        for axis in range(3):
            code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    order = np.argsort(code, kind="stable")
    leaves = 1 << (len(order) - 1).bit_length()
    boxes = np.empty((2 * leaves, 2, 3))
    boxes[:, 0], boxes[:, 1] = np.inf, -np.inf
    boxes[leaves : leaves + len(order), 0], boxes[leaves : leaves + len(order), 1] = low[order], high[order]
    count = leaves
    while count > 1:
        parts = boxes[count : 2 * count].reshape(-1, 2, 2, 3)
        count //= 2
        boxes[count : 2 * count, 0] = parts[:, :, 0].min(axis=1)
        boxes[count : 2 * count, 1] = parts[:, :, 1].max(axis=1)
    boxes[boxes[:, 0, 0] > boxes[:, 1, 0]] = NOWHERE
    contents = np.full(leaves, -1, np.int64)
    contents[: len(order)] = order
    return boxes, contents
