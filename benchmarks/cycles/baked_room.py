# SPDX-License-Identifier: GPL-3.0-or-later
"""A closed room with fog, two spots, a point light and pillars: baked light and bounces of Cycles by processor time.

    python -m benchmarks.cycles.baked_room [--size 64 48] [--reference 1024] [--density 0.15]

Prints a row for each way: its error, how bright walls, floor and fog are against the reference, and its processor
seconds, bake included. The reference is Cycles with 1024 bounces, in two halves of --reference samples. Pillars are
black, so that they show the fog before them alone. Needs bpy.
"""

import argparse
import math
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from evaluation.error import relative_rmse

from ..support.provenance import made_by
from .baked_surroundings import plane, towards

PROGRAM = "benchmarks.cycles.baked_room"
BOUNCES, USUAL_BOUNCES, SURFACE_BOUNCES = 1024, 12, 12
SAMPLES = (16, 64)
# Half of the room's width and depth, its height, and voxels of the fog along an edge.
HALF, HEIGHT, CELLS = 2.0, 3.0, 40
UP = (0.0, 0.0, 1.0)
EYE, LOOKED_AT = (1.7, -1.7, 1.6), (-0.6, 0.8, 1.1)
REGIONS = {"Wall": "walls", "Floor": "floor", "Pillar": "fog"}


def stage(folder: Path, size: tuple[int, int], density: float):
    """The scene. density: of the fog."""
    import bpy
    from mathutils import Matrix

    from tests.support import blender_scenes as scenes

    scene = scenes.empty_scene()
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.engine = "CYCLES"
    middle = np.array([0.0, 0.0, 0.5 * HEIGHT])
    for name, at, colour in (
        ("Floor", (0.0, 0.0, 0.0), 0.5),
        ("Wall top", (0.0, 0.0, HEIGHT), 0.7),
        ("Wall left", (-HALF, 0.0, 0.5 * HEIGHT), 0.7),
        ("Wall right", (HALF, 0.0, 0.5 * HEIGHT), 0.7),
        ("Wall front", (0.0, -HALF, 0.5 * HEIGHT), 0.7),
        ("Wall back", (0.0, HALF, 0.5 * HEIGHT), 0.7),
    ):
        # The third axis points into the room.
        frame = towards(middle, at) if abs(at[1]) < HALF else towards(middle, at, UP)
        frame[:3, 3] = at
        plane(scene, name, frame, 2.0 * HALF, "ShaderNodeBsdfDiffuse", Color=(colour,) * 3 + (1.0,))
    for number, (x, y) in enumerate(((-0.9, 0.9), (0.6, 1.2))):
        bpy.ops.mesh.primitive_cube_add(size=1.0, location=(x, y, 0.5 * HEIGHT), scale=(0.35, 0.35, HEIGHT))
        pillar = bpy.context.object
        pillar.name = f"Pillar {number}"
        black = bpy.data.materials.new("Black")
        black.use_nodes = True
        black.node_tree.nodes.clear()
        shader = black.node_tree.nodes.new("ShaderNodeBsdfDiffuse")
        shader.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
        output = black.node_tree.nodes.new("ShaderNodeOutputMaterial")
        black.node_tree.links.new(shader.outputs[0], output.inputs["Surface"])
        pillar.data.materials.append(black)
    # The fog ends just before the walls.
    frame = scenes.centred(CELLS, 2.0 * HALF - 0.02)
    fog, _ = scenes.add_volume(
        scene, scenes.write_vdb(folder, np.ones((CELLS,) * 3), frame), "Fog", Density=density, Color=(0.9,) * 3 + (1.0,)
    )
    fog.scale.z, fog.location = HEIGHT / (2.0 * HALF), middle
    for number, (x, y, angle) in enumerate(((-1.2, -0.5, 0.3), (1.0, 0.2, -0.2))):
        lamp = bpy.data.lights.new(f"Spot {number}", "SPOT")
        lamp.energy, lamp.spot_size, lamp.shadow_soft_size = 150.0, math.radians(50.0), 0.05
        shown = scenes.add_object(scene, lamp.name, lamp)
        shown.location, shown.rotation_euler = (x, y, HEIGHT - 0.2), (0.0, angle, 0.0)
    lamp = bpy.data.lights.new("Point", "POINT")
    lamp.energy, lamp.shadow_soft_size = 40.0, 0.1
    scenes.add_object(scene, "Point", lamp).location = (0.3, 0.0, 1.9)
    scenes.add_camera(scene)
    scene.camera.matrix_world = Matrix(towards(EYE, LOOKED_AT, UP).tolist())
    scene.camera.data.angle, scene.camera.data.clip_start = 1.1, 0.01
    return scene


