# SPDX-License-Identifier: GPL-3.0-or-later
"""A cloud over sand, in a mirror and behind glass: baked light beside Cycles with 1024 bounces.

    python -m benchmarks.cycles.baked_picture [--width 240] [--samples 8] [--longest 256]

Writes docs/images/baked-light.png, three pictures in a row, all denoised: baked light; 1024 bounces in the processor
seconds of bake and render together; 1024 bounces with `--longest` samples. Prints their seconds. Needs bpy.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np
from PIL import Image

from training.data.volumes import make_volume

from ..fidelity.views import VOLUMES
from .baked_surroundings import plane

PICTURE = Path(__file__).resolve().parents[2] / "docs" / "images" / "baked-light.png"
BOUNCES, CELLS, EXPOSURE = 1024, 96, 0.55


def stage(folder: Path, width: int):
    """The scene: the cloud in the middle, sand below it, a mirror behind it, a pane of glass before its right side."""
    from mathutils import Matrix

    from tests.support import blender_scenes as scenes

    scene = scenes.empty_scene()
    scene.render.resolution_x, scene.render.resolution_y = width, width * 3 // 4
    sky = scene.world.node_tree.nodes["Background"].inputs
    sky["Color"].default_value, sky["Strength"].default_value = (0.35, 0.55, 0.9, 1.0), 0.45
    # The cloud is lit by the sun alone.
    scene.world.cycles_visibility.scatter = False
    path = scenes.write_vdb(folder, make_volume(VOLUMES["cloud1"], CELLS).density, scenes.centred(CELLS, 2.8))
    scenes.add_volume(scene, path, Density=25.0, Color=(1.0,) * 4, Anisotropy=0.7, Absorption_Color=(0.0,) * 4)
    scenes.add_sun(scene, strength=9.0, rotation=(0.9, -0.35, 0.3)).data.angle = 0.01
    ground = np.eye(4)
    ground[2, 3] = -1.0
    plane(scene, "Ground", ground, 40.0, "ShaderNodeBsdfDiffuse", Color=(0.5, 0.38, 0.25, 1.0))
    # Frames, so that one sees where mirror and glass are.
    mirror = _upright([-2.0, 2.0, 0.55], [-0.25, -1.6, 0.45])
    plane(scene, "Mirror", mirror, 2.3, "ShaderNodeBsdfGlossy", Roughness=0.0, Color=(0.9,) * 4)
    frame = mirror.copy()
    frame[:3, 3] += 0.02 * frame[:3, 2]
    plane(scene, "Frame", frame, 2.45, "ShaderNodeBsdfDiffuse", Color=(0.25, 0.12, 0.05, 1.0))
    for depth in (-2.0, -2.08):
        pane = _upright([0.85, depth, 0.0], [0.85, depth + 1.0, 0.0])
        if depth == -2.0:
            pane[:3, :3] = pane[:3, :3] @ np.diag([1.0, -1.0, -1.0])
        plane(scene, "Pane", pane, 1.3, "ShaderNodeBsdfRefraction", IOR=1.3, Roughness=0.03, Color=(0.95, 1.0, 0.95, 1))
    scenes.add_camera(scene).data.angle = 0.8
    scene.camera.matrix_world = Matrix(_upright([0.35, -5.2, 0.45], [-0.1, 0.0, 0.1]).tolist())
    return scene


def _upright(position, target) -> np.ndarray:
    """Camera to world, with the world's third axis up."""
    z = np.subtract(position, target) / np.linalg.norm(np.subtract(position, target))
    x = np.cross([0.0, 0.0, 1.0], z)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), position
    return matrix


def main() -> None:
    parser = argparse.ArgumentParser()
    for name, usual in (("width", 240), ("samples", 8), ("longest", 256)):
        parser.add_argument(f"--{name}", type=int, default=usual)
    options = parser.parse_args()
    from ..support.extension import extension

    extension()
    import bpy

    from tests.support import blender_scenes as scenes

    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene = stage(folder, options.width)

        def picture(samples: int, bounces: int) -> tuple[np.ndarray, float]:
            scenes.set_up_cycles(scene, samples, bounces)
            scene.cycles.max_bounces, scene.cycles.use_denoising = max(bounces, 12), True
            scene.cycles.volume_step_rate = 1.0
            start = time.process_time()
            image = scenes.rendered(scene, folder, transparent=False)[..., :3]
            return image, time.process_time() - start

        start = time.process_time()
        bpy.ops.mrpnn.bake_light(folder=name)
        bake = time.process_time() - start
        lit, seconds = picture(options.samples, 0)
        bpy.ops.mrpnn.bake_light_remove()
        rate = picture(1, BOUNCES)[1]
        same, longest = max(round((bake + seconds) / rate), 1), options.longest
        images = [lit]
        print(f"baked light: bake {bake:.1f} s, {options.samples} samples {seconds:.1f} s", flush=True)
        for samples in (same, longest):
            image, seconds = picture(samples, BOUNCES)
            images.append(image)
            print(f"{BOUNCES} bounces, {samples} samples: {seconds:.1f} s", flush=True)
    for what, image in zip(("baked light", "the same seconds"), images):
        error = np.sqrt(np.mean((image - images[-1]) ** 2)) / images[-1].mean()
        print(f"{what}: difference to the last picture {error:.3f}, bias {(image.mean() / images[-1].mean() - 1):+.3f}")
    row = np.concatenate(images, axis=1) * EXPOSURE
    shown = np.where(row <= 0.0031308, 12.92 * row, 1.055 * np.maximum(row, 1e-9) ** (1 / 2.4) - 0.055)
    Image.fromarray((np.clip(shown, 0.0, 1.0) * 255 + 0.5).astype(np.uint8)).save(PICTURE)


if __name__ == "__main__":
    main()
