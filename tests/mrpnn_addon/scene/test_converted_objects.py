# SPDX-License-Identifier: GPL-3.0-or-later
"""Texts, curves, surfaces, metaballs and what geometry nodes make, which Blender lists twice or under other types."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes

BLACK = (0.0, 0.0, 0.0, 1.0)


def add_text(scene):
    data = bpy.data.curves.new("Shape", "FONT")
    data.body, data.size, data.extrude, data.align_x, data.align_y = "O", 3.0, 0.4, "CENTER", "CENTER"
    data.offset = 0.1
    return blender_scenes.add_object(scene, "Shape", data)


def add_solid_text(scene):
    shown = add_text(scene)
    shown.modifiers.new("Array", "ARRAY").relative_offset_displace = (0.0, 0.0, 1.5)
    return shown


def add_curve(scene):
    data = bpy.data.curves.new("Shape", "CURVE")
    data.dimensions, data.extrude, data.fill_mode = "2D", 0.4, "BOTH"
    spline = data.splines.new("POLY")
    spline.points.add(3)
    for point, place in zip(spline.points, [(-1, -1), (1, -1), (1, 1), (-1, 1)]):
        point.co = (*place, 0.0, 1.0)
    spline.use_cyclic_u = True
    return blender_scenes.add_object(scene, "Shape", data)


def add_surface(scene):
    bpy.ops.surface.primitive_nurbs_surface_torus_add()
    return bpy.context.object


def add_metaballs(scene):
    """A family, whose first member alone has a mesh."""
    for place in (-0.6, 0.6):
        bpy.ops.object.metaball_add(radius=1.0, location=(0.0, place, 0.0))
        bpy.context.object.data.render_resolution = 0.1
    return scene.objects["Mball"]


def add_instances(scene):
    """Two collection instances of a text."""
    shown, collection = add_text(scene), bpy.data.collections.new("Texts")
    scene.collection.objects.unlink(shown)
    collection.objects.link(shown)
    for place in (-0.8, 0.8):
        holder = blender_scenes.add_object(scene, "Holder", None)
        holder.instance_type, holder.instance_collection = "COLLECTION", collection
        holder.location, holder.scale = (0.0, place, 0.0), (0.5, 0.5, 0.5)
    return shown


def add_cube_of_nodes(scene):
    """A text that geometry nodes replace by a cube, whose material they set: the cube's first slot is empty."""
    return replaced(add_text(scene))


def add_replaced_mesh(scene):
    """A mesh that geometry nodes replace by a larger one."""
    bpy.ops.mesh.primitive_cube_add(size=0.5, location=(0.0, 0.25, 0.0))
    return replaced(bpy.context.object)


def add_modified_mesh(scene):
    """A mesh that modifiers make larger."""
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(0.0, -1.0, 0.0))
    bpy.context.object.modifiers.new("Array", "ARRAY").relative_offset_displace = (0.0, 1.5, 0.0)
    return bpy.context.object


def replaced(shown):
    """An object whose geometry nodes put a cube of edge 1 in its place."""
    tree = bpy.data.node_groups.new("Cube", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    cube, painted = tree.nodes.new("GeometryNodeMeshCube"), tree.nodes.new("GeometryNodeSetMaterial")
    tree.links.new(cube.outputs[0], painted.inputs["Geometry"])
    tree.links.new(painted.outputs[0], tree.nodes.new("NodeGroupOutput").inputs[0])
    shown.modifiers.new("Nodes", "NODES").node_group = tree
    return shown


def give(shown, material):
    """Let an object, or the nodes that replace it, show a material instead of its own."""
    shown.data.materials.clear()
    for modifier in shown.modifiers:
        if modifier.type == "NODES":
            modifier.node_group.nodes["Set Material"].inputs["Material"].default_value = material
            return
    shown.data.materials.append(material)


def both(scene, folder, bounces=0):
    """The picture here and in Cycles, each float32 (H, W, 4)."""
    scene.render.engine = "MRPNN"
    ours = blender_scenes.rendered(scene, folder)
    return ours, blender_scenes.render_cycles(scene, folder, samples=64, bounces=bounces)


GENERATED = (add_text, add_surface, add_metaballs, add_cube_of_nodes, add_replaced_mesh, add_modified_mesh)
KINDS = (add_text, add_solid_text, add_curve, add_surface, add_metaballs, add_instances, add_cube_of_nodes)


@pytest.mark.parametrize("add", KINDS)
def test_fog_is_as_dense_as_in_cycles(addon, scene, tmp_path, add):
    shown = add(scene)
    blender_scenes.add_fog(shown.data, "Shape", "ShaderNodeVolumePrincipled", Density=1.0, Color=BLACK)
    give(shown, shown.data.materials[0])
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene, ortho_scale=4.0)
    scene.render.resolution_x = scene.render.resolution_y = 16
    ours, expected = both(scene, tmp_path)
    assert expected[..., 3].mean() > 0.02
    assert ours[..., 3].mean() == pytest.approx(expected[..., 3].mean(), rel=0.1)


