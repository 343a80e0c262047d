# SPDX-License-Identifier: GPL-3.0-or-later
"""Flicker of baked light along a camera's path: light baked once, and light baked for every frame.

    python -m benchmarks.cycles.baked_film [--size 48] [--samples 4] [--frames 48]

Flicker is the root mean square of a pixel's difference to the mean of its two neighbours in time, over the mean
radiance. Printed are that of the pictures, of the same frames at ten times the samples, and of these without noise, as
two halves of different seeds tell it; the layer of the same frames has only the motion. Needs bpy.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from inference import Settings, render
from inference.scene.optimizations import ALL

from ..support.provenance import made_by

PROGRAM = "benchmarks.cycles.baked_film"
# The camera's path about the cloud: degrees per frame, and distance.
DEGREES, DISTANCE = 0.85, 6.0


def path(scene, frame: int) -> None:
    """Put the camera where it is in a frame."""
    from mathutils import Matrix

    from .baked_surroundings import towards

    angle = np.radians(DEGREES) * frame
    eye = DISTANCE * np.array([np.sin(angle), 0.0, np.cos(angle)])
    scene.camera.matrix_world = Matrix(towards(eye, np.zeros(3)).tolist())


def second_difference(images: np.ndarray) -> np.ndarray:
    """Difference (F - 2, H, W) of frames (F, H, W) to the means of their neighbours in time."""
    return images[1:-1] - 0.5 * (images[:-2] + images[2:])


def flicker(a: np.ndarray, b: np.ndarray | None = None) -> float:
    """Relative flicker of frames (F, H, W); with another half b of them, without their noise."""
    first = second_difference(a)
    power = float((first * (first if b is None else second_difference(b))).mean())
    return float(np.sqrt(max(power, 0.0)) / a.mean())


def main() -> None:
    parser = argparse.ArgumentParser()
    for name, usual in (("size", 48), ("samples", 4), ("frames", 48)):
        parser.add_argument(f"--{name}", type=int, default=usual)
    parser.add_argument("--density", type=float, default=15.0)
    parser.add_argument("--anisotropy", type=float, default=0.857)
    options = parser.parse_args()
    from ..support.extension import extension

    extension()
    import bpy
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    from tests.support import blender_scenes as scenes

    from .baked_surroundings import stage

    def picture(folder: Path, samples: int, seed: int) -> np.ndarray:
        scenes.set_up_cycles(scene, samples, 0)
        scene.cycles.volume_step_rate, scene.cycles.seed = 1.0, seed
        scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
        return scenes.rendered(scene, folder)[..., :3].mean(axis=2)

    print(f"| | {options.samples} samples | {10 * options.samples} samples | without noise |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        scene = stage(Path(folder), options)
        exact = Settings(depth_samples=32, optimizations=ALL - {"shared_pixels"})
        layers = []
        for frame in range(options.frames):
            path(scene, frame)
            found = read_scene(scenes.depsgraph())
            layers.append(render(found.volumes, found.lights, found.camera, exact).rgb.mean(axis=2))
        print(f"| the layer | | | {flicker(np.array(layers)):.4f} |", flush=True)
        for often in (False, True):
            path(scene, options.frames // 2)
            bpy.ops.mrpnn.bake_light(folder=folder)
            noisy, a, b = [], [], []
            for frame in range(options.frames):
                path(scene, frame)
                if often:
                    bpy.ops.mrpnn.bake_light(folder=folder, everything=True)
                noisy.append(picture(Path(folder), options.samples, 3 * frame))
                a.append(picture(Path(folder), 5 * options.samples, 3 * frame + 1))
                b.append(picture(Path(folder), 5 * options.samples, 3 * frame + 2))
            noisy, a, b = (np.array(frames, np.float64) for frames in (noisy, a, b))
            found = " | ".join(f"{flicker(*frames):.4f}" for frames in ((noisy,), (0.5 * (a + b),), (a, b)))
            print(f"| light baked {'for every frame' if often else 'once'} | {found} |", flush=True)
    print(made_by(PROGRAM))


if __name__ == "__main__":
    main()
