# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer against closed forms, conservation laws and independent references."""

import tempfile
from pathlib import Path

import numba
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from benchmarks.fidelity.views import REFERENCES, independent_density
from inference import Medium
from inference.scene.phase_function import henyey_greenstein
from training.tracer.density_grid import prepare
from training.tracer.henyey_greenstein import scatter
from training.tracer.path_tracer import (
    PinholeCamera,
    Sampling,
    Scene,
    Vertices,
    sample_scattering_points,
    trace_pixels,
    trace_points,
)
from training.tracer.random_numbers import seed_state
from training.tracer.tracking import GridMedium, Ray, ratio_track


def sphere_lattice(count):
    """Directions (count, 3) spread evenly over the sphere (Fibonacci)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5))
    r = np.sqrt(1 - z * z)
    return np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)


def smooth_cloud(cells, seed=0):
    """Lumpy, asymmetric density (cells,)*3, 0 at the rim, maximum 1."""
    rng = np.random.default_rng(seed)
    x = np.stack(np.meshgrid(*[(np.arange(cells) + 0.5) / cells - 0.5] * 3, indexing="ij"), axis=-1)
    density = sum(np.exp(-((x - c) ** 2).sum(-1) / 0.02) for c in rng.uniform(-0.25, 0.25, (5, 3)))
    density *= np.clip((0.5 - np.abs(x).max(-1)) * 6, 0, 1)
    return (density / density.max()).astype(np.float32)


def z_score(a, b):
    """Difference of the means of two samples of independent estimates, in standard errors."""
    error = np.sqrt(a.var(ddof=1) / a.size + b.var(ddof=1) / b.size)
    return (a.mean() - b.mean()) / error


@numba.njit
def scattered_cosines(g, count, seed):
    state = seed_state(seed, 0)
    # an oblique axis, so that the frame around it is exercised
    x, y, z = np.float32(0.48), np.float32(-0.6), np.float32(-0.64)
    cosines, lengths, across = np.empty(count), np.empty(count), np.empty((2, count))
    for i in range(count):
        a, b, c, state = scatter(x, y, z, np.float32(g), state)
        cosines[i], lengths[i] = a * x + b * y + c * z, a * a + b * b + c * c
        # components along two axes perpendicular to the first and to each other
        across[0, i], across[1, i] = 0.8 * a + 0.6 * c, -0.36 * a - 0.8 * b + 0.48 * c
    return cosines, lengths, across


@pytest.mark.parametrize("g", [-0.4, 0.0, 0.5, 0.857, 0.95])
def test_scattering_follows_henyey_greenstein(g):
    count = 400_000
    cosines, lengths, across = scattered_cosines(g, count, 11)
    assert np.abs(lengths - 1).max() < 1e-5
    assert abs(cosines.mean() - g) < 5 * cosines.std() / np.sqrt(count) + 1e-6
    # the azimuth is uniform
    deviation = across.std(axis=1)
    assert np.all(np.abs(across.mean(axis=1)) < 5 * deviation / np.sqrt(count))
    assert abs(deviation[0] / deviation[1] - 1) < 0.02
    # bins of equal probability by the distribution function of the phase function
    edges = np.linspace(-1, 1, 200_001)
    density = 2 * np.pi * henyey_greenstein((edges[1:] + edges[:-1]) / 2, g)
    cumulative = np.concatenate([[0], np.cumsum(density) * (edges[1] - edges[0])])
    assert abs(cumulative[-1] - 1) < 1e-3
    bins = np.interp(np.linspace(0, 1, 33), cumulative / cumulative[-1], edges)
    counts, _ = np.histogram(cosines, bins)
    expected = count / 32
    chi_square = ((counts - expected) ** 2 / expected).sum()
    # 31 degrees of freedom: mean 31, standard deviation 7.9
    assert chi_square < 31 + 6 * 7.9


@numba.njit
def _mean_transmittance(x, directions, medium, count, seed):
    state = seed_state(seed, 0)
    out = np.zeros(directions.shape[0])
    for d in range(directions.shape[0]):
        for _ in range(count):
            ray = Ray(x[0], x[1], x[2], directions[d, 0], directions[d, 1], directions[d, 2])
            t, state = ratio_track(ray, medium, state)
            out[d] += t / count
    return out


def test_ratio_tracking_agrees_with_quadrature():
    density = smooth_cloud(24)
    grid = prepare(density)
    x, sigma = np.array([0.1, -0.05, 0.02]), 12.0
    directions = sphere_lattice(40).astype(np.float32)
    tracked = _mean_transmittance(
        ((x + 0.5) * 24).astype(np.float32),
        directions,
        GridMedium(*grid, np.float32(sigma / 24), np.float32(0)),
        4000,
        5,
    )
    step = 1 / 400
    s = (np.arange(400) + 0.5) * step
    places = (x + s[None, :, None] * directions[:, None] + 0.5) * 24 - 0.5
    values = map_coordinates(density, places.reshape(-1, 3).T, order=1, mode="constant").reshape(40, 400)
    exact = np.exp(-sigma * values.sum(axis=1) * step)
    np.testing.assert_allclose(tracked, exact, atol=0.03)
    assert abs(tracked.mean() - exact.mean()) < 0.004


@pytest.mark.parametrize("lit_from_behind", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_single_scattering_of_a_cube_against_the_closed_form(lit_from_behind):
    cells, sigma, g, albedo = 16, 2.0, 0.3, (0.9, 0.5, 0.1)
    # far away through a needle's eye: every ray runs along axis 0
    sun = (1, 0, 0) if lit_from_behind else (-1, 0, 0)
    camera = PinholeCamera((-40, 0, 0), (0, 0, 0), (0, 0, 1), 0.2, 8)
    scene, medium = Scene(np.ones((cells,) * 3, np.float32), sun), Medium(sigma, albedo, g)
    image = trace_pixels(scene, camera, medium, Sampling(4000, seed=3, max_collisions=0))
    # the outer half cells fall linearly from 1 to 1/2
    depth = sigma * (1 - 0.25 / cells)
    samples = 64 * 4000
    alpha = 1 - np.exp(-depth)
    assert abs(image[..., 3].mean() - alpha) < 5 * np.sqrt(alpha * (1 - alpha) / samples)
    if lit_from_behind:
        light = henyey_greenstein(1.0, g) * depth * np.exp(-depth)
    else:
        light = henyey_greenstein(-1.0, g) * 0.5 * (1 - np.exp(-2 * depth))
    np.testing.assert_allclose(image[..., :3].mean(axis=(0, 1)), light * np.array(albedo), rtol=0.012)


@pytest.mark.parametrize(
    "g, sigma",
    [
        (0.0, 4.0),
        *(pytest.param(g, sigma, marks=pytest.mark.slow) for g, sigma in ((0.0, 40.0), (0.6, 15.0), (-0.3, 15.0))),
    ],
)
def test_under_uniform_light_every_point_receives_that_light(g, sigma):
    """Without absorption, uniform radiance 1 outside is radiance 1 inside."""
    rng = np.random.default_rng(4)
    density = (rng.random((12,) * 3) ** 3).astype(np.float32)
    suns = sphere_lattice(300)
    points = 24
    x = rng.uniform(-0.5, 0.5, (points, 3))
    omega = sphere_lattice(points)
    scene, vertices = Scene(density, suns), Vertices(x, omega, sigma, g, [1.0])
    multiple = trace_points(scene, vertices, Sampling(400, 6))[..., 0].astype(np.float64)
    medium = GridMedium(*scene.grid, np.float32(sigma / 12), np.float32(g))
    single = np.stack(
        [_mean_transmittance(((p + 0.5) * 12).astype(np.float32), suns.astype(np.float32), medium, 50, 7) for p in x]
    ) * henyey_greenstein(omega @ suns.T, g)
    radiance = 4 * np.pi / len(suns) * (single + multiple).sum(axis=1)
    error = radiance.std(ddof=1) / np.sqrt(points)
    assert error < 0.02
    assert abs(radiance.mean() - 1) < 4 * error + 0.002


@pytest.mark.slow
def test_under_uniform_light_the_cloud_is_invisible():
    density = smooth_cloud(24)
    suns = sphere_lattice(120)
    camera, medium, grid = (
        PinholeCamera((1.2, 0.4, 0.9), (0, 0, 0), (0, 0, 1), 30, 6),
        Medium(20.0, 1.0, 0.2),
        prepare(density),
    )
    images = np.stack(
        [trace_pixels(Scene(grid, sun), camera, medium, Sampling(60, seed)) for seed, sun in enumerate(suns)]
    ).astype(np.float64)
    radiance = 4 * np.pi * images[..., 0].mean(axis=0) + 1 - images[..., 3].mean(axis=0)
    assert images[..., 3].mean() > 0.3
    assert abs(radiance.mean() - 1) < 0.02
    assert np.abs(radiance - 1).max() < 0.15


@pytest.mark.slow
def test_reciprocity_exchanging_camera_and_sun():
    """Seen from afar, the cloud's total radiance is the same with camera and sun exchanged."""
    density = smooth_cloud(20, seed=2)
    a, b = np.array([0.8, 0.6, 0.0]), np.array([-0.2, 0.5, 0.8])
    a, b = a / np.linalg.norm(a), b / np.linalg.norm(b)

    def light(camera, sun, seed):
        fov = np.degrees(2 * np.arctan(0.9 / 40))
        view = PinholeCamera(40 * camera, (0, 0, 0), (0, 0.1, 1), fov, 48)
        image = trace_pixels(Scene(density, sun), view, Medium(30.0, 0.9, 0.5), Sampling(8, seed))
        return image[..., 0].mean()

    there = np.array([light(a, b, seed) for seed in range(16)])
    back = np.array([light(b, a, 100 + seed) for seed in range(16)])
    assert there.std() / np.sqrt(16) < 0.02 * there.mean()
    assert abs(z_score(there, back)) < 4


