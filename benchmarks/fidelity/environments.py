# SPDX-License-Identifier: GPL-3.0-or-later
"""Errors of light from everywhere against traced paths, and if asked of what is predicted alone and of parallel lights.

    python -m benchmarks.fidelity.environments [--seeds 1000200 1600200 1500200] [--predicted] [--directions]

Renders held-back procedural volumes in six environments, each of mean radiance 1, and compares them with paths traced
through the same density (`training.tracer.exits`): the relative RMSE and bias of `evaluation.error`, over the
pixels that show the volume. One trace serves all environments and albedos. Prints a row per picture as JSON, and means.
"""

import argparse
import json
import math
import time
from dataclasses import replace

import numpy as np

from inference import Camera, Environment, Medium, Settings, render
from inference.plan.directional_lights import directional_lights
from inference.plan.lights import DIRECTIONS
from inference.scene.environment import pixel_directions, pixel_solid_angles
from training.procedural.seeded_volume import seeded_volume
from training.tracer.density_grid import prepare
from training.tracer.exits import trace_camera_exits
from training.tracer.path_tracer import Sampling
from training.tracer.scene import PinholeCamera
from training.train_environment import environment_values

from ..support.provenance import made_by

PROGRAM = "benchmarks.fidelity.environments"
ROWS, FIELD_OF_VIEW = 64, 36.0
SIGMAS, ANISOTROPIES, ALBEDOS = (20.0, 150.0, 600.0), (0.0, 0.5, 0.857), (1.0, 0.9)
#: Camera positions in units of the volume's cube; all look at its centre.
VIEWS = {"level": (0.0, -2.2, 0.15), "from below": (0.7, -1.2, -1.7), "from above": (-0.9, 0.9, 1.8)}
# What stands before the names of a system's columns: what is rendered, predicted alone, and parallel lights.
SYSTEMS = {"": "", "predicted_": "predicted alone: ", "suns_": "twelve parallel lights: "}
# Names of columns that stand for something else in the table.
KEYS = {"g": "G", "sigma": "optical thickness"}
# Opacity above which a pixel shows the volume.
MIN_ALPHA = 0.02


def environments() -> dict[str, np.ndarray]:
    """Radiance float32 (ROWS, 2 ROWS) of mean 1, by name."""
    directions = pixel_directions(ROWS)
    x, z = directions[..., 0], directions[..., 2]
    towards = np.array([0.6, -0.5, 0.62]) / np.linalg.norm([0.6, -0.5, 0.62])
    band = np.exp(-((z / 0.15) ** 2))
    found = {
        "even": np.ones_like(z),
        "gradient over dark ground": np.where(z > 0, 1.4 - 0.8 * np.clip(z, 0, 1), 0.08),
        "broad lobe": 0.05 + 4.0 * np.exp(8.0 * (directions @ towards - 1.0)),
        "glowing horizon": 0.1 + band * (1.0 + 0.5 * x),
        "from one side": 0.02 + np.clip(x, 0, 1),
        "from below": 0.02 + np.clip(-z, 0, 1),
    }
    weights = pixel_solid_angles(ROWS) / (4.0 * np.pi)
    return {name: (light / (light * weights).sum()).astype(np.float32) for name, light in found.items()}


def cameras(position, size: int) -> tuple[Camera, PinholeCamera]:
    """A camera at a position that looks at the origin, for the renderer and for the tracer."""
    position = np.asarray(position, float)
    forward = -position / np.linalg.norm(position)
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(right, forward), -forward, position], axis=1)
    camera = Camera(matrix, resolution=(size, size), fov=math.radians(FIELD_OF_VIEW))
    return camera, PinholeCamera(tuple(position), (0, 0, 0), (0, 0, 1), FIELD_OF_VIEW, size)


