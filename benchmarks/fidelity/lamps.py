# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering of point lights in procedural volumes, against photons followed from the lamp.

    python -m benchmarks.fidelity.lamps [--seeds 4] [--photons 100000] [--anisotropies 0 0.857]

Each volume, of a seed that no network has learnt from, is seen by an orthographic camera and lit by a point light
inside of it, at its edge, and outside. Photons are followed through the volume by delta tracking, and connected to the
camera wherever they collide, but for the first time. RMSE is relative to the mean and without the photons' noise, of
images of 12 x 12 pixels; bias is that of the mean, with its standard error.
"""

import argparse

import numba
import numpy as np

from inference import Camera, Medium, PointLight, Settings, render
from training.data.seeded_volume import cube_volume
from training.data.volumes import make_volume
from training.tracer.density_grid import prepare
from training.tracer.henyey_greenstein import phase_hg, scatter
from training.tracer.path_tracer import enter_cube
from training.tracer.random_numbers import draw, seed_state, two_uniforms
from training.tracer.tracking import GridMedium, Ray, delta_track, ratio_track

from ..support.provenance import made_by

PROGRAM = "benchmarks.fidelity.lamps"
#: First seed of the volumes, and their cells along an edge.
SEED, CELLS = 3_300_000, 96
#: Pixels along an edge, rays in each along an edge, and batches of photons.
PIXELS, RAYS, BATCHES = 12, 4, 8
#: Width of the image, in edges of the volume.
WIDTH = 1.0
#: Collisions that are followed.
MOST = 4096

_F0, _F1, _F2, _HALF = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(0.5)


@numba.njit(cache=True, fastmath=True)
def _follow(grid, lamp, coefficients, photons, seed, out):
    """Add the light of a lamp of power 1 that leaves towards z to pixels (P, P): W/sr per cell, without the first
    collisions."""
    padded, majorant = grid
    sigma, anisotropy, albedo = coefficients
    cells, pixels = padded.shape[0] - 2, out.shape[0]
    medium = GridMedium(padded, majorant, sigma, anisotropy)
    for photon in range(photons):
        state = seed_state(seed, photon)
        state, bits = draw(state)
        u, v = two_uniforms(bits)
        height, angle = _F1 - _F2 * u, np.float32(2.0 * np.pi) * v
        flat = np.sqrt(max(_F1 - height * height, _F0))
        ray = Ray(lamp[0], lamp[1], lamp[2], flat * np.cos(angle), flat * np.sin(angle), height)
        if min(lamp[0], lamp[1], lamp[2]) < _F0 or max(lamp[0], lamp[1], lamp[2]) > cells:
            meets, ray = enter_cube(ray, cells)
            if not meets:
                continue
        weight = _F1
        for order in range(MOST):
            collided, ray, state = delta_track(ray, medium, state)
            if not collided:
                break
            weight *= albedo
            if order:
                up = Ray(ray.x, ray.y, ray.z, _F0, _F0, _F1)
                passed, state = ratio_track(up, medium, state)
                i, j = int(ray.x * pixels / cells), int(ray.y * pixels / cells)
                out[min(i, pixels - 1), min(j, pixels - 1)] += weight * passed * phase_hg(ray.dz, anisotropy)
            if weight < np.float32(0.02):
                state, bits = draw(state)
                u, _ = two_uniforms(bits)
                if u > _HALF:
                    break
                weight *= _F2
            dx, dy, dz, state = scatter(ray.dx, ray.dy, ray.dz, anisotropy, state)
            ray = Ray(ray.x, ray.y, ray.z, dx, dy, dz)


def traced(density: np.ndarray, lamp: np.ndarray, medium: Medium, photons: int) -> np.ndarray:
    """Images (BATCHES, P, P) of multiple scattering, seen along z, of a lamp of power 1 in the unit cube around 0."""
    grid, cells = prepare(density), len(density)
    coefficients = np.float32(medium.sigma_t[0] / cells), np.float32(medium.anisotropy), np.float32(medium.albedo[0])
    found = np.zeros((BATCHES, PIXELS, PIXELS))
    for batch, out in enumerate(found):
        place = ((lamp + 0.5) * cells).astype(np.float32)
        _follow((grid.padded, grid.majorant), place, coefficients, photons // BATCHES, batch + 1, out)
    return found * (BATCHES / photons * PIXELS**2)


def shown(density: np.ndarray, lamp: np.ndarray, medium: Medium) -> np.ndarray:
    """The renderer's image (P, P)."""
    camera = Camera(np.eye(4), "orthographic", (PIXELS * RAYS, PIXELS * RAYS), ortho_scale=WIDTH)
    camera.world_matrix[2, 3] = 4.0
    layer = render([(cube_volume(density), medium)], [PointLight(lamp, 1.0)], camera, Settings(8, threads=1))
    image = layer.multiple[..., 0].reshape(PIXELS, RAYS, PIXELS, RAYS).mean(axis=(1, 3))
    return image[::-1].T


def cases(seed: int):
    """A volume's density, the extinction at its densest, and places of a lamp by name."""
    random = np.random.default_rng([seed, 26])
    density = make_volume(seed, CELLS).density
    filled = np.argwhere(density > 0.3 * density.max())
    inside = (filled[random.integers(len(filled))] + 0.5) / CELLS - 0.5
    way = random.normal(size=3)
    way /= np.linalg.norm(way)
    # Outwards from the middle until nothing is left.
    middle = (filled.mean(axis=0) + 0.5) / CELLS - 0.5
    far = max((((filled + 0.5) / CELLS - 0.5 - middle) @ way).max(), 0.1)
    places = {"inside": inside, "edge": middle + far * way, "outside": middle + (far + 0.5) * way}
    return density, float(np.exp(random.uniform(np.log(15.0), np.log(80.0)))) / float(density.max()), places


def compare(image: np.ndarray, batches: np.ndarray) -> tuple[float, float, float]:
    """Relative RMSE without noise, bias, and its standard error."""
    reference, count = batches.mean(axis=0), len(batches)
    mean = reference.mean()
    noise = (batches.var(axis=0, ddof=1) / count).mean()
    square = ((image - reference) ** 2).mean() - noise
    error = batches.mean(axis=(1, 2)).std(ddof=1) / np.sqrt(count)
    return float(np.sqrt(max(square, 0.0)) / mean), float(image.mean() / mean - 1.0), float(error / mean)


def main(options=None):
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--photons", type=int, default=100_000)
    parser.add_argument("--anisotropies", type=float, nargs="+", default=[0.0, 0.857])
    parser.add_argument("--albedo", type=float, default=0.9)
    arguments = parser.parse_args(options)
    print(made_by(PROGRAM, options))
    print("| volume | G | extinction | light | RMSE | bias |\n|---|---|---|---|---|---|")
    for seed in range(SEED, SEED + arguments.seeds):
        density, sigma, places = cases(seed)
        for anisotropy in arguments.anisotropies:
            medium = Medium(sigma, arguments.albedo, anisotropy)
            for name, lamp in places.items():
                rmse, bias, error = compare(
                    shown(density, lamp, medium), traced(density, lamp, medium, arguments.photons)
                )
                facts = f"| {seed} | {anisotropy:g} | {sigma:.0f} | {name} | {rmse:.3f} |"
                print(f"{facts} {100 * bias:+.1f} ± {100 * error:.1f} % |", flush=True)


if __name__ == "__main__":
    main()