def _points(density, sigma, count, seed):
    omega = sphere_lattice(count)
    x, valid = sample_scattering_points(density, sigma, omega, seed)
    assert valid.all()
    return x, omega


def test_the_result_does_not_depend_on_the_number_of_threads():
    density = smooth_cloud(20)
    suns = sphere_lattice(2)
    x, omega = _points(density, 20.0, 64, 1)
    scene, vertices = Scene(density, suns), Vertices(x, omega, 20.0, 0.5, [1.0, 0.5])
    camera = PinholeCamera((2, 0, 0), (0, 0, 0), (0, 0, 1), 40, 8)
    results = []
    threads = numba.get_num_threads()
    for count in sorted({1, threads}):
        numba.set_num_threads(count)
        points = trace_points(scene, vertices, Sampling(8, 9))
        places, _ = sample_scattering_points(density, 20.0, omega, 5)
        image = trace_pixels(Scene(density, suns[0]), camera, Medium(20.0, 1.0, 0.5), Sampling(4, 9))
        results.append(np.concatenate([points.ravel(), places.ravel(), image.ravel()]))
    numba.set_num_threads(threads)
    assert all(np.array_equal(results[0], other) for other in results)
    other_seed = trace_points(scene, vertices, Sampling(8, 10))
    assert not np.array_equal(results[0][: other_seed.size], other_seed.ravel())


