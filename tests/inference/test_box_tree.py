# SPDX-License-Identifier: GPL-3.0-or-later
"""A tree of boxes holds each of them once, within all boxes above it."""

import numpy as np
import pytest

from inference.numerics.box_tree import box_tree


@pytest.mark.parametrize("count", [1, 2, 3, 37])
@pytest.mark.parametrize("spread", [1.0, 1e12])
def test_boxes_lie_within_those_above(count, spread):
    random = np.random.default_rng(count)
    corners = random.normal(size=(count, 8, 3)) * spread ** random.uniform(-0.5, 0.5, (count, 1, 1))
    boxes, contents = box_tree(corners)
    leaves = len(contents)
    assert sorted(contents[contents >= 0].tolist()) == list(range(count))
    for leaf, held in enumerate(contents, leaves):
        if held < 0:
            continue
        above = leaf
        while above:
            assert (boxes[above, 0] <= corners[held].min(axis=0)).all()
            assert (boxes[above, 1] >= corners[held].max(axis=0)).all()
            above //= 2
