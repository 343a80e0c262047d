"""Training data: descriptors and path-traced radiance at points where camera rays scatter.

    nice python -m training.targets --out data/train --volumes 0-799

One file a volume, written through a temporary name and left alone when it exists: the
command can be stopped and started again. Everything follows from the volume's seed.

Every walk is connected to all suns of its volume and weighted with all albedos of its
point: one walk serves SUNS * ALBEDOS targets.
"""

import argparse
import os
import pathlib
import time

import numpy as np

from inference.cube import fit_cube, level0_density
from inference.fields import density_pyramid, padded_levels, unit_optical_depths
from inference.phase import PhaseFeatures
from inference.scene import Volume
from inference.stencil import make_stencil
from inference.transmittance import sun_optical_depth
from training.descriptors import describe_points
from training.path_tracer import sample_scattering_points, trace_points
from training.volumes import make_volume

SIGMA_HAT_RANGE = (1.0, 2000.0)
ANISOTROPY_RANGE = (-0.3, 0.95)
RESOLUTION = 160
SUNS = 4
ALBEDOS = 4
# Values of G a volume; the table of phase features is made once for each.
GROUPS = 8
POINTS = 1536
PATHS = 48


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


def draw_anisotropy(random, groups: int) -> np.ndarray:
    """Mean cosines: even over the range, with the values that scenes use most drawn more often."""
    even = random.uniform(*ANISOTROPY_RANGE, groups)
    usual = random.choice([0.0, 0.5, 0.857], groups)
    return np.where(random.random(groups) < 0.25, usual, even)


def draw_albedos(random, count: int) -> np.ndarray:
    """(count, ALBEDOS): exactly 1, one close to 1, and the rest over the whole range."""
    albedos = np.ones((count, ALBEDOS))
    albedos[:, 1] = 1.0 - 10.0 ** random.uniform(-3.0, -0.7, count)
    albedos[:, 2] = random.uniform(0.7, 1.0, count)
    albedos[:, 3] = random.uniform(0.0, 1.0, count)
    return albedos


def make_targets(seed: int, points: int = POINTS, paths: int = PATHS):
    """Descriptors and targets of one volume: a dict of arrays with one row a (point, sun)."""
    random = np.random.default_rng([seed, 2023])
    stencil = make_stencil_once()
    sample = make_volume(seed, RESOLUTION)
    n = sample.density.shape[0]
    # The generator's cube is the world here: cell centres at (i + 1/2) / n - 1/2.
    world_from_index = np.diag([1 / n, 1 / n, 1 / n, 1.0])
    world_from_index[:3, 3] = 0.5 / n - 0.5
    volume = Volume(sample.density, world_from_index)
    cube = fit_cube(volume)
    padded = padded_levels(density_pyramid(level0_density(volume, cube)), stencil)

    suns = unit_vectors(random, SUNS)
    sun_tau = np.stack([sun_optical_depth(sample.density, l * n, 1.0) for l in suns])
    sigma = np.exp(random.uniform(*np.log(SIGMA_HAT_RANGE), points))
    group = np.sort(random.integers(GROUPS, size=points))
    values = draw_anisotropy(random, GROUPS)
    omega = rays_towards(random, suns, points)
    albedos = draw_albedos(random, points)
    positions, valid = sample_scattering_points(
        sample.density, sigma.astype(np.float32), omega.astype(np.float32), seed
    )
    sigma, group, omega, albedos, positions = (a[valid] for a in (sigma, group, omega, albedos, positions))
    anisotropy = values[group]
    radiance = trace_points(
        sample.density, suns, sun_tau, positions, omega, sigma, anisotropy, albedos, paths, seed
    )

    sigma_hat = sigma * cube.edge
    x, w = cube.positions(positions), cube.directions(omega)
    rows = []
    for k, sun in enumerate(suns):
        l = cube.directions(sun)
        features = np.empty((3, len(x), stencil.mips.size), np.float16)
        features[:2] = describe_points(stencil, padded, unit_optical_depths(padded, l), x, w, l, sigma_hat)
        gamma = np.arccos(np.clip(w @ l, -1.0, 1.0))
        for i, g in enumerate(values):
            rows_of_g = group == i
            features[2, rows_of_g] = PhaseFeatures(stencil, g)(gamma[rows_of_g])
        rows.append(
            {
                "features": features.transpose(1, 0, 2),
                "gamma": gamma.astype(np.float32),
                "anisotropy": anisotropy.astype(np.float32),
                "sigma_hat": sigma_hat.astype(np.float32),
                "albedo": albedos.astype(np.float32),
                "radiance": radiance[:, k].astype(np.float32),
            }
        )
    return {key: np.concatenate([r[key] for r in rows]) for key in rows[0]}


_stencil = None


def make_stencil_once():
    global _stencil
    _stencil = _stencil or make_stencil()
    return _stencil


def parse_range(text: str) -> range:
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--volumes", type=parse_range, required=True, help="seeds, FIRST-LAST")
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    for seed in arguments.volumes:
        target = arguments.out / f"{seed:07d}.npz"
        if target.exists():
            continue
        start = time.perf_counter()
        rows = make_targets(seed)
        partial = target.with_suffix(".partial")
        with open(partial, "wb") as file:
            np.savez(file, **rows)
        os.replace(partial, target)
        print(f"{target.name}: {len(rows['gamma'])} rows in {time.perf_counter() - start:.1f} s", flush=True)


if __name__ == "__main__":
    main()
