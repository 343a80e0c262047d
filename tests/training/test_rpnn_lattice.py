# SPDX-License-Identifier: GPL-3.0-or-later
"""RPNN's descriptor: where its points lie and what they read, in rendering and in training."""

import numpy as np
import pytest
import torch
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from inference import Sun
from inference.features.mip_lattices import density_pyramid, padded_levels
from inference.grids.working_cube import fit_cube, mean_density
from inference.models import weights_file
from inference.network import network
from inference.network.conditions import RayPoints
from inference.network.placed_lights import PlacedSun
from inference.network.predictor import VolumePredictor
from inference.paper.sun_lattices import unit_optical_depths
from training.data import lattice_rows
from training.data.descriptors import Levels, describe_points
from training.data.stencil import load_stencil
from training.data.targets import unit_vectors
from training.export import export, save
from training.networks import RPNN
from training.procedural.seeded_volume import seeded_volume
from training.rpnn.rpnn_lattice import (
    FINE,
    LEVELS,
    POINTS,
    make_sun_lattice,
    read_lattices,
    refined_levels,
    sun_frames,
)
from training.tracer.path_tracer import sample_scattering_points

SUN = np.array([0.36, -0.48, 0.8])
SEED = 5


@pytest.fixture(scope="module")
def rays():
    random = np.random.default_rng(2)
    return random.uniform(-0.5, 0.5, (200, 3)), unit_vectors(random, 200)


def lattice_places(positions, omega, level):
    """World positions (N, 225, 3) of one level's points, each turned on its own."""
    points = 2.0**level * make_sun_lattice().points
    return np.stack([x + points @ frame.T for x, frame in zip(positions, sun_frames(SUN, omega))])


def test_the_lattice_has_the_extent_that_the_method_states():
    """5 x 5 x 9 points from [-1, -1, -1] to [1, 1, 3], neighbours half a unit and one cell apart."""
    points = make_sun_lattice().points * 128
    assert points.shape == (POINTS, 3) and len(np.unique(points, axis=0)) == POINTS
    np.testing.assert_allclose(points.min(axis=0), [-1, -1, -1])
    np.testing.assert_allclose(points.max(axis=0), [1, 1, 3])
    for axis, count in enumerate((5, 5, 9)):
        np.testing.assert_allclose(np.diff(np.unique(points[:, axis])), 0.5)
        assert len(np.unique(points[:, axis])) == count


def test_the_lattice_follows_sun_and_view(rays):
    """Its z axis is the sun's direction; rotating sun and view together rotates it with them."""
    omega = rays[1]
    frames = sun_frames(SUN, omega)
    np.testing.assert_allclose(frames[:, :, 2], np.broadcast_to(SUN, omega.shape), atol=1e-12)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frames.shape), atol=1e-12)
    local = np.einsum("nij,ni->nj", frames, omega)
    assert np.all(local[:, 0] > 0.0)
    np.testing.assert_allclose(local[:, 1], 0.0, atol=1e-12)
    turn = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    np.testing.assert_allclose(sun_frames(turn @ SUN, omega @ turn.T), turn @ frames, atol=1e-12)
    # Looking along the sun's rays is no exception.
    assert np.all(np.isfinite(sun_frames(SUN, np.stack([SUN, -SUN]))))


def test_lookups_are_trilinear_at_fine_cells(rays):
    """Against an independent interpolation of the pyramid with zeros around it."""
    random = np.random.default_rng(1)
    pyramid = density_pyramid(random.random((256,) * 3, np.float32))
    values = read_lattices(make_sun_lattice(), refined_levels(pyramid), *rays, SUN)
    for k in range(LEVELS):
        mip = min(k, 8)
        cells, fine = 256 >> mip, FINE[mip]
        places = (lattice_places(*rays, k) + 0.5) * cells
        centres = (np.floor(places * fine) + 0.5) / fine - 0.5
        grid = np.pad(pyramid[mip], 1).astype(np.float64)
        expected = map_coordinates(grid, (centres + 1).reshape(-1, 3).T, order=1, mode="nearest")
        # A point within rounding of a cell's border may fall on either side.
        assert np.isclose(values[:, k].ravel(), expected, atol=1e-5).mean() > 0.999


def test_jitter_averages_to_linear_interpolation(rays):
    pyramid = density_pyramid(np.random.default_rng(1).random((256,) * 3, np.float32))
    levels, lattice, copies = refined_levels(pyramid), make_sun_lattice(), 4000
    position, omega = rays[0][:1], rays[1][:1]
    jitter = np.random.default_rng(3).uniform(-0.5, 0.5, (copies, 3))
    many = read_lattices(lattice, levels, position.repeat(copies, 0), omega.repeat(copies, 0), SUN, jitter)
    # Mip 0, where fine cells are the pyramid's own.
    index = (lattice_places(position, omega, 0)[0] + 0.5) * 256 - 0.5
    expected = map_coordinates(pyramid[0].astype(np.float64), index.T, order=1)
    np.testing.assert_allclose(many[:, 0].mean(axis=0), expected, atol=0.03)


