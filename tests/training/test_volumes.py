# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural volumes: same seed same volume, the stated frame, and variety."""

import numpy as np
import pytest
from scipy.ndimage import binary_erosion

from training.procedural.noise import CELLS, TILE, Fractal, curl_tile
from training.procedural.shapes import BOX, TORUS, ball_union, constructive_solid
from training.procedural.solids import SOLIDS
from training.procedural.volume_kinds import KINDS
from training.procedural.volumes import (
    HELD_BACK,
    HELD_BACK_SATURATED,
    HELD_BACK_SOLIDS,
    SATURATED_SEEDS,
    SOLID_SEEDS,
    make_volume,
)

# They make volumes and trace paths in them.
pytestmark = pytest.mark.slow

RESOLUTION = 40
SEEDS = range(24)


@pytest.fixture(scope="module")
def samples():
    return [make_volume(seed, RESOLUTION) for seed in SEEDS]


def test_every_volume_keeps_the_stated_frame(samples):
    for seed, sample in zip(SEEDS, samples):
        density = sample.density
        assert density.shape == (RESOLUTION,) * 3 and density.dtype == np.float32, seed
        assert density.max() == 1.0 and density.min() >= 0.0, seed
        rim = density.copy()
        rim[1:-1, 1:-1, 1:-1] = 0
        assert not rim.any(), seed


def test_the_active_part_fills_the_cube_along_one_axis_and_is_centred(samples):
    for seed, sample in zip(SEEDS, samples):
        extents, centres = [], []
        for axis in range(3):
            used = np.flatnonzero(sample.density.any(axis=tuple(a for a in range(3) if a != axis)))
            extents.append(used[-1] + 1 - used[0])
            centres.append((used[-1] + used[0]) / 2 - (RESOLUTION - 1) / 2)
        assert max(extents) > 0.85 * RESOLUTION, (seed, sample.kind, extents)
        assert np.abs(centres).max() < 0.08 * RESOLUTION, (seed, sample.kind, centres)


def test_one_seed_gives_one_volume_and_another_seed_another():
    first, again, other = make_volume(2, 32), make_volume(2, 32), make_volume(8, 32)
    assert first.kind == again.kind == other.kind == "simulation"
    assert np.array_equal(first.density, again.density)
    assert not np.array_equal(first.density, other.density)


def test_a_finer_volume_is_the_same_volume():
    coarse, fine = make_volume(5, 34).density, make_volume(5, 66).density
    # inner cells share one cube: 64 inner cells are 2x2x2 to each of 32
    means = fine[1:-1, 1:-1, 1:-1].reshape(32, 2, 32, 2, 32, 2).mean(axis=(1, 3, 5))
    assert np.abs(means - coarse[1:-1, 1:-1, 1:-1]).max() < 0.05


def test_seeds_differ_in_character(samples):
    assert len({sample.kind for sample in samples}) >= 8
    means = np.array([sample.density.mean() for sample in samples])
    assert means.min() < 0.01 and means.max() > 0.1
    dense_share = [(s.density > 0.5).sum() / (s.density > 0).sum() for s in samples]
    # from a few cores in thin smoke to solid shapes
    assert min(dense_share) < 0.05 and max(dense_share) > 0.9


def test_seeds_of_solids_give_homogeneous_fog_with_hard_faces():
    seeds = [*SOLID_SEEDS[:8], *HELD_BACK_SOLIDS[:8]]
    samples = [make_volume(seed, RESOLUTION) for seed in seeds]
    assert {sample.kind for sample in samples} == {kind.__name__ for kind in SOLIDS}
    spreads = []
    for seed, sample in zip(seeds, samples):
        # Away from the faces, where a cell's neighbours are filled too, density is (nearly) constant.
        inner = sample.density[binary_erosion(sample.density > 0)]
        spreads.append(inner.std() / inner.mean())
        assert spreads[-1] < 0.4, (seed, sample.kind)
    assert np.mean(np.array(spreads) < 1e-3) > 0.4
    assert not set(SOLID_SEEDS) & {*HELD_BACK_SOLIDS, *HELD_BACK}


