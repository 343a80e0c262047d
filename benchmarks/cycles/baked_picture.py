# SPDX-License-Identifier: GPL-3.0-or-later
"""A cloud over water between a mirror and a ball of glass: Cycles with baked light beside Cycles with 1024 bounces.

    python -m benchmarks.cycles.baked_picture [--size 480 360] [--samples 4] [--reference 2048] [--most 128]

Makes docs/images/baked-light.png: baked light, then 1024 bounces with the samples for which the same processor seconds,
bake included, suffice, and with those that the same error takes, up to --most; all denoised. Errors are those of the
means of 4 x 4 pixels, where the camera sees the cloud itself and no glint on the water outshines it. Their reference is
Cycles with 1024 bounces at a quarter of the size, whose pixels are these means: two halves of --reference samples each,
neither denoised, whose noise is told apart from the error. What has nothing to do with the network takes long and is
kept in build/: reference and images with bounces. Delete them there after a change to the scene. Needs bpy.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from evaluation.error import relative_bias, relative_rmse
from inference import Settings, render

from ..fidelity.views import MASK_ALPHA
from ..support.extension import ROOT, extension
from ..support.provenance import commit, weights_checksum
from .baked_surroundings import plane

PICTURE = ROOT / "docs" / "images" / "baked-light.png"
BOUNCES = 1024
CLOUD_SEED, CLOUD_SIZE = 1_000_011, 2.4
CLOUD, BALL, MIRROR, EYE = (-0.75, 0.0, 1.3), (-0.75, -2.4, 0.4), (1.45, 1.1, 1.05), (0.0, -7.0, 1.1)
SUN_FROM, SUN_COLOUR, FILL_COLOUR = (-0.9, 0.3, 0.3), (1.0, 0.55, 0.26), (0.4, 0.62, 1.0)
# Of volumes: longer steps are quicker with baked light and as right; with bounces they are 11 % too bright here.
STEP_RATE, BOUNCES_STEP_RATE = 4.0, 1.0
SURFACE_BOUNCES = 12
LAST = f"Cycles, {BOUNCES} bounces, the {{}}"
# Edge of the squares of pixels whose means are compared, in pixels; height of the captions' text.
COARSE, TEXT = 4, 20
HORIZON, ZENITH = (0.9, 0.5, 0.3, 1.0), (0.03, 0.12, 0.4, 1.0)


def stage(folder: Path, size, cells: int):
    """The scene of the picture: size (width, height) in pixels, and voxels along each edge of the cloud's cube."""
    from mathutils import Vector

    from tests.support import blender_scenes as scenes
    from training.procedural.volumes import make_volume

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


def shown(scene, folder: Path, samples: int, bounces: int, **settings) -> tuple[np.ndarray, float]:
    """An image (H, W, 3) and its processor seconds; settings: of Cycles, other than the picture's."""
    from tests.support import blender_scenes as scenes

    scenes.set_up_cycles(scene, samples, bounces)
    usual = {"use_denoising": True, "volume_step_rate": BOUNCES_STEP_RATE if bounces else STEP_RATE}
    usual |= {"max_bounces": max(bounces, SURFACE_BOUNCES), "caustics_reflective": False, "caustics_refractive": False}
    for name, value in {**usual, **settings}.items():
        setattr(scene.cycles, name, value)
    start = time.process_time()
    image = scenes.rendered(scene, folder, transparent=False)[..., :3].astype(np.float64)
    return image, time.process_time() - start


