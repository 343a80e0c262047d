# SPDX-License-Identifier: GPL-3.0-or-later
"""Discrete ordinates: closed forms, the path tracer, symmetry, surfaces, and lookups by networks and camera rays."""

import numpy as np
import pytest

from inference import Volume
from inference.grids.working_cube import fit_cube
from inference.network.predictor import MAX_FLUENCE
from inference.scene.phase_function import reduced_anisotropy
from inference.source_terms.cell_sources import SunBeam
from inference.transport import scattered_fluence
from inference.transport.discrete_ordinates import CELLS, DiscreteOrdinates
from inference.transport.ordinates import STEPS, solid_angles
from tests.reference.march import cells_at, weights_towards
from training.tracer.path_tracer import Sampling, Scene, Vertices, trace_points

UP = np.array([0.0, 0.0, 1.0])
SLANT = np.array([0.48, 0.6, 0.64])


def middles(cells=CELLS):
    axis = (np.arange(cells) + 0.5) / cells - 0.5
    return np.meshgrid(axis, axis, axis, indexing="ij")


@pytest.fixture(scope="module")
def cloud():
    """A ball with holes."""
    x, y, z = middles()
    inside = x**2 + y**2 + z**2 < 0.2
    return np.where(inside, 1.0 + 0.8 * np.sin(20 * x) * np.cos(17 * y + 9 * z), 0.0).astype(np.float32)


def test_directions_and_weights_integrate_polynomials_over_the_sphere():
    """Lebedev's rule of 26 points is exact to degree 7."""
    steps = np.concatenate([sign * s for s in STEPS for sign in (1, -1)])
    assert len(np.unique(steps, axis=0)) == 26
    u, weights = steps / np.linalg.norm(steps, axis=1, keepdims=True), solid_angles(steps)
    for powers, expected in (
        ((0, 0, 0), 1),
        ((2, 0, 0), 1 / 3),
        ((2, 2, 0), 1 / 15),
        ((2, 2, 2), 1 / 105),
        ((0, 6, 0), 1 / 7),
    ):
        assert weights @ np.prod(u ** np.array(powers), axis=1) == pytest.approx(expected, abs=1e-12)


def test_thin_fog_is_single_scattering():
    """In the middle of a thin cube the fluence is sigma times the mean distance to its faces.

    Over the 26 directions: 0.689, where the mean over all is 0.611.
    """
    density, sigma = np.ones((CELLS,) * 3, np.float32), 1e-3
    fluence = DiscreteOrdinates(density, sigma, 0.0).solve(SunBeam(SLANT))[0]
    steps = np.concatenate(STEPS)
    expected = sigma * 2.0 * solid_angles(steps) @ (0.5 * np.linalg.norm(steps, axis=1))
    half = CELLS // 2
    assert fluence[half - 1 : half + 1, half - 1 : half + 1, half - 1 : half + 1].mean() == pytest.approx(
        expected, rel=0.01
    )


@pytest.mark.parametrize(
    "sigma_hat, anisotropy, tolerance",
    [
        (5.0, 0.0, 0.06),
        pytest.param(40.0, 0.0, 0.13, marks=pytest.mark.slow),
        (40.0, -0.3, 0.1),
        pytest.param(100.0, 0.5, 0.12, marks=pytest.mark.slow),
    ],
)
def test_it_is_close_to_the_path_tracer(cloud, sigma_hat, anisotropy, tolerance):
    """For nearly isotropic scattering: the radiance scattered towards the camera, inside and near the boundary."""
    positions = np.array(
        [[0.0, 0.0, 0.1], [0.2, -0.1, -0.2], [-0.25, 0.25, 0.0], [0.05, -0.38, 0.02], [0.02, 0.03, 0.39]]
    )
    omega = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.6, 0.0, 0.8], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]])
    vertices = Vertices(positions, omega, sigma_hat, anisotropy, [1.0])
    traced = trace_points(Scene(cloud, SLANT), vertices, Sampling(20000, seed=2))[:, 0, 0]
    cells = scattered_fluence.fluence_lattice(
        DiscreteOrdinates(cloud, sigma_hat, anisotropy).solve(SunBeam(SLANT))
    ).astype(np.float32)
    read = scattered_fluence.FluenceLattice(cells).read(positions, omega, SLANT, anisotropy)
    radiance = np.exp(read[:, scattered_fluence.PROBES]) / (4.0 * np.pi)
    # What counts as unscattered is missing here.
    share = radiance / traced
    if anisotropy == 0.0:
        np.testing.assert_allclose(radiance, traced, rtol=tolerance)
    else:
        assert share.std() / share.mean() < tolerance


