# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes at lower resolution, where memory does not allow all of it."""

import numpy as np
import pytest

from inference import Medium, Motion, SceneError, Settings, Volume, bake, render
from inference.grids.grid import Grid
from inference.plan.coarser import fitting_volumes, halved
from tests.support.volumes import SUN, camera, cloud

MEDIUM = Medium(8.0, 0.9, 0.5)
# What the network needs at least, in bytes.
LEAST = 800 << 20


def smooth(shape=(257, 40, 33), **options):
    """A long ellipsoid, whose shape is odd along two axes, in a sheared frame."""
    matrix = np.diag([1 / 257, 1 / 60, 1 / 50, 1.0])
    matrix[1, 0], matrix[:3, 3] = 0.001, [-0.5, -0.4, -0.3]
    axes = np.meshgrid(*[np.linspace(-1.0, 1.0, n) for n in shape], indexing="ij")
    return Volume(np.maximum(1.0 - sum(axis**2 for axis in axes), 0.0), matrix, "long", **options)


def test_half_the_resolution_keeps_what_there_is_where_it_is():
    volume = smooth()
    glow = np.stack([volume.density, 2.0 * volume.density, -volume.density], axis=3)
    volume = Volume(volume.density, volume.world_from_index, "long", glow, 2, scattering=(0.5 * volume.density,))
    volume.motion = Motion([np.eye(4), 2.0 * np.eye(4)], np.eye(4))
    coarse = halved(volume)
    assert coarse.motion is volume.motion
    assert coarse.density.shape == (129, 20, 17)
    assert 8.0 * coarse.density.sum(dtype=float) == pytest.approx(volume.density.sum(dtype=float), rel=1e-5)
    np.testing.assert_allclose(coarse.scattering[0], 0.5 * coarse.density, rtol=1e-5)
    emitted = [np.sign(e) * e.astype(float) ** 2 for e in (volume.emission, coarse.emission)]
    np.testing.assert_allclose(8.0 * emitted[1].sum(axis=(0, 1, 2)), emitted[0].sum(axis=(0, 1, 2)), rtol=1e-4)
    points = np.random.default_rng(0).uniform(-0.3, 0.2, (500, 3))
    fine, less = (Grid(v).sample_density(Grid(v).index(points).T.astype(np.float32)) for v in (volume, coarse))
    np.testing.assert_allclose(less, fine, atol=0.05)


def test_the_largest_grid_is_halved_first_and_all_of_its_instances():
    large, small = smooth(), smooth((256, 20, 20))
    moved = large.world_from_index.copy()
    moved[0, 3] += 3.0
    pairs = [(large, MEDIUM), (small, MEDIUM), (large.instance(moved, "again"), MEDIUM)]

    def needed(volumes):
        return sum({id(v.density): v.density.nbytes for v, _ in volumes}.values())

    found, warnings = fitting_volumes(pairs, needed, needed(pairs) // 2, True)
    assert found[0][0].density is found[2][0].density and found[1][0] is small
    np.testing.assert_allclose(found[2][0].world_from_index[:3, 3] - found[0][0].world_from_index[:3, 3], [3, 0, 0])
    assert len(warnings) == 1 and "again: rendered at 1/2 of its resolution" in warnings[0]
    assert fitting_volumes(pairs, needed, needed(pairs), False) == (pairs, [])
    for limit, adapts in ((needed(pairs) // 2, False), (1, True)):
        with pytest.raises(SceneError, match="raise the limit"):
            fitting_volumes(pairs, needed, limit, adapts)


@pytest.mark.slow
def test_a_render_that_needs_too_much_shows_less_detail_and_says_so():
    """A bake, whose light lies on the volume's voxels, is refused."""
    volume = smooth((400, 200, 200))
    limit = Settings(memory_limit=LEAST + (100 << 20))
    coarse, fine = (render([(volume, MEDIUM)], [SUN], camera(), settings) for settings in (limit, Settings()))
    assert any("1/2 of its resolution" in warning for warning in coarse.report.warnings)
    assert fine.report.warnings == []
    shown = fine.alpha > 0.02
    assert np.sqrt(((coarse.rgb - fine.rgb)[shown] ** 2).mean()) < 0.02 * fine.rgb[shown].mean()
    with pytest.raises(SceneError, match="raise the limit"):
        bake([(volume, MEDIUM)], [SUN], settings=limit)
    with pytest.raises(SceneError, match="raise the limit"):
        render([(cloud(), MEDIUM)], [SUN], camera(), Settings(memory_limit=1 << 20))