def test_a_points_result_does_not_depend_on_the_points_after_it():
    density = smooth_cloud(20)
    suns = sphere_lattice(2)
    x, omega = _points(density, 20.0, 16, 1)
    scene = Scene(density, suns)
    every = trace_points(scene, Vertices(x, omega, 20.0, 0.5, [1.0]), Sampling(8, 9))
    some = trace_points(scene, Vertices(x[:5], omega[:5], 20.0, 0.5, [1.0]), Sampling(8, 9))
    np.testing.assert_array_equal(every[:5], some)


def test_albedos_traced_together_equal_those_traced_apart():
    density = smooth_cloud(20)
    suns = sphere_lattice(3)
    x, omega = _points(density, 20.0, 200, 1)

    def trace(albedos, paths, seed, **limit):
        vertices, sampling = Vertices(x, omega, 20.0, 0.5, albedos), Sampling(paths, seed, **limit)
        return trace_points(Scene(density, suns), vertices, sampling).astype(np.float64)

    together = trace([1.0, 0.9, 0.5, 0.2], 8, 1)
    # with albedo 1 among them there is no Russian roulette, so the paths are the same
    for column, albedo in enumerate([1.0, 0.9, 0.5, 0.2]):
        np.testing.assert_allclose(trace([1.0, albedo], 8, 1)[..., 1], together[..., column], rtol=1e-4, atol=1e-9)
    # alone, Russian roulette applies: other paths, same mean
    for column, albedo in ((1, 0.9), (2, 0.5)):
        alone = trace([albedo], 8, 2)[..., 0].mean(axis=1)
        assert abs(z_score(alone, together[..., column].mean(axis=1))) < 4
    # each order carries its own power; a path starts alike whatever its limit
    first = trace([1.0, 0.5], 1, 3, max_collisions=1)
    assert first.any()
    np.testing.assert_allclose(first[..., 1], 0.5 * first[..., 0], rtol=1e-5)
    second = trace([1.0, 0.5], 1, 3, max_collisions=2) - first
    assert second.any()
    np.testing.assert_allclose(second[..., 1], 0.25 * second[..., 0], rtol=1e-3, atol=1e-6)


