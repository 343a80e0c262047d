# SPDX-License-Identifier: GPL-3.0-or-later
"""Scattered emission against closed forms, energy conservation and a direct sum."""

import numpy as np
import pytest

from inference import Camera, Medium, Settings, Sun, Volume, render
from inference.grids.grid import Grid
from inference.transport.radiance_sweep import sweep_radiance
from inference.transport.scattered_emission import ScatteredEmission
from training.tracer.density_grid import prepare
from training.tracer.light_paths import AlbedoField, Lights, LitMedium, trace_lights
from training.tracer.scene import Sampling

SETTINGS = Settings(depth_samples=16)


def fire(density, emission, edge=1.0, name="fire"):
    """A cube around the origin from arrays of one shape; what it emits is grey."""
    voxels = density.shape[0]
    matrix = np.diag([*[edge / voxels] * 3, 1.0])
    matrix[:3, 3] = 0.5 * edge / voxels - 0.5 * edge
    return Volume(density, matrix, name, np.repeat(emission[..., None], 3, axis=3))


def radius(voxels):
    axis = (np.arange(voxels) + 0.5) / voxels - 0.5
    return np.sqrt(sum(a**2 for a in np.meshgrid(axis, axis, axis, indexing="ij")))


def looking(direction, distance=4.0, width=1.8, pixels=24):
    """An orthographic camera that looks at the origin along a direction."""
    z = -np.asarray(direction, float) / np.linalg.norm(direction)
    x = np.cross([0.0, 1.0, 0.0] if abs(z[1]) < 0.9 else [1.0, 0.0, 0.0], z)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    matrix[:3, 3] = z * distance
    return Camera(matrix, "orthographic", (pixels, pixels), ortho_scale=width)


@pytest.mark.parametrize("sigma, face", [(0.0, 4), (3.0, 6), (80.0, 4)])
def test_sweeps_conserve_energy(sigma, face):
    """Absorbed and escaping power sum to the emitted power, 4 pi e over the volume."""
    random = np.random.default_rng(0)
    shape, cell = (40, 30, 36), 0.02
    extinction, emission = np.zeros(shape), np.zeros(shape)
    extinction[12:20, 8:16, 10:24] = sigma * random.random((8, 8, 14))
    emission[12:20, 8:16, 10:24] = random.random((8, 8, 14))
    fluence, flux = sweep_radiance(extinction, emission, cell, face)
    taken = (extinction * fluence).sum() * cell**3
    out = 0.0
    for axis in range(3):
        faces = np.moveaxis(flux[axis], axis, 0)
        out += (faces[-1].sum() - faces[0].sum()) * cell**2
    # Flux is known at cell centres: near a face, a little less has escaped than will.
    assert taken + out == pytest.approx(4.0 * np.pi * emission.sum() * cell**3, rel=0.03)


@pytest.mark.parametrize("anisotropy", [0.0, 0.7])
def test_deep_in_homogeneous_fog_emission_is_absorbed_locally(anisotropy):
    """L = e / sigma_a, whatever the scattering: here five times the unscattered radiance."""
    fog = fire(np.ones((40,) * 3, np.float32), np.full((40,) * 3, 2.0, np.float32))
    view = Camera(np.eye(4), "perspective", (4, 4), fov=0.5)
    layer = render([(fog, Medium(60.0, 0.8, anisotropy))], [], view, SETTINGS)
    np.testing.assert_allclose(layer.emission, 2.0 / 60.0, rtol=0.01)
    np.testing.assert_allclose(layer.rgb, 2.0 / 12.0, rtol=0.03)


@pytest.mark.parametrize(
    "sigma, anisotropy", [*(pytest.param(sigma, 0.0, marks=pytest.mark.slow) for sigma in (2.0, 12.0)), (12.0, 0.6)]
)
def test_white_fog_lets_all_emission_escape(sigma, anisotropy):
    """The escaping power is 4 pi e, integrated over the fire in the fog."""
    r = radius(48)
    fog = fire(
        np.clip(4.0 - 8.0 * r, 0.0, 1.0).astype(np.float32), np.clip(3.0 - 12.0 * r, 0.0, 1.0).astype(np.float32)
    )
    made = 4.0 * np.pi * fog.emission[..., 0].sum(dtype=float) / 48**3
    power, views = np.zeros(3), [(0.2, 0.4, 1.0), (1.0, 1.0, -1.0), (-1.0, 0.1, 0.0)]
    for direction in views:
        layer = render([(fog, Medium(sigma, 1.0, anisotropy))], [], looking(direction), SETTINGS)
        power += 4.0 * np.pi / len(views) * layer.rgb.sum(axis=(0, 1), dtype=float) * (1.8 / 24) ** 2
    np.testing.assert_allclose(power, made, rtol=0.05)


