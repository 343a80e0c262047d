# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture of docs/use/six-way.md: smoke from a flipbook on planes, lit from another side on each.

    python -m benchmarks.six_way.picture [--out docs/images/six-way.png] [--engine CYCLES]

Made with the extension's own operators in Blender's module: Render Flipbook, Show Flipbook, and the sliders. Cycles
renders the planes, or EEVEE where there is a graphics driver.
"""

import argparse
import tempfile
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from ..support.data import ROOT, volume_file
from ..support.extension import extension

SMOKE = "openvdb_smoke.vdb"
LIT_FROM = ("Right", "Top", "Left", "Back")
# A little light from everywhere else, as of a sky.
SKY = 0.08
SIZE = 320


def _link(scene: bpy.types.Scene, name: str, data: object) -> bpy.types.Object:
    made = bpy.data.objects.new(name, data)
    scene.collection.objects.link(made)
    return made


def _smoke(scene: bpy.types.Scene, folder: Path) -> None:
    """Render the flipbook, of one tile."""
    data = bpy.data.volumes.new("Smoke")
    data.filepath = str(volume_file(SMOKE))
    smoke = _link(scene, "Smoke", data)
    smoke.rotation_euler.x = np.pi / 2.0
    bpy.context.view_layer.update()
    corners = np.array([smoke.matrix_world @ Vector(corner) for corner in smoke.bound_box])
    material = bpy.data.materials.new("Smoke")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeVolumePrincipled")
    shader.inputs["Density"].default_value = 150.0 / np.ptp(corners[:, 2])
    shader.inputs["Color"].default_value = (0.8, 0.8, 0.8, 1.0)
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
    data.materials.append(material)
    wanted = scene.mrpnn_flipbook
    wanted.columns = wanted.rows = 1
    wanted.size, wanted.file_format, wanted.filepath = 512, "EXR", str(folder / "smoke")
    scene.frame_start = scene.frame_end = scene.frame_current
    scene.mrpnn.depth_samples = 8
    assert bpy.ops.mrpnn.flipbook() == {"FINISHED"}
    smoke.hide_render = True


def main(options: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.six_way.picture",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=Path, default=ROOT / "docs" / "images" / "six-way.png")
    parser.add_argument("--engine", default="CYCLES", help="identifier of a render engine")
    arguments = parser.parse_args(options)
    extension()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    lens = bpy.data.cameras.new("Camera")
    scene.camera = _link(scene, "Camera", lens)
    # Looks along +Y.
    scene.camera.rotation_euler.x = np.pi / 2.0
    with tempfile.TemporaryDirectory() as folder:
        _smoke(scene, Path(folder))
        for number, side in enumerate(LIT_FROM):
            scene.cursor.location = (2.0 * number, 0.0, 0.0)
            bpy.ops.mrpnn.flipbook_show()
            nodes = bpy.context.object.material_slots[0].material.node_tree.nodes
            (light,) = [node for node in nodes if node.type == "GROUP"]
            for name in ("Right", "Top", "Back", "Left", "Bottom", "Front"):
                light.inputs[name].default_value = 2.0 if name == side else SKY
        lens.type, lens.ortho_scale = "ORTHO", 2.0 * len(LIT_FROM)
        scene.camera.location = (len(LIT_FROM) - 1.0, -4.0, 0.0)
        scene.world = bpy.data.worlds.new("Sky")
        scene.world.use_nodes = True
        scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.03, 0.05, 0.09, 1.0)
        scene.view_settings.view_transform = "Standard"
        scene.render.engine = arguments.engine
        if arguments.engine == "CYCLES":
            scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.device = 16, False, "CPU"
        scene.render.resolution_x, scene.render.resolution_y = SIZE * len(LIT_FROM), SIZE
        scene.render.image_settings.file_format = "PNG"
        scene.render.filepath = str(arguments.out.resolve())
        bpy.ops.render.render(write_still=True)


if __name__ == "__main__":
    main()
