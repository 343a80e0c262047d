# SPDX-License-Identifier: GPL-3.0-or-later
"""Ray features: closed forms in a box, and each volume by itself."""

import numpy as np
import pytest

from inference import Medium, Volume
from inference.grids.bound_medium import BoundMedium
from inference.grids.grid import Grid
from inference.marching.marcher import ray_features_at
from inference.marching.ray_features import SCALES
from inference.marching.ray_march import MarchOptions
from inference.marching.ray_steps import RayBatch
from inference.numerics.exponential import one_minus_exp
from inference.transport.discrete_ordinates import CELLS as COARSE_CELLS
from inference.transport.scattered_fluence import ScatteredFluence
from tests.support.marches import march

CELLS = 48
ANISOTROPY = 0.6


def box(name="box", offset=(0.0, 0.0, 0.0)):
    """Density 1 in a cube of edge 1 around `offset`; Blender's ramp at its faces is a voxel wide."""
    matrix = np.diag([1 / CELLS] * 3 + [1.0])
    matrix[:3, 3] = 0.5 / CELLS - 0.5 + np.array(offset)
    return Volume(np.ones((CELLS,) * 3, np.float32), matrix, name)


def slabs(offset=(0.0, 0.0, 0.0), suns=1):
    """A fluence of 2 above z = 0 of a cube of edge 1 around `offset`, and 1 below, and a flux of 0.3 of it along x."""
    light = np.tile(np.array([1.0, 0.3, 0.0, 0.0], np.float32), (*[COARSE_CELLS] * 3, 1))
    light[:, :, COARSE_CELLS // 2 :] *= 2.0
    linear = np.eye(3) * COARSE_CELLS
    return ScatteredFluence(linear, 0.5 * COARSE_CELLS - linear @ np.array(offset), [light] * suns, ANISOTROPY)


def bound(volume, sun, sigma_t):
    grid = Grid(volume)
    return BoundMedium(grid, Medium(sigma_t), sigma_t, grid.sun_depths([np.asarray(sun, float)]))


@pytest.mark.parametrize("sigma_t", [0.3, 3.0, 8.0])
def test_light_in_a_box_has_its_closed_form(sigma_t):
    """Along +x below a sun at +z: exp(-a tau_sun) (1 - exp(-a tau_ahead)), tau_sun being constant along the ray;
    and J (1 - exp(-a tau_ahead)), J being fluence - 3 G' flux, G' = G / (1 + G)."""
    medium = bound(box(), (0.0, 0.0, 1.0), sigma_t)
    position = np.array([[-0.3, 0.0, 0.2], [0.1, 0.1, -0.1], [0.45, -0.2, 0.3]])
    direction = np.tile([1.0, 0.0, 0.0], (3, 1))
    found = ray_features_at(medium, position, direction, slabs()).of(slice(None), 0, 0)
    tau_sun, tau_ahead = sigma_t * (0.5 - position[:, 2]), sigma_t * (0.5 - position[:, 0])
    expected = [tau_sun, tau_ahead] + [np.exp(-a * tau_sun) * -np.expm1(-a * tau_ahead) for a in SCALES]
    fluence = np.where(position[:, 2] > 0.0, 2.0, 1.0)
    scattered = fluence * (1.0 - 3.0 * ANISOTROPY / (1.0 + ANISOTROPY) * 0.3)
    expected += [scattered * -np.expm1(-a * tau_ahead) for a in (1.0, 1.0 - ANISOTROPY**2)]
    np.testing.assert_allclose(found, np.stack(expected, axis=1), rtol=0.02, atol=2e-3 * sigma_t)


def test_marched_samples_equal_features_at_their_points():
    """A sample of a marched ray against a ray that starts at the sample's position."""
    sigma_t, sun = 6.0, np.array([0.48, 0.6, 0.64])
    volume = box()
    volume.density[:, :, :20] = 0.2
    volume.density[:30, :20] *= 0.5
    medium = bound(volume, sun, sigma_t)
    random = np.random.default_rng(2)
    origins = np.concatenate([random.uniform(-0.4, 0.4, (40, 2)), np.full((40, 1), 2.0)], axis=1)
    directions = np.tile([0.0, 0.0, -1.0], (40, 1))
    batch = RayBatch(origins, directions, *medium.grid.interval(origins, directions))
    segment = march([medium], batch, MarchOptions(4, [slabs()]))
    ray = segment.sample_ray
    positions = origins[ray] + segment.sample_distance[:, None] * directions[ray]
    marched = segment.sample_features.of(slice(None), 0, 0)
    own = ray_features_at(medium, positions, directions[ray], slabs()).of(slice(None), 0, 0)
    assert marched[:, 1].max() > 3.0 and marched[:, 1].min() < 1.5
    np.testing.assert_allclose(marched, own, rtol=0.03, atol=0.01)


def test_each_volume_has_features_of_its_own():
    """The network predicts each volume alone; so must its input."""
    sun, sigma_t = np.array([0.0, 0.6, 0.8]), (4.0, 2.0)
    volumes = [box("left"), box("right", (0.6, 0.0, 0.0))]
    media = [bound(volume, sun, s) for volume, s in zip(volumes, sigma_t)]
    fluence = [slabs(), slabs((0.6, 0.0, 0.0))]
    origins, directions = np.array([[-2.0, 0.05, 0.1]]), np.array([[1.0, 0.0, 0.0]])
    near, far = np.array([1.5 - 0.5 / CELLS]), np.array([3.1 + 0.5 / CELLS])
    both = march(media, RayBatch(origins, directions, near, far), MarchOptions(16, fluence))
    positions = origins + both.sample_distance[:, None] * directions
    for v in range(2):
        inside = both.sample_fraction[:, v] > 0.0
        alone = ray_features_at(media[v], positions[inside], np.tile(directions, (inside.sum(), 1)), fluence[v])
        found = both.sample_features.of(inside, v, 0)
        np.testing.assert_allclose(found, alone.of(slice(None), 0, 0), rtol=0.05, atol=0.03)


def test_unneeded_features_are_not_computed():
    medium = bound(box(), (0.0, 0.0, 1.0), 1.0)
    origins, directions = np.array([[0.0, 0.0, 2.0]]), np.array([[0.0, 0.0, -1.0]])
    batch = RayBatch(origins, directions, *medium.grid.interval(origins, directions))
    assert march([medium], batch, MarchOptions(4)).sample_features is None


def test_neighbouring_rays_do_not_step_between_fluence_cells_together():
    """Rays at increasing heights through a fluence that grows with z: what they read grows with it."""
    medium = bound(box(), (0.0, 0.0, 1.0), 2.0)
    values = np.zeros((*[COARSE_CELLS] * 3, 4), np.float32)
    values[..., 0] = np.arange(COARSE_CELLS, dtype=np.float32)
    linear = np.eye(3) * COARSE_CELLS
    light = ScatteredFluence(linear, np.full(3, 0.5 * COARSE_CELLS), [values], 0.0)
    rays = 40
    z = 0.1 + np.arange(rays) / rays * 4 / COARSE_CELLS
    origins = np.stack([np.full(rays, -2.0), np.full(rays, 0.013), z], axis=1)
    directions = np.tile([1.0, 0.0, 0.0], (rays, 1))
    batch = RayBatch(origins, directions, *medium.grid.interval(origins, directions))
    segment = march([medium], batch, MarchOptions(8, [light]))
    seen = segment.sample_features.of(slice(None), 0, 0)[:, -1].reshape(rays, 8)[:, 0]
    rise = (seen[-1] - seen[0]) / (rays - 1)
    # Nearest cells alone would rise by ten rays' share at every tenth ray.
    assert rise > 0.0 and np.abs(np.diff(seen) - rise).max() < 2.5 * rise


def test_one_minus_exp_keeps_its_digits():
    x = np.concatenate([[0.0], np.logspace(-30, 5, 2000)]).astype(np.float32)
    np.testing.assert_allclose(one_minus_exp(x), -np.expm1(-x.astype(np.float64)), rtol=4e-7)