def regions(scene) -> dict[str, np.ndarray]:
    """What each pixel's centre shows: bool (H, W) by name."""
    from tests.support import blender_scenes as scenes

    width, height = scene.render.resolution_x, scene.render.resolution_y
    matrix = np.array(scene.camera.matrix_world)
    edge = 2.0 * math.tan(0.5 * scene.camera.data.angle) / max(width, height)
    found = {name: np.zeros((height, width), bool) for name in REGIONS.values()}
    for row in range(height):
        for column in range(width):
            ray = matrix[:3, :3] @ [(column + 0.5 - width / 2) * edge, (height / 2 - row - 0.5) * edge, -1.0]
            hit, _, _, _, shown, _ = scene.ray_cast(scenes.depsgraph(), matrix[:3, 3].tolist(), ray.tolist())
            name = REGIONS.get(shown.name.split(" ")[0]) if hit else None
            if name:
                found[name][row, column] = True
    return found


def measure(folder: Path, size: tuple[int, int], reference: int, density: float) -> None:
    """Print the table."""
    import bpy

    from tests.support import blender_scenes as scenes

    scene = stage(folder, size, density)
    parts = regions(scene)

    def picture(samples: int, bounces: int, seed: int = 0, **settings: object) -> np.ndarray:
        scenes.set_up_cycles(scene, samples, bounces)
        scene.cycles.max_bounces, scene.cycles.diffuse_bounces = max(bounces, SURFACE_BOUNCES), SURFACE_BOUNCES
        scene.cycles.volume_step_rate, scene.cycles.seed = 1.0, seed
        for name, value in settings.items():
            setattr(scene.cycles, name, value)
        return scenes.rendered(scene, folder, transparent=False)[..., :3].astype(np.float64)

    a, b = (picture(reference, BOUNCES, seed) for seed in (1, 2))
    every = np.ones(a.shape[:2], bool)

    def row(name: str, samples: int, work: Callable[[], np.ndarray], before: float = 0.0) -> None:
        start = time.process_time()
        image = work()
        seconds = before + time.process_time() - start
        shares = [2.0 * image[part].mean() / (a[part] + b[part]).mean() - 1.0 for part in parts.values()]
        figures = " | ".join(f"{100.0 * share:+.1f} %" for share in shares)
        print(
            f"| {name} | {samples} | {relative_rmse(image, a, b, every).value:.3f} | {figures} | {seconds:.1f} |",
            flush=True,
        )

    print(f"| way | samples | error | {' | '.join(parts)} | processor seconds |\n|{'---|' * (len(parts) + 4)}")
    ways = [(f"{bounces} bounces", bounces) for bounces in (USUAL_BOUNCES, BOUNCES)]
    for name, bounces in ways:
        for samples in SAMPLES:
            row(name, samples, lambda samples=samples, bounces=bounces: picture(samples, bounces))
            if bounces == USUAL_BOUNCES:
                settings = {"use_denoising": True}
                row(f"{name}, denoised", samples, lambda samples=samples: picture(samples, USUAL_BOUNCES, **settings))
    start = time.process_time()
    bpy.ops.mrpnn.bake_light(folder=str(folder))
    bake = time.process_time() - start
    print(f"| the bake |{' |' * (len(parts) + 2)} {bake:.1f} |", flush=True)
    for samples in SAMPLES:
        row("baked light", samples, lambda samples=samples: picture(samples, 0), bake)
        row("baked light, denoised", samples, lambda samples=samples: picture(samples, 0, use_denoising=True), bake)

        def fast(samples: int = samples) -> np.ndarray:
            scenes.set_up_cycles(scene, samples, 0)
            scene.cycles.max_bounces = scene.cycles.diffuse_bounces = SURFACE_BOUNCES
            scene.cycles.volume_step_rate = 1.0
            if bpy.ops.mrpnn.bake_light_fast.poll():
                bpy.ops.mrpnn.bake_light_fast()
            return scenes.rendered(scene, folder, transparent=False)[..., :3].astype(np.float64)

        row("baked light, Fast Cycles Settings", samples, fast, bake)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, nargs=2, default=(64, 48))
    parser.add_argument("--reference", type=int, default=1024)
    parser.add_argument("--density", type=float, default=0.15)
    options = parser.parse_args()
    from ..support.extension import extension

    extension()
    with tempfile.TemporaryDirectory() as folder:
        measure(Path(folder), tuple(options.size), options.reference, options.density)
    print(made_by(PROGRAM))


if __name__ == "__main__":
    main()
