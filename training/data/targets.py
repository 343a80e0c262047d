"""Training data: descriptors and path-traced radiance at points where camera rays scatter.

    nice python -m training.data.targets --out data/train --volumes 0-399

One file a volume, written through a temporary name and left alone when it exists: the
command can be stopped and started again. Everything follows from the volume's seed.

Every walk is connected to all suns of its volume and weighted with all albedos of its
point: one walk serves SUNS * ALBEDOS targets. A volume is seen as several media, each with
its points; what the network sees of them comes from the functions that rendering uses.
"""

import argparse
import os
import pathlib
import time

import numpy as np

from inference import Medium
from inference.grids.bound_medium import BoundMedium
from inference.grids.working_cube import fit_cube, level0_density
from inference.transport.scattered_fluence import COLUMNS as AROUND_COLUMNS
from inference.transport.scattered_fluence import ScatteredFluence, fluence_lattice, fluence_and_flux, read_fluence
from inference.features.mip_lattices import density_pyramid, padded_levels, unit_optical_depths
from inference.grids.grid import Grid
from inference.marching.ray_march import ray_features_at
from inference.transport.discrete_ordinates import LEVEL, DiscreteOrdinates
from inference.marching.ray_features import COLUMNS as RAY_COLUMNS
from inference.grids.optical_depth_sweep import sun_optical_depth
from training.data.descriptors import describe_points
from training.tracer.path_tracer import sample_scattering_points, trace_points
from training.data.seeded_volume import seeded_volume
from training.data.stencil import load_stencil
from training.tracer.transport import prepare

SIGMA_HAT_RANGE = (1.0, 2000.0)
ANISOTROPY_RANGE = (-0.3, 0.95)
SUNS = 4
ALBEDOS = 4
# Optical densities with a value of G each, a volume.
MEDIA = 8
POINTS = 1024
PATHS = 64