def truth(scene, folder: Path, samples: int, kept: Path) -> tuple[np.ndarray, np.ndarray]:
    """Two halves (2, H, W, 3) of the reference, each of so many samples per pixel, and its pixels of the cloud (H, W).

    Not denoised, COARSE times smaller than the picture along each edge, and black beside the cloud. kept: a file that
    holds the halves, or will.
    """
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    from tests.support import blender_scenes as scenes

    picture = scene.render
    size = picture.resolution_x, picture.resolution_y
    picture.resolution_x, picture.resolution_y = (edge // COARSE for edge in size)
    found = read_scene(scenes.depsgraph())
    layer = render(found.volumes, found.lights, found.camera, Settings(multiple=False), surfaces=found.surfaces)
    cloud = layer.alpha > MASK_ALPHA
    if not kept.exists():
        height, width = cloud.shape
        rows, columns = (np.flatnonzero(cloud.any(axis=axis)) for axis in (1, 0))
        picture.border_min_x, picture.border_max_x = columns[0] / width, (columns[-1] + 1) / width
        picture.border_min_y, picture.border_max_y = 1.0 - (rows[-1] + 1) / height, 1.0 - rows[0] / height
        picture.use_border = True
        halves = [shown(scene, folder, samples, BOUNCES, seed=seed, use_denoising=False) for seed in (1, 2)]
        picture.use_border, scene.cycles.seed = False, 0
        print(f"reference, {samples} samples each: {sum(seconds for _, seconds in halves):.0f} s", flush=True)
        kept.parent.mkdir(exist_ok=True)
        np.save(kept, np.array([half for half, _ in halves], np.float32))
    picture.resolution_x, picture.resolution_y = size
    return np.load(kept), cloud


def coarse(image: np.ndarray) -> np.ndarray:
    """The means of COARSE^2 pixels each."""
    height, width = (edge // COARSE for edge in image.shape[:2])
    return image.reshape(height, COARSE, width, COARSE, 3).mean(axis=(1, 3))


def same_error(measure, least: float, samples: int, most: int):
    """What `measure` gives with the samples that the error `least` takes, within a factor of sqrt(2), or with `most`.

    measure: of samples; gives the error first. It stays larger than `least` where `most` samples are too few.
    """
    found = measure(samples)
    while found[0] > least and samples < most:
        samples *= 2
        found = measure(samples)
    if found[0] > least:
        return found
    between = measure(round(samples / 2**0.5))
    return between if between[0] <= least else found


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--size", type=int, nargs=2, default=(480, 360))
    parser.add_argument("--cells", type=int, default=128)
    parser.add_argument("--samples", type=int, default=4)
    parser.add_argument("--reference", type=int, default=2048)
    parser.add_argument("--most", type=int, default=128)
    parser.add_argument("--out", type=Path, default=PICTURE)
    options = parser.parse_args()
    extension()
    import bpy

    from ..support import pictures

    print(f"weights {weights_checksum('mrpnn')}, {commit()}, {vars(options)}", flush=True)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        scene = stage(folder, options.size, options.cells)
        sizes = "x".join(map(str, (*options.size, options.cells, options.reference)))
        kept = ROOT / "build" / f"baked-picture-{sizes}.npy"
        halves, cloud = truth(scene, folder, options.reference, kept)

        def bounced(samples: int) -> tuple[np.ndarray, float]:
            """An image with bounces and its processor seconds: kept, since both have nothing to do with the network."""
            file = kept.with_name(f"{kept.stem}-bounces-{samples}.npz")
            if not file.exists():
                image, seconds = shown(scene, folder, samples, BOUNCES)
                np.savez(file, image=image.astype(np.float32), seconds=seconds)
            with np.load(file) as found:
                return found["image"].astype(np.float64), float(found["seconds"])

        def measure(what: str, samples: int, image: np.ndarray, seconds: float) -> tuple[float, str, np.ndarray, float]:
            """Error, caption, image and processor seconds."""
            error, bias = (of(coarse(image), *halves, cloud) for of in (relative_rmse, relative_bias))
            figures = f"{samples} samples, {seconds:.0f} processor seconds, error {error.value:.3f}"
            print(f"{what}: {figures} [{error.low:.3f}, {error.high:.3f}], bias {bias.value:+.3f}", flush=True)
            return error.value, f"{what}\n{figures}", image, seconds

        start = time.process_time()
        bpy.ops.mrpnn.bake_light(folder=str(folder))
        bake = time.process_time() - start
        print(f"bake: {bake:.1f} s", flush=True)
        image, seconds = shown(scene, folder, options.samples, 0)
        panels = [measure("Cycles with baked light, bake included", options.samples, image, bake + seconds)]
        error, *_, budget = panels[0]
        bpy.ops.mrpnn.bake_light_remove()
        # Samples cost alike, but for what one image costs.
        one, four = bounced(1)[1], bounced(4)[1]
        samples = max(round(1 + 3 * (budget - one) / (four - one)), 1)
        panels.append(measure(f"Cycles, {BOUNCES} bounces, the same seconds", samples, *bounced(samples)))
        last = same_error(lambda n: measure(LAST.format("same error"), n, *bounced(n)), error, 16, options.most)
        if last[0] > error:
            # Its caption says how much longer it took.
            caption = last[1].replace(LAST.format("same error"), LAST.format(f"seconds times {last[-1] / budget:.1f}"))
            last = last[0], caption, *last[2:]
        panels.append(last)
        drawn = [(caption, pictures.view_transformed(image, scene)) for _, caption, image, _ in panels]
        pictures.row(drawn, options.size[1], TEXT).save(options.out, optimize=True)


if __name__ == "__main__":
    main()