def test_scattering_points_lie_at_exponential_depths():
    cells, sigma = 32, 30.0
    density = np.ones((cells,) * 3, np.float32)
    count = 20_000
    x, valid = sample_scattering_points(density, sigma, np.tile([[1.0, 0, 0]], (count, 1)), 4)
    assert valid.all()
    s = x[:, 0] + 0.5
    half = 0.5 / cells
    depth = sigma * np.where(s < half, 0.5 * s + 0.5 * s * s * cells, s - 0.125 / cells)
    # rims of half density bend the depth across the other axes: keep to the middle
    middle = np.abs(x[:, 1:]).max(axis=1) < 0.45
    uniform = np.sort(1 - np.exp(-depth[middle]))
    ranks = (np.arange(uniform.size) + 0.5) / uniform.size
    # Kolmogorov's distribution: 1.95 is passed once in a thousand
    assert np.abs(uniform - ranks).max() * np.sqrt(uniform.size) < 1.95
    across = x[middle, 1:] / 0.9 + 0.5
    assert np.abs(across.mean(axis=0) - 0.5).max() < 5 * np.sqrt(1 / 12 / middle.sum())
    assert np.abs(across.var(axis=0) - 1 / 12).max() < 0.003


def test_empty_space_scatters_nothing():
    empty = np.zeros((16,) * 3, np.float32)
    _, valid = sample_scattering_points(empty, 50.0, sphere_lattice(8), 1, tries=50)
    assert not valid.any()
    suns = sphere_lattice(2)
    vertices = Vertices(np.zeros((4, 3)), sphere_lattice(4), 50.0, 0.0, [1])
    assert not trace_points(Scene(empty, suns), vertices, Sampling(4, 1)).any()
    camera = PinholeCamera((2, 0, 0), (0, 0, 0), (0, 0, 1), 40, 4)
    image = trace_pixels(Scene(empty, (0, 0, 1)), camera, Medium(50.0), Sampling(4, 1))
    assert not image.any()


