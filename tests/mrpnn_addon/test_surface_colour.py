# SPDX-License-Identifier: GPL-3.0-or-later
"""What of Blender's materials lights volumes: mean reflectance and emission."""

import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes


@pytest.fixture
def mesh(scene, tmp_path):
    path = blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 2.0))
    blender_scenes.add_volume(scene, path, Density=1.0)
    blender_scenes.add_camera(scene)
    blender_scenes.add_sun(scene)
    data = bpy.data.meshes.new("Ground")
    data.from_pydata([(-3, -3, -2), (3, -3, -2), (3, 3, -2), (-3, 3, -2)], [], [(0, 1, 2), (0, 2, 3)])
    return blender_scenes.add_object(scene, "Ground", data)


def material(mesh, kind, **values):
    made = bpy.data.materials.new("Paint")
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    node, output = tree.nodes.new(f"ShaderNode{kind}"), tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(node.outputs[0], output.inputs["Surface"])
    for name, value in values.items():
        node.inputs[name.replace("_", " ")].default_value = value
    mesh.data.materials.append(made)
    return node


def read(addon):
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    (surface,) = described.surfaces
    (warning,) = [text for text in described.warnings if "Ground" in text]
    return surface, warning


def test_no_material_is_grey(addon, mesh):
    surface, warning = read(addon)
    assert surface.reflectance == pytest.approx(0.8) and not surface.emission.any()
    assert "as a matte surface of its mean color; Composite" in warning


def test_diffuse_and_principled_throw_back_their_colour(addon, mesh):
    for kind, name in (("BsdfDiffuse", "Color"), ("BsdfPrincipled", "Base Color")):
        mesh.data.materials.clear()
        node = material(mesh, kind)
        node.inputs[name].default_value = (0.6, 0.4, 0.2, 1.0)
        surface, warning = read(addon)
        assert surface.reflectance == pytest.approx([0.6, 0.4, 0.2]) and "without" not in warning


def test_emission_and_gloss(addon, mesh):
    material(mesh, "Emission", Color=(1.0, 0.5, 0.0, 1.0), Strength=3.0)
    surface, _ = read(addon)
    assert surface.emission == pytest.approx([3.0, 1.5, 0.0]) and not surface.reflectance.any()
    mesh.data.materials.clear()
    material(mesh, "BsdfPrincipled", Metallic=1.0, Emission_Strength=2.0)
    surface, warning = read(addon)
    assert surface.emission == pytest.approx(2.0) and "without gloss" in warning


def test_textures_count_with_their_mean(addon, mesh):
    node = material(mesh, "BsdfDiffuse")
    tree = node.id_data
    image = bpy.data.images.new("Checks", 4, 4, float_buffer=True)
    image.colorspace_settings.name = "Non-Color"
    image.pixels = [value for number in range(16) for value in ((number % 2) * 0.8, 0.2, 0.0, 1.0)]
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image = image
    tree.links.new(texture.outputs["Color"], node.inputs["Color"])
    surface, warning = read(addon)
    assert surface.reflectance == pytest.approx([0.4, 0.2, 0.0], abs=1e-5) and "without textures" in warning
    noise = tree.nodes.new("ShaderNodeTexNoise")
    tree.links.new(noise.outputs["Fac"], node.inputs["Color"])
    surface, warning = read(addon)
    assert surface.reflectance == pytest.approx(0.5, abs=0.05) and "without textures" in warning


def test_several_materials_count_by_their_area(addon, mesh):
    material(mesh, "BsdfDiffuse", Color=(0.9, 0.9, 0.9, 1.0))
    material(mesh, "BsdfDiffuse", Color=(0.1, 0.1, 0.1, 1.0))
    mesh.data.polygons[1].material_index = 1
    assert read(addon)[0].reflectance == pytest.approx(0.5)


def test_surfaces_hidden_from_volume_scattering_light_nothing(addon, mesh):
    mesh.visible_volume_scatter = False
    assert not read(addon)[0].shines
