# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that volumes emit and scatter, against traced paths.

    python -m benchmarks.fidelity.emission [--seeds 4] [--size 16] [--paths 256] [--anisotropies 0 0.857]

Each volume, of a seed that no network has learnt from, has an albedo of 0.9. Parts of it glow, and a flame burns in it
or beside it. It is seen by one orthographic camera. RMSE is relative to the mean and without the paths' noise, and ± is
the standard error of the bias.
"""

import argparse

import numpy as np

from inference import Medium, Volume, render
from training.data.light_scene import EMISSIONS, _flame, _glowing_density
from training.procedural.seeded_volume import cube_volume
from training.procedural.volumes import make_volume

from ..support.provenance import made_by
from .colours import CELLS, SETTINGS, Coloured, compare, traced

PROGRAM = "benchmarks.fidelity.emission"
#: First seed of the volumes, their extinction where the density is 1, per cube edge, and their albedo.
SEED, SIGMAS, ALBEDO = 1_000_420, (20.0, 150.0), 0.9


def shown(scene: Coloured, emission: np.ndarray, anisotropy: float, size: int) -> np.ndarray:
    """The renderer's images (E, size, size, 3) of emission (N, N, N, E)."""
    volume, medium, images = cube_volume(scene.density), Medium(scene.sigma, ALBEDO, anisotropy), []
    for field in np.moveaxis(emission, 3, 0):
        grey = np.repeat(field[..., None], 3, axis=3)
        glowing = Volume(volume.density, volume.world_from_index, volume.name, grey)
        images.append(render([(glowing, medium)], [], scene.camera(size), SETTINGS).multiple)
    return np.array(images)


def main(options=None):
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--size", type=int, default=16, help="pixels along an edge")
    parser.add_argument("--paths", type=int, default=256, help="per pixel, of both halves together")
    parser.add_argument("--anisotropies", type=float, nargs="+", default=[0.0, 0.857])
    arguments = parser.parse_args(options)
    print(made_by(PROGRAM, options))
    print("| volume | G | extinction | emission | RMSE | bias | ± |")
    print("|---|---|---|---|---|---|---|")
    for seed in range(SEED, SEED + arguments.seeds):
        random, density = np.random.default_rng([seed, 9]), make_volume(seed, CELLS).density
        emission = np.stack([_glowing_density(random, density), _flame(random, density)], axis=3)
        view = np.linalg.qr(random.normal(size=(3, 3)))[0].T
        even, white = np.zeros_like(density), np.full(3, ALBEDO, np.float32)
        for sigma in SIGMAS:
            scene = Coloured(density, even, white, white, sigma, np.zeros((0, 3)), view * np.linalg.det(view))
            for anisotropy in arguments.anisotropies:
                halves = traced(scene, scene.lights(emission), anisotropy, arguments.size, arguments.paths)
                images = shown(scene, emission, anisotropy, arguments.size)
                for number, name in enumerate(EMISSIONS):
                    here = slice(number, number + 1)
                    rmse, bias, error = compare(images[here], halves[:, here], scene.seen(arguments.size))
                    facts = f"| {seed} | {anisotropy:g} | {sigma:.0f} | {name} |"
                    print(f"{facts} {rmse:.3f} | {bias.mean():+.1%} | {error:.1%} |", flush=True)


if __name__ == "__main__":
    main()
