# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes whose material has a volume and no surface, against closed forms and Cycles."""

import math

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

import bmesh
from mathutils import Matrix

from inference import SceneError, Settings, render
from tests.support import blender_scenes


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


def add_mesh(scene, make, name="Fog", shader="ShaderNodeVolumePrincipled", **inputs):
    """A mesh made by `make(bmesh)` with one volume shader; gives (object, shader node)."""
    shape = bmesh.new()
    make(shape)
    mesh = bpy.data.meshes.new(name)
    shape.to_mesh(mesh)
    shape.free()
    shown = blender_scenes.add_object(scene, name, mesh)
    return shown, blender_scenes.add_fog(mesh, name, shader, **inputs)


def cube(shape):
    bmesh.ops.create_cube(shape, size=2.0)


def ball(shape):
    bmesh.ops.create_icosphere(shape, subdivisions=4, radius=1.0)


def lit(scene, **camera):
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene, **camera)


def total(volume):
    """The integral of the density over the world."""
    return float(volume.density.sum()) * abs(np.linalg.det(volume.world_from_index[:3, :3]))


@pytest.mark.parametrize("make, size", [(cube, 8.0), (ball, 4.0 / 3.0 * math.pi)])
def test_the_inside_of_a_closed_mesh(addon, scene, make, size):
    fog, _ = add_mesh(scene, make, Density=0.5)
    fog.matrix_world = Matrix.LocRotScale((1, 2, 3), Matrix.Rotation(0.7, 3, "X"), (1.0, -2.0, 0.5))
    lit(scene)
    ((volume, medium),) = read(addon).volumes
    assert total(volume) == pytest.approx(size, rel=0.01)
    # A mesh's density is per world unit, whatever its scale.
    np.testing.assert_allclose(medium.sigma_t, 0.5 * (0.5 + 0.5))
    np.testing.assert_allclose(medium.albedo, 0.5)
    middle = np.array([(n - 1) / 2 for n in volume.density.shape] + [1.0])
    np.testing.assert_allclose((volume.world_from_index @ middle)[:3], (1, 2, 3), atol=1e-6)


def test_normals_that_point_inwards_enclose_as_well_and_are_named(addon, scene):
    """Cycles shows no fog there."""
    shown, _ = add_mesh(scene, lambda shape: (cube(shape), bmesh.ops.reverse_faces(shape, faces=shape.faces[:])))
    lit(scene)
    described = read(addon)
    assert total(described.volumes[0][0]) == pytest.approx(8.0, rel=1e-3)
    (told,) = [text for text in described.warnings if "normals point inwards" in text]
    assert '"Fog"' in told and "Recalculate Outside" in told
    # A mirrored object is no such mesh.
    shown.data.flip_normals()
    shown.scale.x = -1.0
    assert not [text for text in read(addon).warnings if "normals" in text]


def test_modifiers_shape_the_mesh(addon, scene):
    fog, _ = add_mesh(scene, cube)
    array = fog.modifiers.new("Array", "ARRAY")
    array.relative_offset_displace = (1.5, 0.0, 0.0)
    lit(scene)
    assert total(read(addon).volumes[0][0]) == pytest.approx(16.0, rel=0.01)


def test_a_fluid_domain_without_smoke_is_no_box_of_fog(addon, scene):
    """With smoke: tests/package/test_programs.py, since the bpy module cannot simulate."""
    fog, _ = add_mesh(scene, cube)
    modifier = fog.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type, modifier.domain_settings.domain_type = "DOMAIN", "GAS"
    lit(scene)
    described = read(addon)
    assert (
        not described.volumes
        and not addon.mrpnn_addon.engine.render_job.render_scene(described, Settings()).layer.alpha.any()
    )
    assert f'volume "{fog.name}" has no smoke in frame 1 (left out)' in described.warnings
    # Liquids are meshes.
    modifier.domain_settings.domain_type = "LIQUID"
    assert len(read(addon).volumes) == 1


@pytest.mark.parametrize(
    "seen", ["gradient", *(pytest.param(seen, marks=pytest.mark.slow) for seen in ("homogeneous", "noise"))]
)
def test_alpha_is_that_of_cycles(addon, scene, tmp_path, seen):
    # Purely absorbing: nothing to predict.
    fog, node = add_mesh(scene, ball if seen == "homogeneous" else cube, Density=0.6, Color=(0.0, 0.0, 0.0, 1.0))
    fog.rotation_euler, fog.scale = (0.4, 0.3, 0.2), (1.0, 0.7, 1.3)
    tree = node.id_data
    if seen != "homogeneous":
        coordinates = tree.nodes.new("ShaderNodeTexCoord")
        texture = tree.nodes.new("ShaderNodeTexGradient" if seen == "gradient" else "ShaderNodeTexNoise")
        # Noise in its default coordinates.
        if seen == "gradient":
            texture.gradient_type = "SPHERICAL"
            tree.links.new(coordinates.outputs["Object"], texture.inputs["Vector"])
        else:
            texture.inputs["Scale"].default_value = 3.0
        ramp = tree.nodes.new("ShaderNodeMapRange")
        ramp.inputs["From Min"].default_value, ramp.inputs["To Max"].default_value = 0.3, 4.0
        tree.links.new(next(o for o in texture.outputs if o.name == "Fac"), ramp.inputs[0])
        tree.links.new(ramp.outputs[0], node.inputs["Density"])
    lit(scene)
    scene.render.resolution_x = scene.render.resolution_y = 32
    scene.cycles.volume_step_rate = 0.1
    bpy.context.view_layer.update()
    settings = Settings(depth_samples=1)
    described = read(addon)
    layer = render(described.volumes, described.suns, described.camera, settings)
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=64)[..., 3]
    assert expected.mean() > 0.03
    assert layer.alpha.mean() == pytest.approx(expected.mean(), rel=0.01)
    assert np.sqrt(((layer.alpha - expected) ** 2).mean()) < 0.02


