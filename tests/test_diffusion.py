"""The diffusion approximation: energy, limits, and the compiled solver against numpy's."""

import numpy as np
import pytest

from inference import Volume, diffusion
from inference.cube import fit_cube
from training import diffusion as compiled
from training.path_tracer import trace_points

CELLS = diffusion.CELLS
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def cloud():
    """A ball with holes."""
    axis = (np.arange(CELLS) + 0.5) / CELLS - 0.5
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    inside = x**2 + y**2 + z**2 < 0.2
    return np.where(inside, 1.0 + 0.8 * np.sin(20 * x) * np.cos(17 * y + 9 * z), 0.0).astype(np.float32)


def equation(density, sun, reduced):
    tau = diffusion.sun_optical_depth(density, sun, 1.0 / CELLS).astype(np.float64)
    return diffusion.diffusion_equation(density, tau, reduced)


@pytest.mark.parametrize("reduced", [0.05, 3.0, 100.0, 2000.0])
def test_the_source_is_what_the_beam_loses(reduced):
    """Below a head-on sun a homogeneous cube of one unit of area takes 1 - exp(-s) from the beam."""
    _, _, source = equation(np.ones((CELLS,) * 3, np.float32), UP, reduced)
    assert source.sum() / CELLS == pytest.approx(1.0 - np.exp(-reduced), rel=2e-3)


@pytest.mark.parametrize("reduced, tolerance", [(0.05, 5e-3), (30.0, 5e-3), (2000.0, 0.15)])
def test_all_light_leaves_through_the_faces(cloud, reduced, tolerance):
    """To the tolerance at which conjugate gradients stop, which a stiff equation feels."""
    diagonal, couplings, source = equation(cloud, np.array([0.48, 0.6, 0.64]), reduced)
    fluence = diffusion.solve(diagonal, couplings, source)
    assert np.all(fluence >= 0.0) and fluence.max() > 0.0
    inner = couplings.sum(axis=0)
    for axis in range(3):
        inner += np.roll(couplings[axis], 1, axis)
    outflow = ((diagonal - inner) * fluence).sum()
    assert outflow == pytest.approx(source.sum(), rel=tolerance)


@pytest.mark.parametrize("reduced", [0.05, 30.0, 2000.0])
def test_the_compiled_solver_solves_the_same(cloud, reduced):
    terms = equation(cloud, np.array([0.48, 0.6, 0.64]), reduced)
    expected = diffusion.solve(*terms)
    np.testing.assert_allclose(compiled.solve(*terms), expected, atol=2e-3 * expected.max())


def test_points_of_data_read_what_rendering_reads(cloud):
    random = np.random.default_rng(3)
    positions, omega = random.uniform(-0.5, 0.5, (50, 3)), random.normal(size=(50, 3))
    omega /= np.linalg.norm(omega, axis=1, keepdims=True)
    (fields,) = compiled.log_fluences(cloud, [UP])
    for reduced in (0.04, 0.7, 7.0, 80.0, 800.0):
        field = diffusion.log_fluence(cloud, UP, reduced)
        expected = diffusion.read_fluence(field, positions, omega, UP)
        found = compiled.describe_diffusion(fields, positions, omega, UP, np.full(50, reduced))
        np.testing.assert_allclose(found, expected, atol=0.02)


def test_it_is_near_the_truth_where_diffusion_holds():
    """Isotropic scattering deep in a dense homogeneous cube: the traced radiance is the fluence / 4 pi."""
    density = np.ones((CELLS,) * 3, np.float32)
    positions = np.array([[0.0, 0.0, 0.1], [0.2, -0.1, -0.2], [-0.3, 0.3, 0.0]])
    omega = np.tile([1.0, 0.0, 0.0], (3, 1))
    traced = trace_points(density, UP, None, positions, omega, 40.0, 0.0, [1.0], 40000, seed=2)[:, 0, 0]
    field = diffusion.log_fluence(density, UP, 40.0)
    fluence = np.exp(diffusion.read_fluence(field, positions, omega, UP)[:, 0])
    np.testing.assert_allclose(fluence / (4 * np.pi), traced, rtol=0.15)


def test_the_finer_field_holds_the_fluence_at_its_cells_centres():
    """What is exponential in space is met exactly, in every cell."""
    index = np.stack(np.meshgrid(*[np.arange(CELLS + 2)] * 3, indexing="ij"), axis=-1)
    slope, middle = np.array([0.05, -0.02, 0.1]), 0.5 * (CELLS + 1)
    fluence = diffusion.finer(((index - middle) @ slope).astype(np.float32))
    centre = (np.stack(np.meshgrid(*[np.arange(2 * CELLS)] * 3, indexing="ij"), axis=-1) + 0.5) / 2 - 0.5 * CELLS
    np.testing.assert_allclose(fluence, np.exp(centre @ slope), rtol=1e-4)


def test_positions_in_the_world_find_their_cells():
    matrix = np.array([[0.0, -0.3, 0.0, 5.0], [0.3, 0.0, 0.0, -2.0], [0.0, 0.0, 0.3, 1.0], [0.0, 0.0, 0.0, 1.0]])
    cube = fit_cube(Volume(np.ones((9, 7, 5), np.float32), matrix))
    light = diffusion.DiffusedLight.in_cube(cube, [])
    world = cube.centre + np.random.default_rng(4).uniform(-0.5, 0.5, (100, 3)) * cube.edge @ cube.rotation.T
    cell = np.floor((cube.positions(world) + 0.5) * 2 * CELLS).astype(int)
    found = light.cells((world @ light.linear.T + light.offset).T.astype(np.float32))
    np.testing.assert_array_equal(found, np.ravel_multi_index(cell.T, (2 * CELLS,) * 3))