def test_rotating_volume_and_sun_rotates_the_fluence(cloud):
    light = DiscreteOrdinates(cloud, 60.0, 0.6).solve(SunBeam(SLANT))
    turned = DiscreteOrdinates(np.ascontiguousarray(cloud.transpose(1, 2, 0)[:, :, ::-1]), 60.0, 0.6).solve(
        SunBeam(SLANT[[1, 2, 0]] * [1, 1, -1])
    )
    expected = light[[0, 2, 3, 1]].transpose(0, 2, 3, 1)[:, :, :, ::-1] * np.array([1, 1, 1, -1])[:, None, None, None]
    np.testing.assert_allclose(turned, expected, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("sigma_hat", [1.0, 50.0, 2000.0])
@pytest.mark.parametrize("anisotropy", [-0.3, 0.0, 0.857, 0.95])
def test_the_fluence_is_neither_negative_nor_above_any_mediums_bound(cloud, sigma_hat, anisotropy):
    fluence, *flux = DiscreteOrdinates(cloud, sigma_hat, anisotropy).solve(SunBeam(SLANT))
    assert np.all(fluence >= 0.0) and fluence.max() < MAX_FLUENCE
    assert np.all(np.sqrt(sum(f**2 for f in flux)) <= fluence * (1.0 + 1e-4) + 1e-6)


@pytest.mark.parametrize("sigma_hat, anisotropy", [(150.0, 0.4), (300.0, 0.0), (400.0, 0.857)])
def test_more_sweeps_change_little(cloud, monkeypatch, sigma_hat, anisotropy):
    few = DiscreteOrdinates(cloud, sigma_hat, anisotropy).solve(SunBeam(SLANT))[0]
    for name, value in (("FINE_SWEEPS", 40), ("SWEEPS", 40), ("CONVERGED", 1e-6)):
        monkeypatch.setattr(f"inference.transport.discrete_ordinates.{name}", value)
    many = DiscreteOrdinates(cloud, sigma_hat, anisotropy).solve(SunBeam(SLANT))[0]
    assert np.abs(few - many).sum() < 0.03 * many.sum()


def rectangle(z, low=-0.6, high=0.6):
    corners = np.array([[low, low, z], [high, low, z], [high, high, z], [low, high, z]])
    return np.stack([corners[[0, 1, 2]], corners[[0, 2, 3]]])


def test_behind_a_wall_it_is_dark_and_before_it_is_half_a_cube(cloud):
    x, y, z = middles()
    half = np.where(z > 0.0, cloud, 0.0).astype(np.float32)
    lit = (z > 0.0).astype(np.float32)
    walled = DiscreteOrdinates(cloud, 30.0, 0.5, rectangle(0.0)).solve(SunBeam(UP, lit))[0]
    alone = DiscreteOrdinates(half, 30.0, 0.5).solve(SunBeam(UP))[0]
    # Light that goes down through an empty half of the cube does not return, as at the wall.
    np.testing.assert_allclose(walled[..., CELLS // 2 + 1 :], alone[..., CELLS // 2 + 1 :], rtol=0.05, atol=0.01)
    assert walled[..., : CELLS // 2].max() < 1e-6


def test_light_stays_outside_a_box(cloud):
    """Six walls around the middle: dark inside, and darker than without them outside."""
    low, high = -0.15, 0.15
    sides = np.concatenate(
        [rectangle(z, low, high)[..., order] for z in (low, high) for order in ((0, 1, 2), (1, 2, 0), (2, 0, 1))]
    )
    ordinates = DiscreteOrdinates(cloud, 30.0, 0.5, sides)
    box = np.all([np.abs(x) < high for x in middles()], axis=0)
    np.testing.assert_array_equal(ordinates.boundaries.inside, box)
    found, free = (
        ordinates.solve(SunBeam(UP, (~box).astype(np.float32)))[0],
        DiscreteOrdinates(cloud, 30.0, 0.5).solve(SunBeam(UP))[0],
    )
    assert found[box].max() < 1e-2 * free[box].min() and found.sum() < 0.9 * free.sum()


def test_lookups_between_cells_are_exact_for_linear_fields():
    """Linear in the logarithm of the fluence and in the flux."""
    x, y, z = middles()
    fluence = np.exp(0.5 + 0.8 * x - 0.4 * y + 0.3 * z)
    light = np.stack([fluence, *(fluence * f for f in (0.1 * x, 0.2 + 0.1 * y, -0.3 * z))]).astype(np.float32)
    cells = scattered_fluence.fluence_lattice(light).astype(np.float32)
    random = np.random.default_rng(3)
    p, w = random.uniform(-0.44, 0.44, (50, 3)), random.normal(size=(50, 3))
    w /= np.linalg.norm(w, axis=1, keepdims=True)
    read = scattered_fluence.FluenceLattice(cells).read(p, w, SLANT, 0.6)
    slope, h = np.array([0.8, -0.4, 0.3]), scattered_fluence.REACH
    for column, offset in enumerate((0.0 * w, h * w, -h * w, h * SLANT)):
        np.testing.assert_allclose(read[:, column], 0.5 + (p + offset) @ slope, atol=2e-3)
    flux = np.stack([0.1 * p[:, 0], 0.2 + 0.1 * p[:, 1], -0.3 * p[:, 2]], axis=1)
    along = (flux * w).sum(axis=1)
    np.testing.assert_allclose(read[:, 4], read[:, 0] + np.log(1.0 - 3.0 * reduced_anisotropy(0.6) * along), atol=2e-3)
    np.testing.assert_allclose(read[:, 5:], np.stack([along, flux @ SLANT], axis=1), atol=1e-3)
    np.testing.assert_allclose(
        scattered_fluence.fluence_and_flux(cells), np.moveaxis(light, 0, -1), rtol=2e-3, atol=2e-3
    )


def test_positions_in_the_world_find_their_cells():
    matrix = np.array([[0.0, -0.3, 0.0, 5.0], [0.3, 0.0, 0.0, -2.0], [0.0, 0.0, 0.3, 1.0], [0.0, 0.0, 0.0, 1.0]])
    cube = fit_cube(Volume(np.ones((9, 7, 5), np.float32), matrix))
    light = scattered_fluence.ScatteredFluence.in_cube(cube, [], 0.5)
    world = cube.centre + np.random.default_rng(4).uniform(-0.5, 0.5, (100, 3)) * cube.edge @ cube.rotation.T
    cell = np.floor((cube.positions(world) + 0.5) * CELLS).astype(int)
    found = cells_at(light, (world @ light.linear.T + light.offset).T.astype(np.float32))
    np.testing.assert_array_equal(found, np.ravel_multi_index(cell.T, (CELLS,) * 3))
    # Flux is in the cube's frame, rays are in the world's: light along a ray is not scattered against it.
    along = np.array([[0.0, 0.6, 0.8]])
    flux = np.concatenate([[1.0], 0.2 * cube.directions(along)[0]])
    assert weights_towards(light, along)[0] @ flux == pytest.approx(1.0 - 0.2, abs=1e-6)


@pytest.mark.parametrize("octaves", [1, 2])
@pytest.mark.parametrize(("anisotropy", "most"), [(0.0, 0.75), (0.6, 0.97)])
def test_light_on_larger_cells_is_extrapolated_to_that_on_usual_ones(cloud, octaves, anisotropy, most):
    """At cells that hold density, in relative terms: where networks read it."""
    usual, density = DiscreteOrdinates(cloud, 20.0, anisotropy), cloud
    for _ in range(octaves):
        density = usual.means(density)
    larger, filled = DiscreteOrdinates(density, 20.0, anisotropy), density > 0.1
    expected = usual.solve(SunBeam(SLANT))[0]
    for _ in range(octaves):
        expected = usual.means(expected)

    def error(fluence):
        return np.sqrt(np.mean(np.log(fluence / expected)[filled] ** 2))

    found = larger.solve(SunBeam(SLANT))
    extrapolated = larger.extrapolated(SunBeam(SLANT), octaves)
    assert error(extrapolated[0]) < most * error(found[0])
    assert np.array_equal(larger.extrapolated(SunBeam(SLANT), 0), found)
