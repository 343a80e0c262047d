# SPDX-License-Identifier: GPL-3.0-or-later
"""Descriptors: inference's lattice lookup against interpolation at each point."""

import numpy as np
import pytest

from inference.features.descriptors import FieldLookup
from inference.features.mip_lattices import QUANTA, density_lattices, density_pyramid, margins, padded_levels
from inference.features.stencil import LAYER_POINTS, LOW_POINTS
from inference.paper.descriptors import describe
from inference.paper.phase_features import PhaseFeatures
from inference.paper.sun_lattices import SunLevels, sun_lattices, unit_optical_depths
from inference.scene.phase_function import henyey_greenstein
from training.data.descriptors import Levels, describe_points, stencil_points
from training.data.stencil import load_stencil

SUN = np.array([0.36, -0.48, 0.8])
SIGMA_HAT = 150.0


@pytest.fixture(scope="module")
def stencil():
    return load_stencil()


@pytest.fixture(scope="module")
def fields(stencil):
    random = np.random.default_rng(1)
    coarse = random.random((32, 32, 32)).astype(np.float32) ** 3
    level0 = coarse.repeat(8, 0).repeat(8, 1).repeat(8, 2)
    padded = padded_levels(density_pyramid(level0), stencil)
    return padded, unit_optical_depths(padded, SUN)


def lattices_of(stencil, fields, extent=(-0.5, 0.5)):
    """Of the density, for lookups, and of the transmittance."""
    density = density_lattices(fields[0], SIGMA_HAT, stencil, extent)
    return FieldLookup(stencil, density, SUN), sun_lattices(SunLevels(fields[1]), SIGMA_HAT, stencil, extent)


@pytest.fixture(scope="module")
def rays():
    random = np.random.default_rng(2)
    positions = random.uniform(-0.5, 0.5, (300, 3))
    omega = random.normal(size=(300, 3))
    return positions, omega / np.linalg.norm(omega, axis=1, keepdims=True)


def test_lattice_lookup_equals_interpolation_at_fine_cells(stencil, fields, rays):
    features, gamma = describe(*lattices_of(stencil, fields), PhaseFeatures(stencil, 0.6), *rays)
    expected = describe_points(stencil, Levels(*fields), *rays, SUN, np.full(300, SIGMA_HAT))
    # A point within rounding of a cell's border may fall on either side.
    different = np.abs(features[:2] - expected) > 1e-4
    assert different.mean() < 1e-4
    np.testing.assert_allclose(gamma, np.arccos(rays[1] @ SUN), atol=1e-4)


def test_sparse_stencil_reads_the_density_of_every_fourth_point(stencil, fields, rays):
    whole = FieldLookup(stencil, density_lattices(fields[0], SIGMA_HAT, stencil), SUN)
    sparse = stencil.sparse()
    pyramid = [level[m:-m, m:-m, m:-m] for level, m in zip(fields[0], margins(stencil))]
    lattices = density_lattices(padded_levels(pyramid, sparse), SIGMA_HAT, sparse)
    features = FieldLookup(sparse, lattices, SUN)(rays[0], rays[1], np.arange(300))
    assert features.shape == (300, 48)
    np.testing.assert_allclose(features, whole(rays[0], rays[1], np.arange(300))[:, ::4], atol=1e-6)


def test_cropped_lattices_give_the_same_descriptors(stencil, fields, rays):
    """Only what no stencil around these points reads is cropped."""
    positions = 0.1 + 0.05 * rays[0]
    whole = lattices_of(stencil, fields)
    cut = lattices_of(stencil, fields, (positions.min(axis=0), positions.max(axis=0)))
    assert cut[1].values.size < 0.1 * whole[1].values.size
    phase = PhaseFeatures(stencil, 0.6)
    np.testing.assert_array_equal(
        describe(*cut, phase, positions, rays[1])[0], describe(*whole, phase, positions, rays[1])[0]
    )