def test_arguments_that_do_not_fit_are_refused():
    density = smooth_cloud(12)
    with pytest.raises(ValueError, match="cube of cells"):
        prepare(np.zeros((4, 5, 4)))
    with pytest.raises(ValueError, match="not negative"):
        prepare(-density)
    with pytest.raises(ValueError, match="must lie in the cube"):
        Vertices([[0, 0, 0.6]], [[0, 0, 1]], 1.0, 0.0, [1.0])
    with pytest.raises(ValueError, match="2 positions but 1 directions"):
        Vertices([[0, 0, 0], [0, 0, 0.1]], [[0, 0, 1]], 1.0, 0.0, [1.0])
    with pytest.raises(ValueError, match="none of them zero"):
        Scene(density, [[0, 0, 0]])
    camera = PinholeCamera((2, 0, 0), (0, 0, 0), (0, 0, 1), 40, 4)
    with pytest.raises(ValueError, match="one sun, not 2"):
        trace_pixels(Scene(density, np.eye(3)[:2]), camera, Medium(50.0), Sampling(1, 1))
    with pytest.raises(ValueError, match="one extinction for all channels"):
        trace_pixels(Scene(density, (0, 0, 1)), camera, Medium((50.0, 40.0, 30.0)), Sampling(1, 1))


@pytest.mark.slow
@pytest.mark.parametrize("view", ["smoke-20-front-g0", "cumulus-100-back-g0"])
def test_pixels_agree_with_independent_references(view):
    """Block means against those of the references, in standard errors estimated from the halves.

    The references leave a pixel black in both halves where a few trial rays all missed the
    medium; those pixels say nothing. Pixels are chosen by the alpha of a third render, where a
    black one cannot be chance (0.9^256), so that the choice favours neither side.
    """
    reference = np.load(REFERENCES / "views" / f"{view}.npz")
    density = independent_density(view.split("-")[0])
    scene = Scene(density, reference["sun"])
    camera = PinholeCamera(reference["cam"], (0, 0, 0), (0, 1, 0), float(reference["fov"]), 96)
    medium = Medium(float(reference["sigma"]), reference["albedo"], float(reference["g"]))
    ours = np.stack(
        [trace_pixels(scene, camera, medium, Sampling(48, seed, max_collisions=2048)) for seed in (1, 2, 3)]
    ).astype(np.float64)[..., [0, 3]]
    theirs = reference["ab"].astype(np.float64)[..., [0, 3]]
    known = (ours[2, ..., 1] > 0.1) & (theirs[..., 1].mean(axis=0) > 0)
    assert known.sum() > 700
    ours = ours[:2]

    # blocks of 150 known pixels, neighbours in reading order
    rows, columns = np.nonzero(known)
    blocks = np.array_split(np.arange(rows.size), rows.size // 150)
    mine = np.stack([ours[:, rows[b], columns[b]].mean(axis=1) for b in blocks], axis=1)
    other = np.stack([theirs[:, rows[b], columns[b]].mean(axis=1) for b in blocks], axis=1)
    difference = mine.mean(axis=0) - other.mean(axis=0)
    # variance of a block mean from the halves' pixel differences, which average the blocks' noise
    variance = np.stack(
        [
            sum(((h[0] - h[1])[rows[b], columns[b]] ** 2).mean(axis=0) / 4 / b.size for h in (ours, theirs))
            for b in blocks
        ]
    )
    z = difference / np.sqrt(variance)
    chi = (z**2).mean(axis=0)
    bias = difference.mean(axis=0) / other.mean(axis=(0, 1))
    agree = np.all(chi < 1 + 5 * np.sqrt(2 / len(blocks))) and np.all(np.abs(z) < 5) and np.all(np.abs(bias) < 0.02)
    if not agree:
        folder = tempfile.mkdtemp(prefix="path_tracer_")
        np.savez(Path(folder) / f"{view}.npz", ours=ours, theirs=theirs, known=known)
        pytest.fail(f"{view}: mean square z {chi}, bias {bias}; images in {folder}")


def test_a_wide_image_is_the_middle_of_a_square_one():
    place = (1.2, 0.4, 0.9), (0, 0, 0), (0, 0, 1), 30.0
    square, wide = PinholeCamera(*place, 16).rays(), PinholeCamera(*place, 16, 8).rays()
    np.testing.assert_allclose(wide, square[4:12], atol=1e-6)
    scene = Scene(smooth_cloud(16), (0, 0, 1))
    assert trace_pixels(scene, PinholeCamera(*place, 16, 8), Medium(5.0), Sampling(1, 1)).shape == (8, 16, 4)
