# SPDX-License-Identifier: GPL-3.0-or-later
"""Training data: descriptors and path-traced radiance at points where camera rays scatter.

    nice python -m training.data.targets --out data/train --volumes 0-399

Writes one file per volume, `data/train/0000000.npz` and so on; files that exist are left alone, so that the command
can be stopped and started again. Everything follows from the volume's seed. A row is a point and one sun:

| array | dtype and shape | content |
|---|---|---|
| features | float16 (rows, 2, 192) | density feature mu and scaled transmittance S at the stencil's points (A.2, A.3) |
| ray | float32 (rows, `ray_features.COLUMNS`) | light along the camera ray |
| around | float32 (rows, `scattered_fluence.COLUMNS`) | fluence and flux around the point |
| gathered | float16 (rows, `final_gather.DIRECTIONS`, `VALUES`) | light from directions around the camera ray |
| position, omega, sun | float32 (rows, 3) | point, ray direction and direction to the sun, in cube units |
| gamma, anisotropy, sigma_hat | float32 (rows,) | angle to the sun, mean cosine, extinction per cube edge |
| albedo | float32 (rows, ALBEDOS) | the first is 1 |
| radiance | float32 (rows, 2, ALBEDOS) | path-traced targets in two independent halves, 1/sr |

Every path is connected to all suns of its volume and weighted with all albedos of its point: one path serves
SUNS * ALBEDOS targets. A volume is seen as several media, each with its own points. What networks read is computed by
the functions that rendering uses.
"""

import argparse
import pathlib
from dataclasses import dataclass

import numpy as np

from inference import Medium
from inference.features.descriptors import angle_to_sun
from inference.features.final_gather import DIRECTIONS, VALUES, FinalGather, unit_sun_depth
from inference.features.final_gather import LEVEL as GATHER_LEVEL
from inference.features.mip_lattices import density_pyramid, padded_levels
from inference.features.stencil import frames
from inference.grids.bound_medium import BoundMedium
from inference.grids.grid import Grid
from inference.grids.working_cube import fit_cube, mean_density
from inference.marching.marcher import ray_features_at
from inference.marching.ray_features import COLUMNS as RAY_COLUMNS
from inference.paper.sun_lattices import unit_optical_depths
from inference.source_terms.cell_sources import SunBeam
from inference.transport.discrete_ordinates import LEVEL, DiscreteOrdinates
from inference.transport.scattered_fluence import COLUMNS as AROUND_COLUMNS
from inference.transport.scattered_fluence import FluenceLattice, ScatteredFluence, fluence_and_flux, fluence_lattice
from training.data.descriptors import Levels, describe_points
from training.data.stencil import load_stencil
from training.files import write_rows
from training.procedural.seeded_volume import seeded_volume
from training.tracer.path_tracer import Sampling, Scene, Vertices, sample_scattering_points, trace_points

#: Extinction per cube edge where density is 1.
SIGMA_HAT_RANGE = (1.0, 2000.0)
ANISOTROPY_RANGE = (-0.3, 0.95)
SUNS = 4
ALBEDOS = 4
#: Media per volume, each an extinction and a mean cosine.
MEDIA = 4
#: Points per volume, and paths per point.
POINTS = 1536
PATHS = 128


@dataclass(frozen=True)
class ScatteringPoints:
    """Where camera rays scatter: positions and ray directions omega (N, 3) in the world, and each point's medium.

    medium: int (N,), number of the medium; albedos: (N, ALBEDOS).
    """

    positions: np.ndarray
    omega: np.ndarray
    medium: np.ndarray
    albedos: np.ndarray


def unit_vectors(random, count: int) -> np.ndarray:
    """(count, 3) directions, uniform over the sphere."""
    v = random.normal(size=(count, 3))
    return v / np.linalg.norm(v, axis=1, keepdims=True)


def rays_towards(random, suns: np.ndarray, count: int) -> np.ndarray:
    """(count, 3) ray directions whose angle gamma to one of the suns, (S, 3), is uniform in [0, pi]."""
    axis = suns[random.integers(len(suns), size=count)]
    across = np.cross(axis, unit_vectors(random, count))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    gamma = random.uniform(0.0, np.pi, (count, 1))
    return np.cos(gamma) * axis + np.sin(gamma) * across


def draw_sigma(random, count: int) -> np.ndarray:
    """(count,) extinctions per cube edge, log-uniform and stratified over SIGMA_HAT_RANGE, in random order."""
    low, high = np.log(SIGMA_HAT_RANGE)
    return np.exp(low + (high - low) * random.permutation((np.arange(count) + random.random(count)) / count))


def draw_anisotropy(random, count: int) -> np.ndarray:
    """(count,) mean cosines: half uniform over the range, a fifth in 0.8 to 0.95, the others 0.857, 0 or 0.5.

    Uniform ones are rounded to multiples of 0.005, so that tables of the phase function can be reused.
    """
    even = random.uniform(*ANISOTROPY_RANGE, count)
    strong = random.uniform(0.8, ANISOTROPY_RANGE[1], count)
    kind = random.choice(5, count, p=[0.5, 0.2, 0.18, 0.06, 0.06])
    usual = np.choose(kind, [even, strong, np.full(count, 0.857), np.zeros(count), np.full(count, 0.5)])
    return np.where(kind < 2, np.round(usual / 0.005) * 0.005, usual)


def draw_albedos(random, count: int) -> np.ndarray:
    """(count, ALBEDOS): exactly 1, one close to 1, and two over wider ranges."""
    albedos = np.ones((count, ALBEDOS))
    albedos[:, 1] = 1.0 - 10.0 ** random.uniform(-3.0, -0.7, count)
    albedos[:, 2] = random.uniform(0.7, 1.0, count)
    albedos[:, 3] = random.uniform(0.0, 1.0, count)
    return albedos