def test_a_small_emitter_in_thin_fog_equals_a_direct_sum():
    """Fluence is the sum of exp(-sigma d) / d^2 over all emitters, since almost nothing scatters twice."""
    r, sigma = radius(48), 1.0
    fog = fire(np.ones_like(r, np.float32), np.where(r < 0.08, 50.0, 0.0).astype(np.float32))
    glow = ScatteredEmission([Grid(fog)], [Medium(sigma, 0.01)])
    random = np.random.default_rng(1)
    directions = random.normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = directions * random.uniform(0.15, 0.45, size=(200, 1))
    lit = np.argwhere(r < 0.08)
    away = np.linalg.norm(points[:, None] - ((lit + 0.5) / 48 - 0.5)[None], axis=2)
    expected = 50.0 / 48**3 * (np.exp(-sigma * away) / away**2).sum(axis=1)
    found = 4.0 * np.pi * glow.scattered([1], points, directions, 0.0)[0]
    assert np.median(found / expected) == pytest.approx(1.0, abs=0.1)
    assert np.sqrt(((found / expected - 1.0) ** 2).mean()) < 0.25


@pytest.mark.slow
def test_fire_illuminates_smoke_of_another_volume():
    """A flame without smoke inside smoke without fire equals both in one volume."""
    r = radius(32)
    smoke, flame = (
        np.clip(2.0 - 4.0 * r, 0.0, 1.0).astype(np.float32),
        np.clip(1.0 - 5.0 * r, 0.0, 1.0).astype(np.float32),
    )
    nothing = np.zeros_like(r, np.float32)
    medium = Medium((3.0, 6.0, 9.0), (0.9, 0.7, 0.5), 0.3)
    one = render([(fire(smoke, flame), medium)], [], looking((0.0, 0.3, -1.0)), SETTINGS)
    apart = [(fire(nothing, flame), Medium(1.0)), (Volume(smoke, fire(smoke, flame).world_from_index, "smoke"), medium)]
    two = render(apart, [], looking((0.0, 0.3, -1.0)), SETTINGS)
    assert one.multiple.max() > 0.1 * one.emission.max()
    np.testing.assert_allclose(two.multiple, one.multiple, rtol=0.02, atol=1e-3 * one.multiple.max())


def test_it_adds_to_sunlight_and_can_be_turned_off():
    r = radius(24)
    fog = fire(np.clip(2.0 - 4.0 * r, 0.0, 1.0).astype(np.float32), np.clip(1.0 - 4.0 * r, 0.0, 1.0).astype(np.float32))
    medium, sun, view = Medium(5.0, 0.9), Sun((0.3, 1.0, 0.2), 2.0), looking((0.0, 0.0, -1.0))
    glow = render([(fog, medium)], [], view, SETTINGS)
    dark = render([(Volume(fog.density, fog.world_from_index, "fog"), medium)], [sun], view, SETTINGS)
    both = render([(fog, medium)], [sun], view, SETTINGS)
    np.testing.assert_allclose(both.multiple, glow.multiple + dark.multiple, rtol=1e-3, atol=1e-6)
    without = render([(fog, medium)], [sun], view, Settings(depth_samples=16, multiple=False))
    assert not without.multiple.any() and without.emission.any()


@pytest.mark.parametrize("anisotropy", [0.0, 0.857])
def test_a_flame_in_smoke_is_scattered_as_by_traced_paths(anisotropy):
    """A narrow phase function scatters towards the camera what arrives from ahead, from the flame itself too."""
    sigma, axis = 10.0, (np.arange(48) + 0.5) / 48 - 0.5
    x, y, z = np.meshgrid(axis, axis, axis, indexing="ij")
    smoke = np.clip(2.2 - 5.0 * radius(48), 0.0, 1.0).astype(np.float32)
    flame = np.exp(-((x - 0.1) ** 2 + y**2 + (z + 0.05) ** 2) / 0.07**2).astype(np.float32)
    random = np.random.default_rng(4)
    directions = random.normal(size=(160, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    points = random.uniform(-0.25, 0.25, (160, 3))
    nothing = np.zeros((0, 3)), (), np.zeros((0, 2, 4), np.float32)
    medium = LitMedium(sigma, anisotropy, AlbedoField(np.full(1, 0.9), np.full(1, 0.9)))
    halves = []
    for seed in range(2):
        lights = Lights(*nothing, flame[..., None])
        often, once = trace_lights(prepare(smoke), lights, medium, (points, directions), Sampling(512, seed))
        halves.append(often[:, 0, 0] + once[:, 0])
    glow = ScatteredEmission([Grid(fire(smoke, flame))], [Medium(sigma, 0.9, anisotropy)])
    found, mean = glow.scattered([1], points, directions, anisotropy)[0], np.mean(halves)
    error = np.sqrt(max(((found - halves[0]) * (found - halves[1])).mean(), 0.0)) / mean
    assert error < 0.25
    assert found.mean() == pytest.approx(mean, rel=0.06)
