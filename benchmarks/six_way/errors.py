# SPDX-License-Identifier: GPL-3.0-or-later
"""How far six-way light maps are from renders, for suns between their six sides.

    python -m benchmarks.six_way.errors [--size 64] [--directions 5]

Each row is a real volume in one phase function, with suns of one angular diameter. A picture is recombined from the
maps for suns in directions drawn from a seed, as game engines do, and compared with a render with this sun: relative
RMSE inside the volume, its mean and its largest value, and the mean bias. *From a side* is the same for suns from the
six sides, where nothing is interpolated. The last column is the expected error of the renders themselves.
"""

import argparse
from collections.abc import Iterator

import numpy as np

from ..fidelity.real_volumes import FILES, real_density
from ..support.data import volume_file
from ..support.extension import extension
from ..support.provenance import made_by

PROGRAM = "benchmarks.six_way.errors"
SIGMA_HAT, ALBEDO = 100.0, 0.9
ANISOTROPIES = 0.0, 0.6
VOLUMES = "openvdb-smoke", "smoke-wind", "torus"
SEED = 56
# Of the suns, degrees: the default and the largest.
ANGLES = 0, 40
HEAD = ("volume", "anisotropy", "light angle", "mean error", "largest", "bias", "from a side", "of the render")


def rows(name: str, anisotropy: float, size: int, directions: np.ndarray) -> Iterator[list[str]]:
    """The rows of the table for one volume."""
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
    cache = inference.RenderCache()

    def rendered(direction: np.ndarray) -> object:
        return inference.render(
            volumes, [inference.Sun(world[:3, :3] @ direction, maps_of.IRRADIANCE)], camera, settings, cache=cache
        )

    sides = [np.array(side) for side in maps_of.SIDES.values()]
    expected = [(direction, rendered(direction)) for direction in (*directions, *sides)]
    for angle in ANGLES:
        maps = maps_of.render_tile(description, settings, np.radians(angle)).maps
        figures = np.array([_compared(maps_of.recombined(maps, direction), layer) for direction, layer in expected])
        between, from_sides = figures[: len(directions)], figures[len(directions) :]
        error, bias, stated = between.mean(axis=0)
        yield [
            name,
            f"{anisotropy:g}",
            f"{angle}°",
            f"{error:.2f}",
            f"{between[:, 0].max():.2f}",
            f"{100.0 * bias:+.0f} %",
            f"{from_sides[:, 0].mean():.3f}",
            f"{stated:.3f}",
        ]


def _compared(found: np.ndarray, layer: object) -> tuple[float, float, float]:
    """Relative RMSE and bias inside the volume, and the expected error of the render."""
    expected, shown = layer.rgb[..., 0], layer.alpha > 0.01
    apart, mean = (found - expected)[shown], expected[shown].mean()
    return np.sqrt(np.mean(apart**2)) / mean, apart.mean() / mean, layer.report.expected_error.error


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
                for cells in rows(name, anisotropy, arguments.size, directions):
                    print("| " + " | ".join(cells) + " |", flush=True)
    print("\n" + made_by(PROGRAM, options))


if __name__ == "__main__":
    main()