def references(density, medium: tuple[float, float], camera: PinholeCamera, images, paths: int):
    """Two independent references float64 (2, albedos, E, pixels), and opacity (pixels,)."""
    grid, halves = prepare(density), []
    for seed in range(2):
        exits, _, hit = trace_camera_exits(grid, camera, *medium, Sampling(paths // 2, seed))
        values, n = environment_values(images, exits.directions), exits.scatterings.astype(np.float32)
        halves.append([np.einsum("pk,pke->ep", hit * np.float32(a) ** (n + 1.0), values) / n.shape[1] for a in ALBEDOS])
    return np.array(halves), hit.mean(axis=1)


def compare(seen, halves) -> tuple[float, float]:
    """Relative RMSE, without the references' noise, and relative bias."""
    a, b = halves
    mean = 0.5 * (a + b).mean()
    return math.sqrt(max(float(((seen - a) * (seen - b)).mean()), 0.0)) / mean, float(seen.mean() / mean - 1.0)


def measure(seed: int, arguments):
    """Rows of one volume: dicts of what was rendered, errors and processor seconds."""
    volume, _ = seeded_volume(seed)
    named = environments()
    images = np.stack(list(named.values()))
    settings = Settings(depth_samples=arguments.depth_samples, threads=1)
    for sigma in arguments.sigma or SIGMAS:
        for g in arguments.anisotropy or ANISOTROPIES:
            for view in arguments.views or VIEWS:
                camera, pinhole = cameras(VIEWS[view], arguments.size)
                halves, alpha = references(volume.density, (sigma, g), pinhole, images, arguments.paths)
                shown = alpha > MIN_ALPHA
                for i, albedo in enumerate(ALBEDOS):
                    for e, (name, light) in enumerate(named.items()):
                        environment = Environment(np.repeat(light[..., None], 3, axis=2), name=name)
                        row = {
                            "seed": seed,
                            "sigma": sigma,
                            "g": g,
                            "view": view,
                            "albedo": albedo,
                            "environment": name,
                        }
                        systems = {"": ([environment], settings)}
                        if arguments.predicted:
                            systems["predicted_"] = [environment], replace(settings, light_paths=False)
                        if arguments.directions:
                            systems["suns_"] = directional_lights(environment, DIRECTIONS), settings
                        for prefix, (lights, chosen) in systems.items():
                            start = time.process_time()
                            layer = render([(volume, Medium(sigma, albedo, g))], lights, camera, chosen)
                            row[f"{prefix}seconds"] = time.process_time() - start
                            seen = layer.rgb[..., 0].ravel()[shown]
                            error, bias = compare(seen, halves[:, i, e][:, shown])
                            row |= {f"{prefix}error": error, f"{prefix}bias": bias}
                        yield row


def print_table(rows) -> None:
    """Print mean errors and seconds of all rows, and by each of their columns that varies."""
    systems = [prefix for prefix in SYSTEMS if f"{prefix}error" in rows[0]]
    named = ("RMSE", "bias", "largest", "seconds")
    head = "".join(f" {SYSTEMS[prefix]}{name} |" for prefix in systems for name in named)
    print(f"| pictures |{head}\n|{'---|' * (1 + 4 * len(systems))}")
    rows = [{"all": len(rows), **row} for row in rows]
    for key in ("all", "environment", "g", "sigma", "albedo", "view", "seed"):
        print_rows(rows, key, systems)


def print_rows(rows, key: str, systems) -> None:
    """Print mean errors of the rows by one of their columns."""
    for value in dict.fromkeys(row[key] for row in rows):
        line = f"| {'' if key == 'environment' else KEYS.get(key, key) + ' '}{value} |"
        for prefix in systems:
            error, bias, seconds = (
                np.array([row[f"{prefix}{column}"] for row in rows if row[key] == value])
                for column in ("error", "bias", "seconds")
            )
            line += f" {error.mean():.3f} | {100 * bias.mean():+.1f} % | {100 * np.abs(bias).max():.1f} %"
            line += f" | {seconds.mean():.2f} |"
        print(line)


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, nargs="+", default=[1000200, 1600200, 1500200])
    parser.add_argument("--sigma", type=float, nargs="+")
    parser.add_argument("--anisotropy", type=float, nargs="+")
    parser.add_argument("--views", nargs="+", choices=VIEWS)
    parser.add_argument("--size", type=int, default=48, help="pixels per edge")
    parser.add_argument("--paths", type=int, default=512, help="per pixel")
    parser.add_argument("--depth-samples", type=int, default=16)
    parser.add_argument("--predicted", action="store_true", help="also without the correction by light paths")
    parser.add_argument("--directions", action="store_true", help="also twelve parallel lights")
    arguments = parser.parse_args(options)
    print(made_by(PROGRAM, options, ("mrpnn", "environment/mrpnn")))
    rows = []
    for seed in arguments.seeds:
        for row in measure(seed, arguments):
            rows.append(row)
            print(json.dumps({k: round(v, 4) if isinstance(v, float) else v for k, v in row.items()}), flush=True)
    print_table(rows)


if __name__ == "__main__":
    main()
