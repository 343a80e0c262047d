# SPDX-License-Identifier: GPL-3.0-or-later
"""Training data for light from everywhere: where paths leave volumes, and the coarse transport of some environments.

    nice python -m training.data.environment_targets --out data/exits --volumes 2000000-2000399

Writes one file per volume; files that exist are left alone, so that the command can be stopped and started again. A row
is a point where a camera ray scatters. Any environment's radiance follows from its paths (`training.tracer.exits`), for
any albedo; what is read of the coarse transport is kept for the ENVIRONMENTS environments of the volume.

| array | dtype and shape | content |
|---|---|---|
| exits, scatterings | uint16 (rows, PATHS) | directions and numbers of scatterings of `Exits` |
| position, omega | float32 (rows, 3) | point and ray direction, in the working cube |
| sigma_hat, anisotropy | float32 (rows,) | extinction per cube edge, mean cosine |
| density | float16 (rows, 40) | density feature mu at the sparse stencil's low-frequency points |
| depths | float16 (rows, 50) | optical depth towards DIRECTIONS for sigma_hat = 1 |
| along | float32 (rows, 2) | optical depth ahead of the point on its ray, and behind it |
| light | float16 (rows, ENVIRONMENTS, PROBES, 4) | fluence over 4 pi and flux over 4 pi at the probes |
| absorbed | float16 (rows, ENVIRONMENTS + 1, PROBES, ALBEDOS, 4) | the same in absorbing media, even light last |
| environments | float16 (ENVIRONMENTS, 64, 128) | radiance of the environments, of mean 1 |
"""

import argparse
import pathlib
import time

import numpy as np

from inference.environments.environment_light import (
    ALBEDOS,
    ordinate_radiance,
    read_lattice,
    solve_environment,
)
from inference.environments.open_depths import OpenDepths, direction_depths
from inference.features.mip_lattices import density_pyramid, padded_levels
from inference.features.stencil import LOW_POINTS, SPARSE
from inference.grids.working_cube import fit_cube, mean_density
from inference.network.environment_features import probe_positions
from inference.source_terms.cell_sources import EnteringLight
from inference.transport.discrete_ordinates import LEVEL
from training.data.descriptors import Levels, describe_points
from training.data.environments import random_environment
from training.data.stencil import load_stencil
from training.data.targets import draw_anisotropy, parse_range, unit_vectors
from training.files import complete_file
from training.procedural.seeded_volume import seeded_volume
from training.tracer.density_grid import prepare
from training.tracer.exits import optical_depths, trace_exits
from training.tracer.path_tracer import Sampling, sample_scattering_points
from training.tracer.scene import Vertices

SIGMA_HAT_RANGE = (2.0, 1500.0)
#: Environments and media per volume, points of all media, and paths per point.
ENVIRONMENTS, MEDIA, POINTS, PATHS = 6, 5, 1536, 96


def transport_rows(pyramid, positions, omega, sigma_hat, anisotropy, radiance):
    """The arrays depths, light and absorbed of points in the cube's frame.

    pyramid: of the density. radiance: (26, ENVIRONMENTS).
    """
    coarse = pyramid[LEVEL]
    depths = OpenDepths(pyramid[:2], direction_depths(coarse))(positions)
    probes, count = probe_positions(positions, omega, depths, sigma_hat), radiance.shape[1]
    light = np.empty((len(positions), count, probes.shape[1], 4), np.float16)
    absorbed = np.empty((len(positions), count + 1, probes.shape[1], len(ALBEDOS), 4), np.float16)
    for thickness, g in np.unique(np.stack([sigma_hat, anisotropy], axis=1), axis=0):
        own = np.flatnonzero((sigma_hat == thickness) & (anisotropy == g))
        entering = [EnteringLight(channel / (4.0 * np.pi)) for channel in np.asarray(radiance).T]
        lattices = solve_environment(coarse, thickness, g, entering)
        shape = *probes[own].shape[:2], 4
        scattered, seldom = (read_lattice(lattice, probes[own].reshape(-1, 3)) for lattice in lattices)
        light[own] = np.moveaxis(scattered.reshape(*shape, count), 3, 1)
        absorbed[own] = np.moveaxis(seldom.reshape(*shape, len(ALBEDOS), count + 1), (4, 3), (1, 3))
    return depths, light, absorbed


def make_rows(seed: int, sigma_hat_range: tuple[float, float] = SIGMA_HAT_RANGE) -> dict:
    """The arrays of one volume. sigma_hat_range: of its media, log-uniform."""
    volume, random = seeded_volume(seed)
    cube, grid = fit_cube(volume), prepare(volume.density)
    environments = np.stack([random_environment(random) for _ in range(ENVIRONMENTS)])
    radiance = ordinate_radiance(np.moveaxis(environments, 0, -1))

    low, high = np.log(sigma_hat_range)
    sigmas = np.exp(low + (high - low) * random.permutation((np.arange(MEDIA) + random.random(MEDIA)) / MEDIA))
    media = np.stack([sigmas, draw_anisotropy(random, MEDIA)], axis=1)
    medium = np.sort(random.integers(MEDIA, size=POINTS))
    omega = unit_vectors(random, POINTS)
    positions, valid = sample_scattering_points(
        grid, media[medium, 0].astype(np.float32), omega.astype(np.float32), seed
    )
    positions, omega, medium = positions[valid], omega[valid], medium[valid]
    sigma, anisotropy = media[medium].T

    exits = trace_exits(grid, Vertices(positions, omega, sigma, anisotropy, 1.0), Sampling(PATHS, seed))
    ahead, behind = (optical_depths(grid, positions, sign * omega) * sigma for sign in (1, -1))

    x, w, sigma_hat = cube.positions(positions), cube.directions(omega), sigma * cube.edge
    pyramid = density_pyramid(mean_density(volume, cube))
    depths, light, absorbed = transport_rows(pyramid, x, w, sigma_hat, anisotropy, radiance)
    stencil = load_stencil()
    padded = padded_levels(pyramid, stencil)
    up = np.array([0.0, 0.0, 1.0])
    shadows = [np.zeros_like(level) for level in padded[1:]]
    density = describe_points(stencil, Levels(padded, shadows), x, w, up, sigma_hat)[0]
    return {
        "exits": exits.directions,
        "scatterings": exits.scatterings,
        "position": x.astype(np.float32),
        "omega": w.astype(np.float32),
        "sigma_hat": sigma_hat.astype(np.float32),
        "anisotropy": anisotropy.astype(np.float32),
        "density": density[:, :LOW_POINTS:SPARSE].astype(np.float16),
        "depths": depths.astype(np.float16),
        "along": np.stack([ahead, behind], axis=1).astype(np.float32),
        "light": light,
        "absorbed": absorbed,
        "environments": environments.astype(np.float16),
    }


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--volumes", type=parse_range, required=True, help="seeds, FIRST-LAST")
    parser.add_argument("--sigma-hat", type=float, nargs=2, default=SIGMA_HAT_RANGE, metavar=("LOW", "HIGH"))
    arguments = parser.parse_args(options)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for seed in arguments.volumes:
        path = arguments.out / f"{seed:07d}.npz"
        if path.exists():
            continue
        start = time.process_time()
        rows = make_rows(seed, tuple(arguments.sigma_hat))
        with complete_file(path) as file:
            np.savez(file, **rows)
        print(f"{path.name}: {len(rows['sigma_hat'])} points in {time.process_time() - start:.1f} s", flush=True)


if __name__ == "__main__":
    main()
