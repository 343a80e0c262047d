# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light in a mirror, through glass, on a floor and over bright ground, against Cycles with many volume bounces.

    python -m benchmarks.cycles.baked_surroundings [--size 64] [--samples 1024] [--density 15] [--anisotropy 0.7]
        [--scenes mirror glass floor ground]

Prints the relative error and bias of Cycles with baked light at 64 samples; the reference is the mean of two halves.
Needs bpy.
"""

import argparse
import tempfile
from pathlib import Path

import numpy as np

from evaluation.error import relative_bias, relative_rmse

from ..support.provenance import made_by

PROGRAM = "benchmarks.cycles.baked_surroundings"
BOUNCES, SAMPLES = 256, 64
# Radiance, over the mean, from which a pixel counts as showing something.
DARK = 0.02


def plane(scene, name, matrix, size, shader, **values):
    """A square around the origin of a frame, perpendicular to its third axis."""
    import bpy
    from mathutils import Matrix

    from tests.support import blender_scenes as scenes

    mesh = bpy.data.meshes.new(name)
    half = 0.5 * size
    mesh.from_pydata([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)], [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    node = nodes.new(shader)
    for socket, value in values.items():
        node.inputs[socket].default_value = value
    material.node_tree.links.new(node.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    mesh.materials.append(material)
    added = scenes.add_object(scene, name, mesh)
    added.matrix_world = Matrix(matrix.tolist())
    return added


def stage(folder: Path, options):
    from tests.support import blender_scenes as scenes

    scene = scenes.empty_scene()
    scene.render.resolution_x = scene.render.resolution_y = options.size
    path = scenes.write_vdb(folder, scenes.blob(48), scenes.centred(48, 2.0))
    scenes.add_volume(scene, path, Density=options.density, Color=(1.0,) * 4, Anisotropy=options.anisotropy)
    scenes.add_sun(scene, strength=3.0, rotation=(0.5, 0.3, 0.2)).data.angle = 0.0
    scenes.add_camera(scene, (0.0, 0.0, 6.0)).data.angle = 0.5
    return scene


def towards(position, target, up=(0.0, 1.0, 0.0)) -> np.ndarray:
    """Frame at a position whose third axis points away from a target, and whose second one upwards."""
    z = np.subtract(position, target) / np.linalg.norm(np.subtract(position, target))
    x = np.cross(up, z)
    x /= np.linalg.norm(x)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.stack([x, np.cross(z, x), z], axis=1), position
    return matrix


def mirror(scene):
    """The camera sees the cloud in a mirror only, from beside."""
    from mathutils import Matrix

    # From the origin to the mirror and to the camera: mirrored rays meet in the middle.
    at, eye = np.array([5.0, 0.0, 0.0]), np.array([2.5, 0.0, 5.0])
    normal = -at / 5.0 + (eye - at) / np.linalg.norm(eye - at)
    frame = towards(at, at - normal)
    plane(scene, "Mirror", frame, 4.0, "ShaderNodeBsdfGlossy", Roughness=0.0, Color=(1.0,) * 4)
    scene.camera.matrix_world = Matrix(towards(eye, at).tolist())
    scene.camera.data.angle = 0.35


def glass(scene):
    """A pane of glass between camera and cloud, out of the sun's way: two surfaces."""
    for z in (4.5, 4.6):
        frame = np.eye(4)
        frame[2, 3] = z
        if z == 4.5:
            frame[:3, :3] = np.diag([1.0, -1.0, -1.0])
        plane(scene, "Pane", frame, 1.2, "ShaderNodeBsdfRefraction", IOR=1.45, Roughness=0.0, Color=(1.0,) * 4)


def floor(scene):
    """The camera sees the floor below the cloud, and not the cloud."""
    from mathutils import Matrix

    frame = np.eye(4)
    frame[2, 3] = -1.3
    plane(scene, "Floor", frame, 12.0, "ShaderNodeBsdfDiffuse", Color=(1.0,) * 4)
    frame[2, 3] = -1.1
    scene.camera.matrix_world = Matrix(frame.tolist())
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 4.0
    scene.camera.data.clip_start = 0.01


def ground(scene):
    """The camera sees the cloud over bright ground, which throws light back into it, from slightly above."""
    from mathutils import Matrix

    frame = np.eye(4)
    frame[2, 3] = -1.3
    plane(scene, "Ground", frame, 12.0, "ShaderNodeBsdfDiffuse", Color=(0.8, 0.8, 0.8, 1.0))
    turned = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turned @ towards([0.0, 1.5, 6.0], [0.0, 0.0, 0.0])[:3, :3], [0.0, -6.0, 1.5]
    scene.camera.matrix_world = Matrix(matrix.tolist())


def measure(build, options, folder: Path) -> str:
    import bpy

    from tests.support import blender_scenes as scenes

    scene = stage(folder, options)
    if build is ground:
        build(scene)
    # Baked from where the camera looks at the cloud itself.
    bpy.ops.mrpnn.bake_light(folder=str(folder))
    [light] = [shown for shown in bpy.data.objects if "mrpnn_light" in shown]
    if build is not ground:
        build(scene)

    def picture(samples, bounces, seed):
        scenes.set_up_cycles(scene, samples, bounces)
        scene.cycles.max_bounces = max(bounces, 12)
        scene.cycles.caustics_refractive = scene.cycles.caustics_reflective = False
        scene.cycles.volume_step_rate, scene.cycles.seed = 1.0, seed
        light.hide_render = bounces > 0
        return scenes.rendered(scene, folder, transparent=False)[..., :3].astype(np.float64)

    baked = picture(SAMPLES, 0, 3)
    a, b = (picture(options.samples // 2, BOUNCES, seed) for seed in (1, 2))
    mean = (a + b).mean(axis=-1) / 2
    shown = mean > DARK * mean.mean()
    rmse, bias = relative_rmse(baked, a, b, shown), relative_bias(baked, a, b, shown)
    error = f"{rmse.value:.3f} ({rmse.low:.3f} to {rmse.high:.3f})"
    return f"| {SCENES[build]} | {error} | {100 * bias.value:+.1f} % |"


#: Surroundings, and how the table calls them.
SCENES = {
    mirror: "in a mirror",
    glass: "through a pane of glass",
    floor: "light and shadow on a white floor",
    ground: "over bright ground (albedo 0.8)",
}


def main() -> None:
    parser = argparse.ArgumentParser()
    for name, kind, usual in (
        ("size", int, 64),
        ("samples", int, 1024),
        ("density", float, 15.0),
        ("anisotropy", float, 0.7),
    ):
        parser.add_argument(f"--{name}", type=kind, default=usual)
    parser.add_argument("--scenes", nargs="+", default=["mirror", "glass", "floor", "ground"])
    options = parser.parse_args()
    from ..support.extension import extension

    extension()
    print("| | error | bias |\n|---|---|---|")
    for build in SCENES:
        if build.__name__ not in options.scenes:
            continue
        with tempfile.TemporaryDirectory() as folder:
            print(measure(build, options, Path(folder)), flush=True)
    print(made_by(PROGRAM))


if __name__ == "__main__":
    main()
