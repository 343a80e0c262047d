# SPDX-License-Identifier: GPL-3.0-or-later
"""A cloud over water between a mirror and a ball of glass: Cycles with baked light beside Cycles with 1024 bounces.

    python -m benchmarks.cycles.baked_picture [--size 400 320] [--samples 8] [--reference 32] [--out PICTURE]

Makes docs/images/baked-light.png: baked light, then 1024 bounces with the samples for which the same processor seconds,
bake included, suffice; all denoised. With --reference SAMPLES also 1024 bounces with the samples that the same error
takes, up to --most, and captions with errors: in the pixels of the cloud, where no glint on the water outshines it,
against two halves of so many samples each at a step rate of 1, whose noise is told apart from the error. Needs bpy.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from inference import Settings, render
from inference.evaluation.error import relative_bias, relative_rmse

from ..fidelity.views import MASK_ALPHA
from ..support.extension import ROOT, extension
from ..support.provenance import commit, weights_checksum
from .baked_surroundings import plane

PICTURE = ROOT / "docs" / "images" / "baked-light.png"
BOUNCES = 1024
CLOUD_SEED, CLOUD_SIZE = 1_000_011, 2.4
CLOUD, BALL, MIRROR, EYE = (-0.75, 0.0, 1.3), (-0.75, -2.4, 0.4), (1.45, 1.1, 1.05), (0.0, -7.0, 1.1)
SUN_FROM, SUN_COLOUR, FILL_COLOUR = (-0.9, 0.3, 0.3), (1.0, 0.55, 0.26), (0.4, 0.62, 1.0)
# Both renderers are quicker so, and equally right.
STEP_RATE = 4.0
HORIZON, ZENITH = (0.9, 0.5, 0.3, 1.0), (0.03, 0.12, 0.4, 1.0)


def stage(folder: Path, size, cells: int):
    """The scene of the picture: size (width, height) in pixels, and voxels along each edge of the cloud's cube."""
    from mathutils import Vector

    from tests.support import blender_scenes as scenes
    from training.data.volumes import make_volume

    scene = scenes.empty_scene()
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    density = make_volume(CLOUD_SEED, cells).density
    path = scenes.write_vdb(folder, density, scenes.centred(len(density), CLOUD_SIZE))
    cloud, _ = scenes.add_volume(scene, path, Density=80.0, Color=(1.0,) * 4, Anisotropy=0.857)
    cloud.location = CLOUD
    # The sky lights the cloud as a second sun from above: both renderers are quicker so, and equally right.
    scenes.add_sun(scene, "Sky", strength=0.9, colour=FILL_COLOUR, rotation=(0.0, 0.0, 0.0))
    scene.world.cycles_visibility.scatter = False
    lamp = scenes.add_sun(scene, strength=7.0, colour=SUN_COLOUR)
    lamp.rotation_euler = Vector(SUN_FROM).to_track_quat("Z", "Y").to_euler()
    lamp.data.angle = 0.01
    sky(scene.world.node_tree)
    water(scene)
    mirror(scene)
    ball(scene)
    camera = scenes.add_camera(scene, EYE)
    camera.rotation_euler = (Vector(EYE) - Vector((0.0, 0.0, 1.0))).to_track_quat("Z", "Y").to_euler()
    camera.data.angle = 0.62
    return scene


def sky(tree) -> None:
    """From an evening's horizon to a blue zenith."""
    place, split, ramp = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "SeparateXYZ", "ValToRGB"))
    (low, high), background = ramp.color_ramp.elements, tree.nodes["Background"]
    low.color, high.color, high.position = HORIZON, ZENITH, 0.16
    tree.links.new(place.outputs["Generated"], split.inputs[0])
    tree.links.new(split.outputs["Z"], ramp.inputs[0])
    tree.links.new(ramp.outputs[0], background.inputs["Color"])
    background.inputs["Strength"].default_value = 0.6


def water(scene) -> None:
    """A wide dark plane with gentle waves."""
    surface = plane(scene, "Water", np.eye(4), 80.0, "ShaderNodeBsdfPrincipled", Roughness=0.04, IOR=1.33)
    tree = surface.data.materials[0].node_tree
    shader = next(node for node in tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value = 0.01, 0.03, 0.045, 1.0
    place, waves, bump = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "TexNoise", "Bump"))
    waves.inputs["Scale"].default_value = 3.5
    bump.inputs["Strength"].default_value, bump.inputs["Distance"].default_value = 0.35, 0.08
    tree.links.new(place.outputs["Object"], waves.inputs["Vector"])
    tree.links.new(waves.outputs[0], bump.inputs["Height"])
    tree.links.new(bump.outputs[0], shader.inputs["Normal"])