def test_a_full_cube_reads_its_density_inside_and_zero_outside():
    """At every level."""
    levels = refined_levels(density_pyramid(np.ones((256,) * 3, np.float32)))
    position, omega = np.zeros((1, 3)), np.array([[0.0, 1.0, 0.0]])
    values = read_lattices(make_sun_lattice(), levels, position, omega, SUN)
    for k in range(LEVELS):
        cell = 2.0 ** min(k, 8) / 256
        outside = (np.abs(lattice_places(position, omega, k)[0]) - 0.5).max(axis=1)
        np.testing.assert_allclose(values[0, k, outside < -cell / 2], 1.0, rtol=1e-6)
        assert np.all(values[0, k, outside > 1.5 * cell] == 0.0)
    assert np.all(values[0, 0] == 1.0)


@pytest.fixture(scope="module")
def data():
    """Rows as training.data.targets writes them: a procedural volume, two anisotropies, two suns."""
    volume, random = seeded_volume(SEED)
    cube, stencil, count = fit_cube(volume), load_stencil(), 60
    omega, suns = unit_vectors(random, count), unit_vectors(random, 2).repeat(count // 2, axis=0)
    sigma = np.exp(random.uniform(0.0, 6.0, count))
    positions, valid = sample_scattering_points(volume.density, sigma, omega, seed=1)
    assert valid.all()
    padded = padded_levels(density_pyramid(mean_density(volume, cube)), stencil)
    x, w, l = cube.positions(positions), cube.directions(omega), cube.directions(suns)
    features = np.concatenate(
        [
            describe_points(
                stencil, Levels(padded, unit_optical_depths(padded, l[i])), x[s], w[s], l[i], sigma[s] * cube.edge
            )
            for i, s in ((0, slice(None, count // 2)), (count // 2, slice(count // 2, None)))
        ],
        axis=1,
    )
    return {
        "features": features.transpose(1, 0, 2).astype(np.float16),
        "position": positions,
        "omega": omega.astype(np.float32),
        "sun": suns.astype(np.float32),
        "gamma": np.arccos(np.sum(w * l, axis=1)).astype(np.float32),
        "anisotropy": np.tile(np.float32([0.857, 0.3]), count // 2),
        "sigma_hat": (sigma * cube.edge).astype(np.float32),
        "albedo": np.tile(np.float32([1.0, 0.9, 0.5, 0.1]), (count, 1)),
        "radiance": random.random((count, 2, 4)).astype(np.float32),
    }


@pytest.mark.slow
def test_training_sees_what_rendering_sees(data, tmp_path, monkeypatch):
    """RPNN on a file's rows in PyTorch, and the exported RPNN on the same volume, points and suns."""
    rows = lattice_rows.lattice_rows(SEED, data)
    kept = np.flatnonzero(data["anisotropy"] == np.float32(0.857))
    np.testing.assert_array_equal(rows["radiance"], data["radiance"][kept][:, :, :1])
    torch.manual_seed(1)
    net = RPNN().eval()
    tensors = {key: torch.from_numpy(value) for key, value in rows.items()}
    with torch.no_grad():
        trained = net(*RPNN.inputs(tensors, torch.arange(len(kept))), tensors["albedo"].T).numpy()[0]
    save(export(net, {"anisotropy_range": [-0.3, 0.95], "sigma_hat_range": [0.01, 2000]}), str(tmp_path / "made.onnx"))
    monkeypatch.setattr(weights_file, "WEIGHTS", tmp_path)
    volume, _ = seeded_volume(SEED)
    cube = fit_cube(volume)
    for i in (0, len(kept) // 2, len(kept) - 1):
        sigma_t = data["sigma_hat"][kept[i]] / cube.edge
        predictor = VolumePredictor(network.load_network("made"), volume, 0.857)
        position, omega = (data[key][kept[i]][None].astype(np.float64) for key in ("position", "omega"))
        prepared = predictor.prepare(sigma_t, PlacedSun(Sun(data["sun"][kept[i]]), cube))
        np.testing.assert_allclose(prepared.predict(RayPoints(position, omega), [1.0])[0, 0], trained[i], rtol=5e-3)


def test_rows_of_another_volume_are_refused(data):
    with pytest.raises(ValueError, match="make the data anew"):
        lattice_rows.lattice_rows(SEED + 1, data)


def test_the_command_resumes_where_it_stopped(data, tmp_path, capsys):
    source, out = tmp_path / "data", tmp_path / "rpnn"
    source.mkdir()
    np.savez(source / f"{SEED:07d}.npz", **data)
    lattice_rows.main(["--data", str(source), "--out", str(out)])
    assert "30 rows" in capsys.readouterr().out
    written = (out / f"{SEED:07d}.npz").stat().st_mtime_ns
    lattice_rows.main(["--data", str(source), "--out", str(out)])
    assert capsys.readouterr().out == "" and (out / f"{SEED:07d}.npz").stat().st_mtime_ns == written
    with np.load(out / f"{SEED:07d}.npz") as rows:
        assert rows["lattice"].shape == (30, LEVELS, POINTS) and rows["lattice"].dtype == np.float16
        assert rows["albedo"].shape == (30, 1) and np.all(rows["albedo"] == 1.0)
