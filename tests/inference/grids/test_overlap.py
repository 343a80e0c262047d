# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes that the network sees as one medium."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from inference import Medium, Volume, render
from inference.grids.grid import Grid
from inference.grids.merge import merge
from inference.plan.overlap import MAX_EXTENT_RATIO, overlapping
from tests.support.volumes import SUN, camera, cloud


def ball(centre=(0.0, 0.0, 0.0), radius=0.4, voxels=24, turn=(0.0, 0.0, 0.0), name="ball"):
    """A smooth ball of fog in a rotated grid, four voxels wider than the ball."""
    voxel = 2.0 * radius / (voxels - 4)
    axis = (np.arange(voxels) - 0.5 * (voxels - 1)) * voxel
    r = np.sqrt(sum(a**2 for a in np.meshgrid(axis, axis, axis, indexing="ij"))) / radius
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_euler("xyz", turn).as_matrix() * voxel
    matrix[:3, 3] = np.array(centre) - matrix[:3, :3] @ np.full(3, 0.5 * (voxels - 1))
    return Volume(np.clip(1.0 - r * r, 0.0, 1.0), matrix, name)


def merged(pairs):
    return merge([Grid(volume) for volume, _ in pairs], [medium for _, medium in pairs], "merged")


def amount(volume):
    return volume.density.sum(dtype=float) * abs(np.linalg.det(volume.world_from_index[:3, :3]))


def test_touching_volumes_are_merged_unless_one_is_much_smaller():
    first, second = ball(name="first"), ball((0.5, 0.0, 0.0), name="second")
    third, far = ball((1.0, 0.0, 0.0), name="third"), ball((5.0, 0.0, 0.0), name="far")
    fog = Medium(1.0)
    assert overlapping([(one, fog) for one in (first, far, second, third)]) == ([[0, 2, 3], [1]], [])
    speck = ball((0.1, 0.0, 0.0), radius=0.3 / MAX_EXTENT_RATIO)
    assert overlapping([(first, fog), (speck, fog)]) == ([[0], [1]], [(0, 1)])


def test_volumes_of_different_colour_channels_are_not_merged():
    """Neither takes light that the other scatters; one that only emits shines into both."""
    one, two = ball(name="one"), ball((0.5, 0.0, 0.0), name="two")
    red, blue, clear = (Medium(sigma_t) for sigma_t in ((1.0, 0.0, 0.0), (0.0, 0.0, 2.0), 0.0))
    assert overlapping([(one, red), (two, blue)]) == ([[0], [1]], [])
    assert overlapping([(one, red), (two, clear)]) == ([[0, 1]], [])


def test_what_is_merged_does_not_depend_on_the_order_of_volumes():
    rng, fog = np.random.default_rng(4), Medium(1.0)
    for _ in range(40):
        count = rng.integers(3, 12)
        volumes = [ball(rng.uniform(0.0, 2.5, 3), rng.choice([0.1, 0.3, 0.9]), 8, name=f"{n}") for n in range(count)]
        found = set()
        for order in (np.arange(count), rng.permutation(count), np.arange(count)[::-1]):
            groups, apart = overlapping([(volumes[v], fog) for v in order])
            named = [{frozenset(order[list(members)].tolist()) for members in each} for each in (groups, apart)]
            found.add(tuple(map(frozenset, named)))
        assert len(found) == 1


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.0), (0.4, 0.8, 0.3)])
def test_merging_keeps_extinction_where_it_is(turn):
    """The merged density is the sum of both, at every point and in total."""
    pairs = [
        (ball(), Medium((3.0, 6.0, 9.0), 0.9, 0.8)),
        (ball((0.4, 0.1, 0.0), 0.3, 40, turn), Medium(12.0, 0.5, 0.2)),
    ]
    volume, medium = merged(pairs)
    expected = sum(amount(v) * m.sigma_t for v, m in pairs)
    np.testing.assert_allclose(amount(volume) * medium.sigma_t, expected, rtol=5e-3)
    scattering = [amount(v) * m.sigma_t * m.albedo for v, m in pairs]
    np.testing.assert_allclose(medium.albedo, sum(scattering) / expected, rtol=5e-3)
    shares = [part.sum() / sum(scattering).sum() for part in scattering]
    assert medium.anisotropy == pytest.approx(shares[0] * 0.8 + shares[1] * 0.2, rel=5e-3)

    points = np.random.default_rng(0).uniform(-0.4, 0.7, size=(2000, 3))
    grids = [Grid(v) for v, _ in pairs] + [Grid(volume)]
    a, b, both = (grid.sample_density(grid.index(points).T.astype(np.float32)) for grid in grids)
    np.testing.assert_allclose(both * medium.sigma_t.mean(), 6.0 * a + 12.0 * b, atol=0.02 * 12.0)


@pytest.mark.slow
def test_merged_grids_are_no_finer_than_the_network_sees():
    fine = ball(voxels=300)
    volume, medium = merged([(fine, Medium(2.0)), (ball((0.1, 0.0, 0.0)), Medium(2.0))])
    assert 128 < max(volume.density.shape) <= 256
    assert amount(volume) * medium.sigma_t[0] == pytest.approx(2.0 * (amount(fine) + amount(ball())), rel=5e-3)


def test_a_volume_split_into_two_rotated_grids_renders_the_same():
    """Two copies of half the density, one in a rotated grid, equal the whole ball."""
    medium = Medium(20.0, 0.95, 0.5)
    one = render([(ball(voxels=64), medium)], [SUN], camera())
    half = Medium(10.0, 0.95, 0.5)
    two = render([(ball(voxels=64), half), (ball(voxels=64, turn=(0.4, 0.8, 0.3)), half)], [SUN], camera())
    scale = one.multiple.mean()
    assert np.sqrt(((two.multiple - one.multiple) ** 2).mean()) < 0.03 * scale
    assert two.multiple.mean() == pytest.approx(scale, rel=0.02)


def test_an_overlapping_absorber_lowers_the_albedo():
    """Black fog of the same shape and extinction halves the albedo and doubles the extinction."""
    whole = cloud()
    mixed = render([(whole, Medium(10.0, 1.0)), (whole, Medium(10.0, 0.0))], [SUN], camera())
    expected = render([(whole, Medium(20.0, 0.5))], [SUN], camera())
    np.testing.assert_allclose(mixed.multiple, expected.multiple, rtol=0.01, atol=1e-3 * expected.multiple.max())
