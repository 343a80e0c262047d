# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes of every kind, placed in every way."""

import math

import bpy
from mathutils import Matrix, Vector

from .stage import DENSITY, aim, cube_mesh, fog, smooth_cube


def plain(stage):
    pass


def mesh_to_volume(stage):
    stage.hide_cloud()
    source = smooth_cube(stage, "Shape")
    source.hide_render = True
    made = stage.link("Made", bpy.data.volumes.new("Made"))
    modifier = made.modifiers.new("Fill", "MESH_TO_VOLUME")
    modifier.object, modifier.resolution_mode, modifier.voxel_size = source, "VOXEL_SIZE", 0.06
    fog(made.data, "Made", 4.0)


def displaced(stage):
    texture = bpy.data.textures.new("Bumps", "CLOUDS")
    texture.noise_scale = 0.5
    modifier = stage.cloud.modifiers.new("Bumps", "VOLUME_DISPLACE")
    modifier.texture, modifier.strength = texture, 0.4


def volume_cube(stage):
    stage.hide_cloud()
    group = bpy.data.node_groups.new("Make", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    cube, material = group.nodes.new("GeometryNodeVolumeCube"), group.nodes.new("GeometryNodeSetMaterial")
    for axis in ("X", "Y", "Z"):
        cube.inputs[f"Resolution {axis}"].default_value = 48
    noise = group.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.5, 2.0
    group.links.new(noise.outputs[0], cube.inputs["Density"])
    holder = bpy.data.volumes.new("Holder")
    fog(holder, "Made", 4.0)
    material.inputs["Material"].default_value = holder.materials[0]
    group.links.new(cube.outputs[0], material.inputs["Geometry"])
    group.links.new(material.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    stage.link("Made", holder).modifiers.new("Make", "NODES").node_group = group


def points_to_volume(stage):
    stage.hide_cloud()
    group = bpy.data.node_groups.new("Make", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    nodes = [
        group.nodes.new(kind)
        for kind in (
            "NodeGroupInput",
            "GeometryNodeMeshToPoints",
            "GeometryNodePointsToVolume",
            "GeometryNodeSetMaterial",
            "NodeGroupOutput",
        )
    ]
    for before, after in zip(nodes[:-1], nodes[1:]):
        group.links.new(before.outputs[0], after.inputs[0])
    points, material = nodes[2:4]
    points.inputs["Radius"].default_value = 0.35
    points.inputs["Density"].default_value = 1.0
    source = smooth_cube(stage, "Made")
    source.modifiers["Round"].levels = source.modifiers["Round"].render_levels = 2
    fog(source.data, "Made", 4.0)
    material.inputs["Material"].default_value = source.data.materials[0]
    source.modifiers.new("Make", "NODES").node_group = group


def mesh_fog(stage):
    stage.hide_cloud()
    fog(smooth_cube(stage, "Ball").data, "Ball", 4.0)


def mesh_noise(stage):
    stage.hide_cloud()
    shown = stage.link("Box", cube_mesh(0.9))
    stage.shader = fog(shown.data, "Box")
    noise, ramp = stage.node("TexNoise"), stage.node("MapRange")
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 2.0, 1.0
    for socket, value in zip(ramp.inputs[1:5], (0.45, 0.75, 0.0, 20.0)):
        socket.default_value = value
    stage.connect(noise.outputs[0], ramp.inputs[0])
    stage.connect(ramp.outputs[0], stage.shader.inputs["Density"])
    stage.step_rate = 0.1


def copied(stage, location):
    other = stage.cloud.copy()
    stage.scene.collection.objects.link(other)
    other.location = location
    return other


def apart(stage):
    stage.cloud.scale = (0.6,) * 3
    stage.cloud.location = (-0.7, 0.0, 0.0)
    copied(stage, (0.7, 0.5, 0.2))


def overlapping(stage):
    stage.cloud.scale = (0.8,) * 3
    stage.cloud.location = (-0.3, 0.0, 0.0)
    copied(stage, (0.3, 0.3, 0.1)).rotation_euler = (1.0, 0.5, 2.0)


def instances(stage):
    stage.cloud.scale = (0.55,) * 3
    stage.scene.collection.objects.unlink(stage.cloud)
    group = bpy.data.collections.new("Group")
    group.objects.link(stage.cloud)
    for number, place in enumerate(((-0.7, 0.0, -0.5), (0.7, 0.0, -0.4), (0.0, 0.3, 0.7))):
        empty = stage.link(f"At {number}", None)
        empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", group, place
        empty.rotation_euler.z = 2.0 * number


def sheared(stage):
    parent = stage.link("Parent", None)
    parent.scale, parent.rotation_euler = (1.4, 0.7, -1.0), (0.3, 0.2, 0.5)
    stage.cloud.parent = parent
    stage.cloud.rotation_euler = (0.4, 0.8, 0.3)
    stage.cloud.scale = (-0.8, 0.8, 0.9)


def object_space(stage):
    stage.cloud.data.render.space = "OBJECT"
    stage.cloud.scale = (1.2, 0.6, 0.9)
    stage.cloud.rotation_euler = (0.4, 0.8, 0.3)


def inside(stage):
    aim(stage.camera, Vector((0.0, -0.35, 0.0)), Vector((0.1, 0.6, 0.1)))
    stage.camera.data.angle = math.radians(80.0)
    stage.camera.data.clip_start = 0.001
    stage.shader.inputs["Density"].default_value = 4.0


def far_away(stage):
    for item in (stage.cloud, stage.camera):
        item.location += Vector((5000.0, -3000.0, 800.0))


def tiny(stage):
    scale = Matrix.Scale(0.001, 4)
    stage.cloud.matrix_world = scale
    stage.camera.location *= 0.001
    stage.camera.data.clip_start = 1e-4
    stage.shader.inputs["Density"].default_value = DENSITY * 1000.0


MEASURED = {
    "Volume object, .vdb file, one sun": plain,
    "Mesh to Volume": mesh_to_volume,
    "Volume Displace": displaced,
    "Geometry nodes: Volume Cube with noise": volume_cube,
    "Geometry nodes: Points to Volume": points_to_volume,
    "Principled Volume in a mesh": mesh_fog,
    "Noise Texture in a mesh": mesh_noise,
    "Two volumes apart": apart,
    "Two volumes that overlap": overlapping,
    "Collection instances": instances,
    "Parent, shear, negative scale": sheared,
    "Object-space density, non-uniform scale": object_space,
    "Camera inside the volume": inside,
    "5 km from the origin": far_away,
    "2 mm large": tiny,
}
