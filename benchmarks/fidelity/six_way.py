# SPDX-License-Identifier: GPL-3.0-or-later
"""How far six-way light maps are from renders, for suns between their six sides.

    python -m benchmarks.fidelity.six_way [--size 64] [--directions 5]

Each row is a real volume in one phase function. A picture is recombined from the maps for suns in directions drawn from
a seed, as game engines do, and compared with a render with this sun: relative RMSE inside the volume, its mean and its
largest value, and the mean bias. *From a side* is the same for suns from the six sides, where nothing is interpolated.
The last column is the expected error of the renders themselves.
"""

import argparse

import numpy as np

from ..support.data import volume_file
from ..support.extension import extension
from ..support.provenance import made_by
from .real_volumes import FILES, real_density

PROGRAM = "benchmarks.fidelity.six_way"
SIGMA_HAT, ALBEDO = 100.0, 0.9
ANISOTROPIES = 0.0, 0.6
VOLUMES = "openvdb-smoke", "smoke-wind", "torus"
SEED = 56
HEAD = ("volume", "anisotropy", "mean error", "largest", "bias", "from a side", "of the render")


def row(name: str, anisotropy: float, size: int, directions: np.ndarray) -> list[str]:
    """One row of the table."""
    addon = extension()
    inference, maps_of = addon.inference, addon.mrpnn_addon.flipbook.light_maps
    density = real_density(name)
    matrix = np.diag([*(1.0 / np.array(density.shape)), 1.0])
    matrix[:3, 3] = 0.5 / len(density) - 0.5
    medium = inference.Medium(sigma_t=SIGMA_HAT, albedo=ALBEDO, anisotropy=anisotropy)
    volumes = [(inference.Volume(density, matrix, name=name), medium)]
    # Looks along +Y, with +Z up.
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = np.array([(1, 0, 0), (0, 0, 1), (0, -1, 0)]).T, (0.0, -3.0, 0.0)
    camera = inference.Camera(world, projection="orthographic", resolution=(size, size), ortho_scale=1.0)
    settings = inference.Settings(depth_samples=8)
    description = addon.mrpnn_addon.scene.reader.SceneDescription(volumes=volumes, camera=camera)
    maps = maps_of.render_tile(description, settings).maps
    cache = inference.RenderCache()

    def compared(direction: np.ndarray) -> tuple[float, float, float]:
        sun = inference.Sun(world[:3, :3] @ direction, maps_of.IRRADIANCE)
        layer = inference.render(volumes, [sun], camera, settings, cache=cache)
        expected, shown = layer.rgb[..., 0], layer.alpha > 0.01
        apart = (maps_of.recombined(maps, direction) - expected)[shown]
        mean = expected[shown].mean()
        return np.sqrt(np.mean(apart**2)) / mean, apart.mean() / mean, layer.report.expected_error.error

    between = np.array([compared(direction) for direction in directions])
    sides = np.array([compared(np.array(side)) for side in maps_of.SIDES.values()])
    error, bias, stated = between.mean(axis=0)
    return [
        name,
        f"{anisotropy:g}",
        f"{error:.2f}",
        f"{between[:, 0].max():.2f}",
        f"{100.0 * bias:+.0f} %",
        f"{sides[:, 0].mean():.3f}",
        f"{stated:.3f}",
    ]


def main(options: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=64, help="pixels per edge")
    parser.add_argument("--directions", type=int, default=5, help="suns between the sides")
    arguments = parser.parse_args(options)
    directions = np.random.default_rng(SEED).normal(size=(arguments.directions, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    print("| " + " | ".join(HEAD) + " |\n|" + "---|" * len(HEAD))
    for name in VOLUMES:
        for anisotropy in ANISOTROPIES:
            if volume_file(FILES[name][0]).exists():
                print("| " + " | ".join(row(name, anisotropy, arguments.size, directions)) + " |", flush=True)
    print("\n" + made_by(PROGRAM, options))


if __name__ == "__main__":
    main()