def test_jitter_averages_to_linear_interpolation(stencil, fields, rays):
    """Means over jitter change gradually where single lookups jump from cell to cell."""
    read = *lattices_of(stencil, fields), PhaseFeatures(stencil, 0.6)
    random = np.random.default_rng(3)
    steps, copies = 12, 400
    # A cell of mip 0 on either side of a jump in density.
    path = np.linspace(-1.0 / 256.0, 1.0 / 256.0, steps)[:, None] * [0.0, 1.0, 0.0] + [0.11, 2.0 / 32.0, -0.2]
    omega = np.broadcast_to(rays[1][:1], path.shape)
    plain = describe(*read, path, omega)[0][0, :, 0]
    jitter = random.uniform(-0.5, 0.5, (steps * copies, 3))
    many = describe(*read, path.repeat(copies, 0), omega.repeat(copies, 0), jitter)[0][0, :, 0]
    mean = many.reshape(steps, copies).mean(axis=1)
    assert np.count_nonzero(np.diff(plain)) == 1
    assert 0.0 < np.abs(np.diff(mean)).max() < 0.5 * np.abs(np.diff(plain)).max()


def test_stencil_follows_view_and_sun(stencil, rays):
    """Rotating view and sun together rotates the stencil with them."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    positions, omega = np.zeros_like(rays[0]), rays[1]
    points = stencil_points(stencil, positions, omega, SUN)
    turned = stencil_points(stencil, positions, omega @ turn.T, turn @ SUN)
    np.testing.assert_allclose(turned, points @ turn.T, atol=1e-6)
    # High-frequency points lie on the ray to the sun.
    np.testing.assert_allclose(points[0, LOW_POINTS:], stencil.high[:, None] * SUN, atol=1e-7)


def test_homogeneous_cube_at_its_centre(stencil):
    """All density 1: mu is one constant inside, and S of the centre has its closed form."""
    padded = padded_levels(density_pyramid(np.ones((256,) * 3, np.float32)), stencil)
    sun = np.array([0.0, 0.0, 1.0])
    transmittance = sun_lattices(SunLevels(unit_optical_depths(padded, sun)), 10.0, stencil)
    lookup = FieldLookup(stencil, density_lattices(padded, 10.0, stencil), sun)
    omega = np.array([[0.0, 1.0, 0.0]])
    features, _ = describe(lookup, transmittance, PhaseFeatures(stencil, 0.0), np.zeros((1, 3)), omega)
    inside = stencil.mips < 4
    np.testing.assert_allclose(features[0, 0, inside], np.log1p(10.0 / 64.0), rtol=1e-5)
    # The centre reads field 0: exp(-0.578 * 10 * 0.5), the sun half a cube away.
    np.testing.assert_allclose(features[1, 0, 0], np.exp(-0.578 * 10.0 * 0.5), rtol=0.02)
    # Isotropic scattering: P of the centre is log(1 + 1/(4 pi)).
    np.testing.assert_allclose(features[2, 0, 0], np.log1p(henyey_greenstein(0.0, 0.0)), rtol=1e-6)


def test_transmittance_outside_the_cube_is_that_of_the_boundary(stencil):
    """A.3: a point behind the cube is lit through it; one beside it is fully lit."""
    padded = padded_levels(density_pyramid(np.ones((256,) * 3, np.float32)), stencil)
    sun = np.array([0.0, 0.0, 1.0])
    lattices = sun_lattices(SunLevels(unit_optical_depths(padded, sun)), 3.0, stencil)
    mip = 5
    lattice = lattices.levels[mip]

    def read(x, y, z):
        cell = ((np.array([x, y, z]) - lattice.origin) * lattice.scale).astype(int) - lattice.first
        return lattice.values[tuple(cell)] / QUANTA

    behind = np.exp(-(0.578**mip) * 3.0)
    np.testing.assert_allclose(read(0.0, 0.0, -0.6), behind, rtol=0.02)
    np.testing.assert_allclose(read(0.0, 0.0, 0.6), 1.0, rtol=0.02)
    np.testing.assert_allclose(read(0.0, 0.6, -0.6), 1.0, rtol=0.02)
    assert sum(LAYER_POINTS) == 192