def unit_vectors(random, count: int) -> np.ndarray:
    v = random.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def rays_towards(random, suns: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) ray directions at angles to one of the suns that are even in gamma."""
    axis = suns[random.integers(len(suns), size=count)]
    across = np.cross(axis, unit_vectors(random, count))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    gamma = random.uniform(0.0, np.pi, (count, 1))
    return np.cos(gamma) * axis + np.sin(gamma) * across


def draw_sigma(random, count: int) -> np.ndarray:
    """Extinctions per cube edge, even in the logarithm: one in each of as many equal parts of the range, in any order."""
    low, high = np.log(SIGMA_HAT_RANGE)
    return np.exp(low + (high - low) * random.permutation((np.arange(count) + random.random(count)) / count))


def draw_anisotropy(random, groups: int) -> np.ndarray:
    """Mean cosines on a grid of 0.005: even over the range, with more of the strongest and of those most used."""
    even = random.uniform(*ANISOTROPY_RANGE, groups)
    strong = random.uniform(0.8, ANISOTROPY_RANGE[1], groups)
    kind = random.choice(5, groups, p=[0.5, 0.2, 0.18, 0.06, 0.06])
    usual = np.choose(kind, [even, strong, np.full(groups, 0.857), np.zeros(groups), np.full(groups, 0.5)])
    return np.where(kind < 2, np.round(usual / 0.005) * 0.005, usual)


def draw_albedos(random, count: int) -> np.ndarray:
    """(count, ALBEDOS): exactly 1, one close to 1, and the rest over the whole range."""
    albedos = np.ones((count, ALBEDOS))
    albedos[:, 1] = 1.0 - 10.0 ** random.uniform(-3.0, -0.7, count)
    albedos[:, 2] = random.uniform(0.7, 1.0, count)
    albedos[:, 3] = random.uniform(0.0, 1.0, count)
    return albedos


def make_targets(seed: int, points: int = POINTS, paths: int = PATHS):
    """Descriptors and targets of one volume: a dict of arrays with one row a (point, sun)."""
    stencil = load_stencil()
    volume, random = seeded_volume(seed)
    density = volume.density
    n = density.shape[0]
    cube = fit_cube(volume)

    suns = unit_vectors(random, SUNS)
    sun_tau = np.stack([sun_optical_depth(density, l * n, 1.0) for l in suns])
    media = np.stack([draw_sigma(random, MEDIA), draw_anisotropy(random, MEDIA)], axis=1)
    medium = np.sort(random.integers(MEDIA, size=points))
    omega = rays_towards(random, suns, points)
    albedos = draw_albedos(random, points)
    positions, valid = sample_scattering_points(
        density, media[medium, 0].astype(np.float32), omega.astype(np.float32), seed
    )
    medium, omega, albedos, positions = (a[valid] for a in (medium, omega, albedos, positions))
    sigma, anisotropy = media[medium].T
    grid = prepare(density)
    # Two independent halves, so that errors can be measured without the targets' own noise.
    radiance = np.stack([
        trace_points(grid, suns, sun_tau, positions, omega, sigma, anisotropy, albedos, paths // 2, 2 * seed + half)
        for half in range(2)
    ], axis=2)

    x, w, l = cube.positions(positions), cube.directions(omega), cube.directions(suns)
    pyramid = density_pyramid(level0_density(volume, cube))
    ray, around = describe_light(volume, cube, pyramid[LEVEL], suns, media, medium, positions, omega)
    padded = padded_levels(pyramid, stencil)
    sigma_hat = sigma * cube.edge
    rows = []
    for k, sun in enumerate(suns):
        features = describe_points(stencil, padded, unit_optical_depths(padded, l[k]), x, w, l[k], sigma_hat)
        rows.append(
            {
                "features": features.astype(np.float16).transpose(1, 0, 2),
                "position": positions,
                "omega": omega.astype(np.float32),
                "sun": np.broadcast_to(sun, (len(x), 3)).astype(np.float32),
                "gamma": np.arccos(np.clip(w @ l[k], -1.0, 1.0)).astype(np.float32),
                "anisotropy": anisotropy.astype(np.float32),
                "sigma_hat": sigma_hat.astype(np.float32),
                "ray": ray[:, k],
                "around": around[:, k],
                "albedo": albedos.astype(np.float32),
                "radiance": radiance[:, k].astype(np.float32),
            }
        )
    return {key: np.concatenate([r[key] for r in rows]) for key in rows[0]}


def describe_light(volume, cube, coarse, suns, media, medium, positions, omega):
    """What a network sees of light: along rays (N, S, ray_features.COLUMNS), and around points (N, S, scattered_fluence.COLUMNS).

    coarse: level `ordinates.LEVEL` of the volume's pyramid; suns: (S, 3); media: (M, 2) extinction per cube edge and G;
    medium: (N,) number of each point's; positions, omega: (N, 3), in the world.
    """
    grid = Grid(volume)
    sun_depths = grid.sun_depths(suns)
    x, w, l = cube.positions(positions), cube.directions(omega), cube.directions(suns)
    ray = np.empty((len(x), len(suns), RAY_COLUMNS), np.float32)
    around = np.empty((len(x), len(suns), AROUND_COLUMNS), np.float32)
    for number in np.unique(medium):
        sigma, anisotropy = media[number]
        own = np.flatnonzero(medium == number)
        ordinates = DiscreteOrdinates(coarse, sigma * cube.edge, anisotropy)
        cells = [fluence_lattice(ordinates.light(sun)) for sun in l]
        for k, values in enumerate(cells):
            around[own, k] = read_fluence(values.astype(np.float32), x[own], w[own], l[k], anisotropy)
        fluence = ScatteredFluence.in_cube(cube, [fluence_and_flux(values) for values in cells], anisotropy)
        bound = BoundMedium(grid, Medium(sigma, 1.0, anisotropy), sigma, sun_depths)
        ray[own] = ray_features_at(bound, positions[own], omega[own], fluence).values[:, 0]
    return ray, around


def parse_range(text: str) -> range:
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--volumes", type=parse_range, required=True, help="seeds, FIRST-LAST")
    parser.add_argument("--points", type=int, default=POINTS)
    parser.add_argument("--paths", type=int, default=PATHS)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for seed in arguments.volumes:
        target = arguments.out / f"{seed:07d}.npz"
        if target.exists():
            continue
        start = time.perf_counter()
        rows = make_targets(seed, arguments.points, arguments.paths)
        partial = target.with_suffix(".partial")
        with open(partial, "wb") as file:
            np.savez(file, **rows)
        os.replace(partial, target)
        print(f"{target.name}: {len(rows['gamma'])} rows in {time.perf_counter() - start:.1f} s", flush=True)


if __name__ == "__main__":
    main()