def test_coordinates_of_an_object_of_scale_0_are_named(addon, scene):
    _, node = add_mesh(scene, cube, Density=0.6)
    tree, flat = node.id_data, bpy.data.objects.new("Flat", None)
    scene.collection.objects.link(flat)
    flat.scale = (1.0, 0.0, 1.0)
    coordinates = tree.nodes.new("ShaderNodeTexCoord")
    coordinates.object = flat
    tree.links.new(coordinates.outputs["Object"], node.inputs["Density"])
    lit(scene)
    bpy.context.view_layer.update()
    with pytest.raises(SceneError, match="Texture Coordinate.*an object of scale 0"):
        read(addon)


def stretched(*sizes, turn=None):
    def make(shape):
        made = bmesh.ops.create_cube(shape, size=1.0)
        bmesh.ops.scale(shape, vec=sizes, verts=made["verts"])
        if turn is not None:
            bmesh.ops.rotate(shape, cent=(0, 0, 0), matrix=turn, verts=made["verts"])

    return make


TURN = Matrix.Rotation(0.7, 3, "X") @ Matrix.Rotation(0.5, 3, "Y") @ Matrix.Rotation(0.4, 3, "Z")


@pytest.mark.parametrize(
    "make, density",
    [
        (stretched(2.0, 2.0, 0.01, turn=Matrix.Rotation(0.3, 3, "X")), 60.0),
        (stretched(2.0, 2.0, 0.01, turn=TURN), 60.0),
        (stretched(2.0, 0.03, 0.03), 60.0),
        (stretched(2.0, 0.03, 0.03, turn=TURN), 60.0),
    ],
)
def test_fog_thinner_than_two_voxels_hides_as_much_as_in_cycles(addon, scene, tmp_path, make, density):
    """Blurred over voxels, the same fog would hide more."""
    fog, _ = add_mesh(scene, make, Density=density, Color=(0.0, 0.0, 0.0, 1.0))
    # Across the pixels' rows, so that one ray for each finds its mean width.
    fog.rotation_euler = (0.0, 0.0, 0.3)
    lit(scene, ortho_scale=2.2)
    scene.render.resolution_x = scene.render.resolution_y = 200
    described = read(addon)
    layer = render(described.volumes, described.suns, described.camera, Settings(depth_samples=1))
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=4)[..., 3]
    assert layer.alpha.mean() == pytest.approx(expected.mean(), rel=0.03)


def open_box(shape):
    cube(shape)
    bmesh.ops.delete(shape, geom=shape.faces[:1], context="FACES_ONLY")


def sheet(shape):
    bmesh.ops.create_grid(shape, x_segments=1, y_segments=1, size=1.0)


@pytest.mark.parametrize("make, said", [(open_box, "not closed"), (sheet, "flat"), (lambda shape: None, "no faces")])
def test_meshes_without_an_inside_are_refused_by_name(addon, scene, make, said):
    add_mesh(scene, make)
    lit(scene)
    with pytest.raises(SceneError, match=f'"Fog".*{said}'):
        read(addon)


@pytest.mark.parametrize("added", [0.0, 0.6])
def test_an_attribute_that_a_mesh_lacks_is_0(addon, scene, tmp_path, added):
    _, node = add_mesh(scene, cube, Color=(0.0, 0.0, 0.0, 1.0))
    tree = node.id_data
    total_of = tree.nodes.new("ShaderNodeMath")
    total_of.inputs[1].default_value = added
    tree.links.new(tree.nodes.new("ShaderNodeVolumeInfo").outputs["Density"], total_of.inputs[0])
    tree.links.new(total_of.outputs[0], node.inputs["Density"])
    lit(scene)
    scene.render.resolution_x = scene.render.resolution_y = 32
    described = read(addon)
    assert any('"density", which does not exist inside a mesh' in warning for warning in described.warnings)
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=16)[..., 3]
    if added:
        layer = render(described.volumes, described.suns, described.camera, Settings(depth_samples=1))
        assert layer.alpha.mean() == pytest.approx(expected.mean(), rel=0.02)
    else:
        assert described.empty and not expected.any()


