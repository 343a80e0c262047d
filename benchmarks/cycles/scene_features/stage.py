# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene that every feature starts from, and objects that several of them build."""

import math
from dataclasses import dataclass, field
from pathlib import Path

import bpy
from mathutils import Vector

from ...support.shaders import add_shader

SEED = 1_000_003
CELLS = 64
# Of the cloud, edge 2, at its densest.
DENSITY = 12.0


@dataclass
class Stage:
    """The scene that every feature starts from: a cloud of edge 2 around the origin, a sun, a camera.

    scene, cloud, shader, sun, camera: of bpy. folder: for files. step_rate: of Cycles' reference.
    surfaces: objects that the reference holds out.
    """

    scene: object
    cloud: object
    shader: object
    sun: object
    camera: object
    folder: Path
    step_rate: float = 1.0
    surfaces: list = field(default_factory=list)

    def link(self, name, data):
        added = bpy.data.objects.new(name, data)
        self.scene.collection.objects.link(added)
        return added

    def hide_cloud(self):
        bpy.data.objects.remove(self.cloud)

    def node(self, kind, **settings):
        added = self.shader.id_data.nodes.new(f"ShaderNode{kind}")
        for name, value in settings.items():
            setattr(added, name, value)
        return added

    def connect(self, output, socket):
        self.shader.id_data.links.new(output, socket)

    def grid(self):
        return self.node("VolumeInfo").outputs["Density"]

    def replace_shader(self, shader):
        self.connect(shader.outputs[0], self.shader.id_data.get_output_node("CYCLES").inputs["Volume"])


def make_stage(folder: Path, cloud_file: Path, size: int) -> Stage:
    """A fresh file with the cloud of `cloud_file`, `size` pixels square, on a black World."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.view_settings.view_transform = "AgX"
    data = bpy.data.volumes.new("Cloud")
    data.filepath = str(cloud_file)
    data.render.space = "WORLD"
    shader = fog(data, "Cloud")
    cloud = bpy.data.objects.new("Cloud", data)
    lamp = bpy.data.lights.new("Sun", "SUN")
    lamp.energy, lamp.angle = 8.0, 0.0
    sun = bpy.data.objects.new("Sun", lamp)
    sun.rotation_euler = Vector((-0.8, -0.3, 0.6)).to_track_quat("Z", "Y").to_euler()
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.angle = math.radians(34.0)
    for item in (cloud, sun, camera):
        scene.collection.objects.link(item)
    scene.camera = camera
    aim(camera, Vector((1.6, -4.2, 1.0)))
    return Stage(scene, cloud, shader, sun, camera, folder)


def aim(camera, location, at=(0.0, 0.0, 0.0)):
    """Put a camera somewhere, looking at a point."""
    camera.location = location
    camera.rotation_euler = (location - Vector(at)).to_track_quat("Z", "Y").to_euler()


def fog(data, name, density=DENSITY):
    """Principled Volume on new data; gives the node."""
    shader = add_shader(data, f"{name} fog", "VolumePrincipled")
    shader.inputs["Density"].default_value = density
    shader.inputs["Color"].default_value = (0.9, 0.9, 0.9, 1.0)
    shader.inputs["Anisotropy"].default_value = 0.4
    return shader


def cube_mesh(size=1.0):
    mesh = bpy.data.meshes.new("Cube")
    corners = [(size * x, size * y, size * z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    mesh.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    return mesh


def smooth_cube(stage, name):
    """A rounded cube object."""
    shown = stage.link(name, cube_mesh())
    shown.modifiers.new("Round", "SUBSURF").render_levels = 3
    shown.modifiers["Round"].levels = 3
    return shown