@pytest.mark.parametrize("add", GENERATED)
def test_generated_coordinates_are_those_of_cycles(addon, scene, tmp_path, add):
    """Density rises along the second of them; metaballs lie around another place than their first one."""
    shown = add(scene)
    tree = blender_scenes.add_fog(shown.data, "Shape", "ShaderNodeVolumePrincipled", Color=BLACK).id_data
    where, axes = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeSeparateXYZ")
    tree.links.new(where.outputs["Generated"], axes.inputs[0])
    tree.links.new(axes.outputs["Y"], tree.nodes["Principled Volume"].inputs["Density"])
    give(shown, shown.data.materials[0])
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene, ortho_scale=4.0)
    scene.render.resolution_x = scene.render.resolution_y = 16
    ours, expected = both(scene, tmp_path)
    assert expected[..., 3].mean() > 0.01
    for half in (slice(8), slice(8, 16)):
        assert ours[half, :, 3].mean() == pytest.approx(expected[half, :, 3].mean(), rel=0.12, abs=0.002)


@pytest.mark.slow
@pytest.mark.parametrize("add", [add_text, add_curve, add_metaballs])
def test_fog_is_lit_as_brightly_as_in_cycles(addon, scene, tmp_path, add):
    """By a glowing object outside the view; letters hide each other."""
    shown = add(scene)
    if shown.type == "FONT":
        shown.data.body, shown.data.size, shown.data.extrude = "Glow", 1.2, 0.1
    for one in scene.objects:
        one.location.x = 4.0
    material = bpy.data.materials.new("Glow")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    glow = tree.nodes.new("ShaderNodeEmission")
    glow.inputs["Strength"].default_value = 50.0
    tree.links.new(glow.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    give(shown, material)
    blender_scenes.add_volume(
        scene,
        blender_scenes.write_vdb(tmp_path, np.ones((8, 8, 8)), blender_scenes.centred(8, 2.0)),
        Density=0.1,
        Color=(1.0, 1.0, 1.0, 1.0),
    )
    blender_scenes.add_camera(scene, ortho_scale=3.0)
    scene.render.resolution_x = scene.render.resolution_y = 8
    ours, expected = both(scene, tmp_path, bounces=4)
    assert expected[..., :3].mean() > 0.01
    # The mean colour of what glows is followed, not each of its faces; listed twice, it would be twice as bright.
    assert ours[..., :3].mean() == pytest.approx(expected[..., :3].mean(), rel=0.25)


def test_texts_that_share_their_letters_keep_their_modifiers(addon, scene, tmp_path):
    """As surfaces, whose meshes are read once for all instances of the same data."""
    blender_scenes.cloud_scene(scene, tmp_path)
    first = add_text(scene)
    second = blender_scenes.add_object(scene, "Second", first.data)
    second.modifiers.new("Array", "ARRAY")
    found = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    sizes = {mesh.name: len(mesh.mesh.corners) for mesh in found.opaque}
    assert sizes['text object "Second"'] == 2 * sizes['text object "Shape"']


def test_hair_with_a_volume_material_is_named(addon, scene, tmp_path):
    """Cycles shows nothing of it."""
    blender_scenes.cloud_scene(scene, tmp_path)
    data = bpy.data.hair_curves.new("Hair")
    blender_scenes.add_object(scene, "Hair", data)
    blender_scenes.add_fog(data, "Hair", "ShaderNodeVolumePrincipled")
    found = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    assert [volume.name for volume, _ in found.volumes] == ["Cloud"]
    assert any('"Hair" has a volume material, which Cycles renders in meshes only' in text for text in found.warnings)
