# SPDX-License-Identifier: GPL-3.0-or-later
"""Which way of showing volumes is recommended for what a scene holds."""

import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes


@pytest.fixture
def way(scene, tmp_path):
    from mrpnn.mrpnn_addon.status.recommendation import recommend

    blender_scenes.cloud_scene(scene, tmp_path, density=20.0)
    return lambda: recommend(blender_scenes.depsgraph())


def plane(scene, shader=None, **values):
    mesh = bpy.data.meshes.new("Plane")
    mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    if shader is not None:
        material = bpy.data.materials.new("Surface")
        material.use_nodes = True
        nodes = material.node_tree.nodes
        nodes.clear()
        node = nodes.new(shader)
        for name, value in values.items():
            node.inputs[name.replace("_", " ")].default_value = value
        material.node_tree.links.new(node.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
        mesh.materials.append(material)
    blender_scenes.add_object(scene, "Plane", mesh)


def test_volumes_alone_need_the_layer(way):
    assert way().way == "layer"


def test_surfaces_need_a_composite(way, scene):
    plane(scene, "ShaderNodeBsdfPrincipled")
    plane(scene)
    assert way().way == "composite"


def test_a_composite_is_not_recommended_where_there_is_one(way, scene):
    plane(scene)
    assert "does not render" in way().reason
    bpy.ops.mrpnn.composite()
    assert way().way == "composite" and "renders all of this scene" in way().reason
    bpy.ops.mrpnn.composite_remove()
    assert "does not render" in way().reason


@pytest.mark.parametrize(
    "shader, values, reason",
    [
        ("ShaderNodeBsdfGlass", {"Roughness": 0.0}, "glass"),
        ("ShaderNodeBsdfGlossy", {"Roughness": 0.1}, "mirrors"),
        ("ShaderNodeBsdfPrincipled", {"Metallic": 1.0, "Roughness": 0.0}, "mirrors"),
        ("ShaderNodeBsdfPrincipled", {"Transmission_Weight": 1.0, "Roughness": 0.0}, "glass"),
    ],
)
def test_mirrors_and_glass_need_baked_light(way, scene, shader, values, reason):
    plane(scene, shader, **values)
    assert way().way == "baked light" and f"has {reason}, which" in way().reason


@pytest.mark.parametrize("density, expected", [(0.3, "Cycles"), (30.0, "baked light")])
def test_thin_fog_is_quicker_without_a_bake(way, scene, density, expected):
    plane(scene, "ShaderNodeBsdfGlass", Roughness=0.0)
    bpy.data.objects.remove(scene.objects["Cloud"])
    bpy.ops.mesh.primitive_cube_add(size=4.0)
    blender_scenes.add_fog(bpy.context.object.data, "Fog", "ShaderNodeVolumePrincipled", Density=density)
    assert way().way == expected and "has glass, which" in way().reason


def test_blur_needs_no_more_than_the_layer(way, scene):
    scene.camera.data.dof.use_dof = scene.render.use_motion_blur = True
    assert way().way == "layer"


@pytest.mark.parametrize("kind", ["SUN", "POINT", "SPOT", "AREA"])
def test_no_light_needs_more_than_the_layer(way, scene, kind):
    blender_scenes.add_object(scene, "Lamp", bpy.data.lights.new("Lamp", kind))
    assert way().way == "layer"