def mirror(scene) -> None:
    """A standing mirror in which the camera sees the far side of the cloud, in a wooden frame."""
    at = np.array(MIRROR)
    normal = sum((np.array(end) - at) / np.linalg.norm(np.array(end) - at) for end in (CLOUD, EYE)) * [1.0, 1.0, 0.0]
    frame = np.eye(4)
    z = normal / np.linalg.norm(normal)
    frame[:3, :3], frame[:3, 3] = np.stack([np.cross([0.0, 0.0, 1.0], z), [0.0, 0.0, 1.0], z], axis=1), at
    plane(scene, "Mirror", frame, 1.6, "ShaderNodeBsdfGlossy", Roughness=0.0, Color=(0.92, 0.92, 0.92, 1.0))
    frame[:3, 3] -= 0.03 * z
    plane(scene, "Frame", frame, 1.8, "ShaderNodeBsdfDiffuse", Color=(0.3, 0.16, 0.06, 1.0))


def ball(scene) -> None:
    """A ball of glass."""
    import bpy

    bpy.ops.mesh.primitive_uv_sphere_add(segments=96, ring_count=48, radius=0.4, location=BALL)
    bpy.ops.object.shade_smooth()
    material = bpy.data.materials.new("Glass")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    glass = tree.nodes.new("ShaderNodeBsdfGlass")
    glass.inputs["IOR"].default_value = 1.45
    tree.links.new(glass.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    bpy.context.object.data.materials.append(material)


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, nargs=2, default=(400, 320))
    parser.add_argument("--cells", type=int, default=128)
    parser.add_argument("--samples", type=int, default=8)
    parser.add_argument("--reference", type=int, default=0)
    parser.add_argument("--most", type=int, default=64)
    parser.add_argument("--out", type=Path, default=PICTURE)
    options = parser.parse_args()
    extension()
    import bpy
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    from tests.support import blender_scenes as scenes

    from ..support import pictures

    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        scene = stage(folder, options.size, options.cells)

        def show(samples: int, bounces: int, reference: bool = False, seed: int = 0) -> tuple[np.ndarray, float]:
            """An image (H, W, 3) and its processor seconds."""
            scenes.set_up_cycles(scene, samples, bounces)
            settings = scene.cycles
            settings.max_bounces, settings.use_denoising, settings.seed = max(bounces, 12), not reference, seed
            settings.volume_step_rate = 1.0 if reference else STEP_RATE
            settings.caustics_reflective = settings.caustics_refractive = False
            start = time.process_time()
            image = scenes.rendered(scene, folder, transparent=False)[..., :3].astype(np.float64)
            return image, time.process_time() - start

        print(f"weights {weights_checksum('mrpnn')}, {commit()}, {vars(options)}", flush=True)
        start = time.process_time()
        bpy.ops.mrpnn.bake_light(folder=str(folder))
        bake = time.process_time() - start
        baked, seconds = show(options.samples, 0)
        print(f"bake {bake:.1f} s, {options.samples} samples {seconds:.1f} s", flush=True)
        budget = bake + seconds
        panels = [[f"baked light, {options.samples} samples: {budget:.1f} s", baked]]
        bpy.ops.mrpnn.bake_light_remove()
        samples, spent = 1, 0.0
        while spent < 0.7 * budget:
            # The first rendering says how long one sample takes.
            samples = round(samples * budget / spent) if spent else samples
            image, spent = show(samples, BOUNCES)
        print(f"{BOUNCES} bounces, {samples} samples: {spent:.1f} s", flush=True)
        panels.append([f"{BOUNCES} bounces, {samples} samples: {spent:.1f} s", image])
        if options.reference:
            found = read_scene(scenes.depsgraph())
            cloud = render(found.volumes, found.lights, found.camera, Settings(multiple=False), surfaces=found.surfaces)
            shown = cloud.alpha > MASK_ALPHA
            halves = [show(options.reference, BOUNCES, True, seed)[0] for seed in (1, 2)]

            def error(panel: list) -> float:
                """Of a panel, whose caption tells it from now on."""
                found = relative_rmse(panel[1], *halves, shown).value
                panel[0] += f", error {found:.3f}"
                print(f"{panel[0]}, bias {relative_bias(panel[1], *halves, shown).value:+.3f}", flush=True)
                return found

            least, now = map(error, panels)
            while now > least and 2 * samples <= options.most:
                samples *= 2
                image, spent = show(samples, BOUNCES)
                last = [f"{BOUNCES} bounces, {samples} samples: {spent:.0f} s", image]
                now = error(last)
            if image is not panels[-1][1]:
                panels.append(last)
        drawn = [(caption, pictures.view_transformed(image, scene)) for caption, image in panels]
        pictures.row(drawn, options.size[1]).save(options.out, optimize=True)


if __name__ == "__main__":
    main()