def test_a_mesh_with_a_surface_is_no_volume(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    _, node = add_mesh(scene, cube, name="Glass")
    tree = node.id_data
    glass = tree.nodes.new("ShaderNodeBsdfGlass")
    tree.links.new(glass.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])
    described = read(addon)
    assert [volume.name for volume, _ in described.volumes] == ["Cloud"]
    assert any('"Glass": a volume inside a transparent surface' in warning for warning in described.warnings)


SURFACES = {
    # Nodes, values of their inputs, and whether Cycles shows the fog alone.
    "transparent": ([("BsdfTransparent", {})], True),
    "mixed": ([("MixShader", {0: 0.3}), ("BsdfTransparent", {}), ("BsdfTransparent", {})], True),
    "nothing of it mixed": ([("MixShader", {0: 0.0}), ("BsdfTransparent", {}), ("BsdfDiffuse", {})], True),
    "added to nothing": ([("AddShader", {}), ("BsdfTransparent", {})], True),
    "an empty mix": ([("MixShader", {})], True),
    "alpha 0": ([("BsdfPrincipled", {"Alpha": 0.0})], True),
    "no emission": ([("Emission", {"Strength": 0.0})], True),
    "tinted": ([("BsdfTransparent", {"Color": (0.5, 0.5, 0.5, 1.0)})], False),
    "half transparent": ([("MixShader", {0: 0.5}), ("BsdfTransparent", {}), ("BsdfDiffuse", {})], False),
    "holdout": ([("Holdout", {})], False),
}


@pytest.mark.parametrize("surface", SURFACES)
def test_a_surface_that_lets_all_light_pass_is_none(addon, scene, tmp_path, surface):
    nodes, clear = SURFACES[surface]
    _, fog = add_mesh(scene, ball, Density=0.6, Color=(0.0, 0.0, 0.0, 1.0))
    lit(scene, ortho_scale=3.0)
    scene.render.resolution_x = scene.render.resolution_y = 8
    alone = blender_scenes.render_cycles(scene, tmp_path, samples=16)
    tree = fog.id_data
    output, made = tree.get_output_node("CYCLES"), []
    for name, values in nodes:
        made.append(tree.nodes.new(f"ShaderNode{name}"))
        for socket, value in values.items():
            made[-1].inputs[socket].default_value = value
    tree.links.new(made[0].outputs[0], output.inputs["Surface"])
    for part, socket in zip(made[1:], [one for one in made[0].inputs if one.type == "SHADER"]):
        tree.links.new(part.outputs[0], socket)
    # Cycles displaces no volume.
    tree.links.new(tree.nodes.new("ShaderNodeDisplacement").outputs[0], output.inputs["Displacement"])
    assert np.allclose(blender_scenes.render_cycles(scene, tmp_path, samples=16), alone, atol=1e-4) == clear
    if clear:
        described = read(addon)
        assert [volume.name for volume, _ in described.volumes] == ["Fog"] and not described.warnings
    else:
        bpy.ops.mesh.primitive_cube_add(size=0.1)
        blender_scenes.add_fog(bpy.context.object.data, "Other", "ShaderNodeVolumePrincipled")
        described = read(addon)
        # A holdout hides what is behind it, its own fog too.
        said = (
            "hides the fog of its own"
            if surface == "holdout"
            else "a volume inside a transparent surface is not rendered"
        )
        assert any('"Fog"' in text and said in text for text in described.warnings)


@pytest.mark.parametrize("other", [None, "Paint"])
def test_a_mesh_with_faces_of_another_material_says_which_it_needs(addon, scene, other):
    """An empty slot, which Blender shows as a grey surface, or a material without a volume."""
    _, fog = add_mesh(scene, cube, Density=0.6)
    lit(scene)
    mesh = scene.objects["Fog"].data
    mesh.materials.append(bpy.data.materials.new(other) if other else None)
    mesh.polygons[0].material_index = 1
    said = '"Fog": some of its faces have no volume in their material'
    with pytest.raises(SceneError, match=said):
        read(addon)
    mesh.polygons[0].material_index = 0
    assert not read(addon).warnings


def test_a_world_of_fog_alone_is_named_with_what_is_rendered(addon, scene):
    lit(scene)
    tree = scene.world.node_tree
    tree.links.new(
        tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], tree.get_output_node("CYCLES").inputs["Volume"]
    )
    said = 'World "World": its fog is not rendered; use a large cube'
    with pytest.raises(SceneError, match=said):
        read(addon)
    with pytest.raises(RuntimeError, match=said):
        bpy.ops.mrpnn.composite()


@pytest.mark.parametrize("density", [0.1, 1000.0])
def test_a_camera_in_smoke_whose_picture_is_black_is_told_so(addon, scene, density):
    add_mesh(scene, cube, Density=density, Color=(0.2, 0.2, 0.2, 1.0))
    lit(scene, location=(0.0, 0.0, 0.0))
    scene.render.resolution_x = scene.render.resolution_y = 8
    finished = addon.mrpnn_addon.engine.render_job.render_scene(read(addon), Settings(depth_samples=1))
    assert any("inside volume" in text and "black" in text for text in finished.warnings) == (density > 1.0)