def draw_points(random, density, suns, media, count: int, seed: int) -> ScatteringPoints:
    """Up to `count` points where rays scatter in media (M, 2), extinction per cube edge and mean cosine."""
    medium = np.sort(random.integers(MEDIA, size=count))
    omega = rays_towards(random, suns, count)
    albedos = draw_albedos(random, count)
    positions, valid = sample_scattering_points(
        density, media[medium, 0].astype(np.float32), omega.astype(np.float32), seed
    )
    return ScatteringPoints(positions[valid], omega[valid], medium[valid], albedos[valid])


def make_targets(seed: int, points: int = POINTS, paths: int = PATHS) -> dict:
    """Rows of one volume: a dict of the arrays that the module describes, sun after sun."""
    stencil = load_stencil()
    volume, random = seeded_volume(seed)
    density, cube = volume.density, fit_cube(volume)

    suns = unit_vectors(random, SUNS)
    media = np.stack([draw_sigma(random, MEDIA), draw_anisotropy(random, MEDIA)], axis=1)
    at = draw_points(random, density, suns, media, points, seed)
    sigma, anisotropy = media[at.medium].T
    scene = Scene(density, suns)
    vertices = Vertices(at.positions, at.omega, sigma, anisotropy, at.albedos)
    # Two independent halves, so that errors can be measured without the targets' own noise.
    halves = [trace_points(scene, vertices, Sampling(paths // 2, 2 * seed + half)) for half in range(2)]
    radiance = np.stack(halves, axis=2)

    x, w, l = cube.positions(at.positions), cube.directions(at.omega), cube.directions(suns)
    pyramid = density_pyramid(mean_density(volume, cube))
    ray, around, gathered = describe_light(volume, cube, pyramid, suns, media, at)
    padded = padded_levels(pyramid, stencil)
    sigma_hat = sigma * cube.edge
    rows = []
    for k, sun in enumerate(suns):
        levels = Levels(padded, unit_optical_depths(padded, l[k]))
        features = describe_points(stencil, levels, x, w, l[k], sigma_hat)
        rows.append(
            {
                "features": features.astype(np.float16).transpose(1, 0, 2),
                "position": at.positions,
                "omega": at.omega.astype(np.float32),
                "sun": np.broadcast_to(sun, (len(x), 3)).astype(np.float32),
                "gamma": angle_to_sun(w, l[k]),
                "anisotropy": anisotropy.astype(np.float32),
                "sigma_hat": sigma_hat.astype(np.float32),
                "ray": ray[:, k],
                "around": around[:, k],
                "gathered": gathered[:, k].astype(np.float16),
                "albedo": at.albedos.astype(np.float32),
                "radiance": radiance[:, k].astype(np.float32),
            }
        )
    return {key: np.concatenate([r[key] for r in rows]) for key in rows[0]}


def describe_light(volume, cube, pyramid, suns, media, points: ScatteringPoints):
    """What networks read of light, float32 (N, S, ...): along rays, around points, and gathered around the rays.

    The last axes are RAY_COLUMNS, AROUND_COLUMNS, and DIRECTIONS, VALUES. pyramid: of the volume's density. suns:
    (S, 3), and media: (M, 2), extinction per cube edge and mean cosine, in the world.
    """
    grid = Grid(volume)
    depths = grid.sun_depths(suns)
    x, w, l = cube.positions(points.positions), cube.directions(points.omega), cube.directions(suns)
    ray = np.empty((len(x), len(suns), RAY_COLUMNS), np.float32)
    around = np.empty((len(x), len(suns), AROUND_COLUMNS), np.float32)
    gathered = np.empty((len(x), len(suns), DIRECTIONS, VALUES), np.float32)
    fine = pyramid[GATHER_LEVEL]
    shadows = [unit_sun_depth(fine, sun) for sun in l]
    for number in np.unique(points.medium):
        sigma, anisotropy = media[number]
        own = np.flatnonzero(points.medium == number)
        ordinates = DiscreteOrdinates(pyramid[LEVEL], sigma * cube.edge, anisotropy)
        lattices = [fluence_lattice(ordinates.solve(SunBeam(sun))) for sun in l]
        for k, values in enumerate(lattices):
            around[own, k] = FluenceLattice(values).read(x[own], w[own], l[k], anisotropy)
            gather = FinalGather.of(fine, shadows[k], fluence_and_flux(values), (sigma * cube.edge, anisotropy))
            gathered[own, k] = gather(x[own], frames(w[own], l[k]))
        fluence = ScatteredFluence.in_cube(cube, [fluence_and_flux(values) for values in lattices], anisotropy)
        bound = BoundMedium(grid, Medium(sigma, 1.0, anisotropy), sigma, depths)
        ray[own] = ray_features_at(bound, points.positions[own], points.omega[own], fluence).values[:, 0]
    return ray, around, gathered


def parse_range(text: str) -> range:
    """FIRST-LAST, both included, or a single number."""
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--volumes", type=parse_range, required=True, help="seeds, FIRST-LAST")
    parser.add_argument("--points", type=int, default=POINTS)
    parser.add_argument("--paths", type=int, default=PATHS)
    arguments = parser.parse_args(options)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for seed in arguments.volumes:
        write_rows(arguments.out / f"{seed:07d}.npz", lambda: make_targets(seed, arguments.points, arguments.paths))


if __name__ == "__main__":
    main()