def test_saturated_seeds_give_clouds_and_smoke_with_homogeneous_cores():
    seeds = [*SATURATED_SEEDS[:4], *HELD_BACK_SATURATED[:4]]
    saturated = [make_volume(seed, RESOLUTION) for seed in seeds]
    assert {sample.kind for sample in saturated} <= {kind.__name__ for kind in KINDS}
    usual = [make_volume(seed, RESOLUTION) for seed in range(8)]

    def near_the_most(sample):
        return (sample.density > 0.8).sum() / (sample.density > 0).sum()

    assert np.median([near_the_most(sample) for sample in saturated]) > 0.15
    assert np.median([near_the_most(sample) for sample in usual]) < 0.1
    assert all(sample.density.max() == 1.0 for sample in saturated)
    assert not set(SATURATED_SEEDS) & {*HELD_BACK_SATURATED, *HELD_BACK, *HELD_BACK_SOLIDS, *SOLID_SEEDS}


def test_too_few_cells_are_refused():
    with pytest.raises(ValueError, match="8 cells"):
        make_volume(0, 4)


def test_validation_seeds_are_disjoint_from_small_training_seeds():
    assert min(HELD_BACK) >= 1_000_000 and len(HELD_BACK) >= 100


def test_curl_noise_has_no_divergence():
    k = np.fft.fftfreq(TILE)
    spectrum = np.fft.fftn(curl_tile().astype(np.float64), axes=(0, 1, 2))
    divergence = k[:, None, None] * spectrum[..., 0] + k[:, None] * spectrum[..., 1] + k * spectrum[..., 2]
    gradients = np.sqrt(k[:, None, None] ** 2 + k[:, None] ** 2 + k**2) * np.linalg.norm(spectrum, axis=-1)
    # the Nyquist planes have no sign: leave them out
    inner = np.abs(k) < 0.49
    keep = np.ix_(inner, inner, inner)
    assert np.linalg.norm(divergence[keep]) < 1e-4 * np.linalg.norm(gradients[keep])


def test_noise_varies_at_the_frequency_asked_for():
    rng = np.random.default_rng(3)
    noise = Fractal(rng, frequency=2.0, octaves=1)
    line = np.zeros((4096, 3), np.float32)
    # several parallel lines, so that no single outlier decides
    power = np.zeros(2049)
    for _ in range(16):
        line[:, 0] = np.arange(4096) / 4096 * TILE / CELLS / 2.0
        line[:, 1:] = rng.uniform(0, 4, 2)
        power += np.abs(np.fft.rfft(noise(line))) ** 2
    waves = np.arange(2049) / (TILE / CELLS / 2.0)
    mean = (power * waves).sum() / power.sum()
    # waves of one length in all directions, seen along a line: their wave numbers are
    # uniform from 0 to the true one (Archimedes), so half of it on average
    assert 0.85 < mean < 1.15


def test_signed_distances_against_closed_forms():
    points = np.array([[0, 0, 0], [0.5, 0, 0], [1, 1, 0], [0, 0, 2]], np.float32)
    ball = ball_union(points, np.zeros((1, 3), np.float32), np.array([0.5], np.float32), np.float32(0.1))
    np.testing.assert_allclose(ball, [-0.5, 0, np.sqrt(2) - 0.5, 1.5], atol=1e-6)
    kinds, eye = np.array([BOX, TORUS]), np.stack([np.eye(3, dtype=np.float32)] * 2)
    sizes = np.array([[0.5, 0.5, 0.5], [1.0, 0.5, 0.0]], np.float32)
    centres = np.zeros((2, 3), np.float32)
    box = constructive_solid(points, kinds[:1], centres, eye, sizes, np.zeros(1, bool))
    np.testing.assert_allclose(box, [-0.5, 0, np.sqrt(0.5), 1.5], atol=1e-6)
    both = constructive_solid(points, kinds, centres, eye, sizes, np.zeros(2, bool))
    # the torus has its ring at radius 1 and a tube of 0.2
    np.testing.assert_allclose(both, [-0.5, 0, np.sqrt(2) - 1.2, 1.5], atol=1e-6)
    cut = constructive_solid(
        points[:1], kinds[[0, 0]], centres, eye, sizes[[0, 0]] * [[1], [0.5]], np.array([False, True])
    )
    np.testing.assert_allclose(cut, [0.25], atol=1e-6)
