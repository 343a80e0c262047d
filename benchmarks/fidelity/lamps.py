# SPDX-License-Identifier: GPL-3.0-or-later
"""Multiple scattering of lamps in procedural volumes, against photons followed from them.

    python -m benchmarks.fidelity.lamps [--seeds 4] [--photons 100000] [--anisotropies 0 0.857]

Each volume, of a seed that no network has learnt from, is seen by orthographic cameras along its six axes, and lit by a
point light inside of it, at its edge, and outside, and by a spot light at its edge that shines at its middle. Photons
are followed through the volume by delta tracking, and connected to the cameras wherever they collide, but for the first
time. RMSE is relative to the mean and without the photons' noise, of images of 12 x 12 pixels, and a mean over the six.
Bias is that of images' means, from the lamp's side (cameras within 60 degrees of it), from beside, and towards the
lamp; its standard error is the largest of an image.
"""

import argparse

import numba
import numpy as np

from inference import Camera, Medium, PointLight, Settings, SpotLight, render
from training.procedural.seeded_volume import cube_volume
from training.procedural.volumes import make_volume
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
#: Directions (6, 3) to the cameras.
VIEWS = np.concatenate([np.eye(3), -np.eye(3)]).astype(np.float32)
#: Angle of the spot's cone, in radians.
ANGLE = 0.7

_F0, _F1, _F2, _HALF = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(0.5)


@numba.njit(cache=True, fastmath=True)
def _follow(grid, lamp, cone, coefficients, walk, views, out):
    """Add the light of a lamp that gives 1 / (4 pi) W/sr within a cone to pixels (V, P, P): W/sr per cell, without the
    first collisions. cone: directions (3, 3) across it and along its axis, and the cosine of half its angle."""
    (padded, majorant), (axis, narrow), (photons, seed) = grid, cone, walk
    sigma, anisotropy, albedo = coefficients
    cells, pixels = padded.shape[0] - 2, out.shape[-1]
    medium = GridMedium(padded, majorant, sigma, anisotropy)
    for photon in range(photons):
        state = seed_state(seed, photon)
        state, bits = draw(state)
        u, v = two_uniforms(bits)
        height, angle = _F1 - (_F1 - narrow) * u, np.float32(2.0 * np.pi) * v
        flat = np.sqrt(max(_F1 - height * height, _F0))
        x, y = flat * np.cos(angle), flat * np.sin(angle)
        dx = x * axis[0, 0] + y * axis[1, 0] + height * axis[2, 0]
        dy = x * axis[0, 1] + y * axis[1, 1] + height * axis[2, 1]
        dz = x * axis[0, 2] + y * axis[1, 2] + height * axis[2, 2]
        ray = Ray(lamp[0], lamp[1], lamp[2], dx, dy, dz)
        if min(lamp[0], lamp[1], lamp[2]) < _F0 or max(lamp[0], lamp[1], lamp[2]) > cells:
            meets, ray = enter_cube(ray, cells)
            if not meets:
                continue
        weight = (_F1 - narrow) * _HALF
        for order in range(MOST):
            collided, ray, state = delta_track(ray, medium, state)
            if not collided:
                break
            weight *= albedo
            for view in range(len(views) if order else 0):
                vx, vy, vz = views[view, 0], views[view, 1], views[view, 2]
                passed, state = ratio_track(Ray(ray.x, ray.y, ray.z, vx, vy, vz), medium, state)
                a = ray.y if vx != _F0 else ray.x
                b = ray.y if vz != _F0 else ray.z
                i, j = min(int(a * pixels / cells), pixels - 1), min(int(b * pixels / cells), pixels - 1)
                cosine = ray.dx * vx + ray.dy * vy + ray.dz * vz
                out[view, i, j] += weight * passed * phase_hg(cosine, anisotropy)
            if weight < np.float32(0.01) * (_F1 - narrow):
                state, bits = draw(state)
                u, _ = two_uniforms(bits)
                if u > _HALF:
                    break
                weight *= _F2
            dx, dy, dz, state = scatter(ray.dx, ray.dy, ray.dz, anisotropy, state)
            ray = Ray(ray.x, ray.y, ray.z, dx, dy, dz)


