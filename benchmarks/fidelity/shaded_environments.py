# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of light from everywhere that surfaces shadow unevenly, beside those of twelve parallel lights.

    python -m benchmarks.fidelity.shaded_environments

Renders a held-back procedural volume next to black surfaces and compares it with paths traced through the same density,
which end where they meet a surface after they have left it. RMSE and bias as in benchmarks.fidelity.environments.
"""

import argparse
import time

import numpy as np

from inference import Environment, Medium, Settings, Surface, render
from inference.plan.directional_lights import directional_lights
from inference.plan.lights import DIRECTIONS
from training.procedural.seeded_volume import seeded_volume
from training.tracer.density_grid import prepare
from training.tracer.exits import decode_directions, trace_camera_exits
from training.tracer.path_tracer import Sampling
from training.train_environment import environment_values

from ..support.provenance import made_by
from .environments import MIN_ALPHA, VIEWS, cameras, compare, environments

PROGRAM = "benchmarks.fidelity.shaded_environments"
SEED, MEDIA, ALBEDO = 1001200, ((24.0, 0.5), (200.0, 0.857)), 0.98
LIGHTS = ("even", "gradient over dark ground", "broad lobe")


def rectangle(axis: int, at: float, low, high) -> np.ndarray:
    """Two triangles (2, 3, 3) across an axis, from low to high (2,) along the other axes."""
    corners = np.insert([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])], axis, at, axis=1)
    return corners[[[0, 1, 2], [0, 2, 3]]].astype(float)


SURFACES = {
    "wall beside": rectangle(0, 0.6, (-2.0, -0.5), (2.0, 2.0)),
    "roof above one half": rectangle(2, 0.6, (-3.0, -3.0), (0.0, 3.0)),
    "square of ground": rectangle(2, -0.55, (-0.8, -0.8), (0.8, 0.8)),
    "slit in a roof": np.concatenate(
        [rectangle(2, 0.6, (-3.0, -3.0), (-0.1, 3.0)), rectangle(2, 0.6, (0.1, -3.0), (3.0, 3.0))]
    ),
}


def meets(places: np.ndarray, directions: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Whether rays from places along directions, (N, 3), meet any triangle (T, 3, 3) (Moeller and Trumbore 1997)."""
    found = np.zeros(len(places), bool)
    for a, b, c in triangles:
        p, away = np.cross(directions, c - a), places - a
        q = np.cross(away, b - a)
        with np.errstate(divide="ignore", invalid="ignore"):
            scale = 1.0 / (p @ (b - a))
            u, v, t = (away * p).sum(axis=1) * scale, (q * directions).sum(axis=1) * scale, (q @ (c - a)) * scale
            found |= (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)
    return found


def references(traced, triangles: np.ndarray, images: np.ndarray) -> np.ndarray:
    """Two independent references float64 (2, E, pixels) of environments (E, H, 2H) behind surfaces."""
    found = []
    for exits, places, hit in traced:
        directions = decode_directions(exits.directions)
        seen = hit & ~meets(places.reshape(-1, 3), directions.reshape(-1, 3), triangles).reshape(hit.shape)
        left = seen * np.float32(ALBEDO) ** (exits.scatterings + 1.0)
        found.append(np.einsum("pk,pke->ep", left, environment_values(images, exits.directions)) / hit.shape[1])
    return np.array(found)


def main(options=None):
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=24, help="pixels per edge")
    parser.add_argument("--paths", type=int, default=2048, help="per pixel")
    arguments = parser.parse_args(options)
    volume, _ = seeded_volume(SEED)
    grid, (camera, pinhole) = prepare(volume.density), cameras(VIEWS["level"], arguments.size)
    named, settings = environments(), Settings(depth_samples=16, threads=1)
    images = np.stack([named[name] for name in LIGHTS])
    print(made_by(PROGRAM, options, ("mrpnn", "environment/mrpnn")))
    print("| surfaces | thickness | G | light | error | bias | seconds | 12 lights: error | bias | seconds |")
    print("|---|---|---|---|---|---|---|---|---|---|")
    for sigma, g in MEDIA:
        traced = [
            trace_camera_exits(grid, pinhole, sigma, g, Sampling(arguments.paths // 2, seed)) for seed in range(2)
        ]
        shown = np.mean([found.hit.mean(axis=1) for found in traced], axis=0) > MIN_ALPHA
        for where, triangles in SURFACES.items():
            halves, surfaces = references(traced, triangles, images), [Surface(triangles, where)]
            for e, name in enumerate(LIGHTS):
                environment = Environment(np.repeat(images[e][..., None], 3, axis=2), name=name)
                line = f"| {where} | {sigma:g} | {g:g} | {name} |"
                for lights in ([environment], directional_lights(environment, DIRECTIONS)):
                    start = time.process_time()
                    layer = render([(volume, Medium(sigma, ALBEDO, g))], lights, camera, settings, surfaces=surfaces)
                    seconds = time.process_time() - start
                    error, bias = compare(layer.rgb[..., 0].ravel()[shown], halves[:, e][:, shown])
                    line += f" {error:.3f} | {100 * bias:+.1f} % | {seconds:.1f} |"
                print(line, flush=True)


if __name__ == "__main__":
    main()