def traced(density: np.ndarray, light: PointLight | SpotLight, medium: Medium, photons: int) -> np.ndarray:
    """Images (BATCHES, V, P, P) of the multiple scattering of a lamp of power 1 in the unit cube around 0."""
    grid, cells = prepare(density), len(density)
    coefficients = np.float32(medium.sigma_t[0] / cells), np.float32(medium.anisotropy), np.float32(medium.albedo[0])
    spot = isinstance(light, SpotLight)
    narrow, along = (np.cos(0.5 * light.angle), light.direction) if spot else (-1.0, np.array([0.0, 0.0, 1.0]))
    across = np.linalg.svd(along[None])[2][1:]
    axis = np.concatenate([across, along[None]]).astype(np.float32)
    found = np.zeros((BATCHES, len(VIEWS), PIXELS, PIXELS))
    for batch, out in enumerate(found):
        place = ((light.position + 0.5) * cells).astype(np.float32)
        arrays, cone = (grid.padded, grid.majorant), (axis, np.float32(narrow))
        _follow(arrays, place, cone, coefficients, (photons // BATCHES, batch + 1), VIEWS, out)
    return found * (BATCHES / photons * PIXELS**2)


def shown(density: np.ndarray, light: PointLight | SpotLight, medium: Medium) -> np.ndarray:
    """The renderer's images (V, P, P)."""
    images = []
    for view in VIEWS:
        # Columns and rows of pixels lie along the other two axes, in their order.
        a, b = (axis for axis in range(3) if not view[axis])
        matrix = np.eye(4)
        matrix[:3, 0], matrix[:3, 2], matrix[:3, 3] = np.eye(3)[a], view, 4.0 * view
        matrix[:3, 1] = np.cross(view, np.eye(3)[a])
        camera = Camera(matrix, "orthographic", (PIXELS * RAYS, PIXELS * RAYS), ortho_scale=WIDTH)
        layer = render([(cube_volume(density), medium)], [light], camera, Settings(8, threads=1))
        image = layer.multiple[..., 0].reshape(PIXELS, RAYS, PIXELS, RAYS).mean(axis=(1, 3))
        images.append((image[::-1] if matrix[b, 1] > 0.0 else image).T)
    return np.array(images)


def cases(seed: int):
    """A volume's density, the extinction at its densest, its middle, and lamps of power 1 by name."""
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
    lamps = {name: PointLight(place, 1.0) for name, place in places.items()}
    lamps["spot at the edge"] = SpotLight(places["edge"], -way, 1.0, ANGLE)
    return density, float(np.exp(random.uniform(np.log(15.0), np.log(80.0)))) / float(density.max()), middle, lamps


def compare(images: np.ndarray, batches: np.ndarray) -> tuple[float, np.ndarray, float]:
    """Mean relative RMSE without noise, biases (V,), and the largest of their standard errors."""
    reference, count = batches.mean(axis=0), len(batches)
    mean = reference.mean(axis=(1, 2))
    noise = (batches.var(axis=0, ddof=1) / count).mean(axis=(1, 2))
    square = ((images - reference) ** 2).mean(axis=(1, 2)) - noise
    error = batches.mean(axis=(2, 3)).std(axis=0, ddof=1) / np.sqrt(count) / mean
    return float((np.sqrt(np.maximum(square, 0.0)) / mean).mean()), images.mean(axis=(1, 2)) / mean - 1.0, error.max()


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
    print("| volume | G | extinction | light | RMSE | bias from its side | from beside | towards it | ± |")
    print("|---|---|---|---|---|---|---|---|---|")
    for seed in range(SEED, SEED + arguments.seeds):
        density, sigma, middle, lamps = cases(seed)
        for anisotropy in arguments.anisotropies:
            medium = Medium(sigma, arguments.albedo, anisotropy)
            for name, lamp in lamps.items():
                truth = traced(density, lamp, medium, arguments.photons)
                rmse, bias, error = compare(shown(density, lamp, medium), truth)
                cosine = VIEWS @ (lamp.position - middle) / np.linalg.norm(lamp.position - middle)
                sides = [bias[which] for which in (cosine > 0.5, np.abs(cosine) <= 0.5, cosine < -0.5)]
                means = " | ".join(f"{side.mean():+.1%}" if len(side) else "–" for side in sides)
                facts = f"| {seed} | {anisotropy:g} | {sigma:.0f} | {name} | {rmse:.3f} |"
                print(f"{facts} {means} | {error:.1%} |", flush=True)


if __name__ == "__main__":
    main()
