# SPDX-License-Identifier: GPL-3.0-or-later
"""Emissive volumes, against Cycles' renders of the same materials."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from evaluation.error import relative_bias, relative_rmse
from inference import SceneError, Settings, render
from tests.support import blender_scenes

CELLS = 20
BLACK = {"Density": 4.0, "Color": (0.0, 0.0, 0.0, 1.0)}


@pytest.fixture(scope="module")
def fire(tmp_path_factory):
    """Smoke, and a flame and a temperature that reach beyond it."""
    vdb = blender_scenes.openvdb()
    blob = blender_scenes.blob(CELLS)
    smooth = blob.sum(axis=2, keepdims=True) / blob.sum(axis=2).max() * np.ones(CELLS, np.float32)
    grids = []
    for name, values in (
        ("density", blob),
        ("flame", np.roll(blob, 4, axis=0)),
        ("temperature", smooth),
        ("nothing", 0.0 * blob),
        ("embers", np.random.default_rng(4).uniform(0.0, 2.0, blob.shape) * (blob > 0.0)),
    ):
        grid = vdb.FloatGrid()
        grid.copyFromArray(np.ascontiguousarray(values, np.float32))
        grid.name, grid.gridClass = name, "fog volume"
        grid.transform = vdb.createLinearTransform(blender_scenes.centred(CELLS, 2.0).T.tolist())
        grids.append(grid)
    path = tmp_path_factory.mktemp("fire") / "fire.vdb"
    vdb.write(str(path), grids=grids)
    return path


def linked(node, kind, output, socket, **inputs):
    """A new node before one of `node`'s sockets; gives it."""
    tree = node.id_data
    added = tree.nodes.new(kind)
    for name, value in inputs.items():
        if name in added.inputs:
            added.inputs[name].default_value = value
        else:
            setattr(added, name, value)
    tree.links.new(added.outputs[output], node.inputs[socket])
    return added


def even(node):
    node.inputs["Emission Strength"].default_value = 0.7
    node.inputs["Emission Color"].default_value = (1.0, 0.5, 0.2, 1.0)


def black_body(node):
    node.inputs["Blackbody Intensity"].default_value = 0.6
    node.inputs["Temperature"].default_value = 2600.0
    node.inputs["Blackbody Tint"].default_value = (1.0, 0.8, 0.5, 1.0)


def black_body_without_a_grid(node):
    black_body(node)
    node.inputs["Temperature Attribute"].default_value = "absent"


def light_without_smoke(node):
    black_body(node)
    node.inputs["Density"].default_value = 0.0


def flames(node):
    strength = linked(node, "ShaderNodeMath", 0, "Emission Strength", operation="MULTIPLY")
    strength.inputs[1].default_value = 5.0
    linked(strength, "ShaderNodeAttribute", "Fac", 0, attribute_name="flame")
    colour = linked(node, "ShaderNodeBlackbody", 0, "Emission Color")
    warmth = linked(colour, "ShaderNodeMapRange", 0, "Temperature")
    warmth.inputs["To Min"].default_value, warmth.inputs["To Max"].default_value = 1000.0, 6000.0
    linked(warmth, "ShaderNodeAttribute", "Fac", 0, attribute_name="temperature")


def embers_beside_a_black_body(node):
    """Cycles interpolates the emission of one and the temperature of the other."""
    black_body(node)
    node.inputs["Temperature Attribute"].default_value = "embers"
    node.inputs["Temperature"].default_value = 1300.0
    linked(node, "ShaderNodeAttribute", "Fac", "Emission Strength", attribute_name="embers")


def emission_node_mixed_in(node):
    tree = node.id_data
    mixed = tree.nodes.new("ShaderNodeMixShader")
    mixed.inputs[0].default_value = 0.3
    tree.links.new(node.outputs[0], mixed.inputs[1])
    tree.links.new(mixed.outputs[0], tree.get_output_node("CYCLES").inputs["Volume"])
    glow = linked(mixed, "ShaderNodeEmission", 0, 2, Color=(0.2, 0.5, 1.0, 1.0))
    linked(glow, "ShaderNodeAttribute", "Fac", "Strength", attribute_name="flame")


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


def layer_of(addon, described):
    return render(described.volumes, described.suns, described.camera, Settings(depth_samples=1))


def assert_cycles_agrees(addon, scene, folder, bias):
    """Pixel by pixel and channel by channel, relative to the mean of the emissive pixels.

    Cycles averages over each pixel, the layer evaluates its centre: that is most of the error.
    """
    layer = layer_of(addon, read(addon))
    expected = blender_scenes.render_cycles(scene, folder, samples=64)[..., :3]
    shines = expected.max(axis=2) > 1e-6
    assert shines.any(), "Cycles shows no light"
    level = np.abs(expected[shines]).mean()
    assert np.sqrt(((layer.rgb - expected)[shines] ** 2).mean()) < 0.12 * level
    np.testing.assert_allclose(layer.rgb[shines].mean(axis=0) / level, expected[shines].mean(axis=0) / level, atol=bias)


@pytest.mark.parametrize(
    "setup",
    [
        even,
        black_body,
        black_body_without_a_grid,
        light_without_smoke,
        flames,
        embers_beside_a_black_body,
        emission_node_mixed_in,
    ],
)
@pytest.mark.parametrize("space", ["WORLD", pytest.param("OBJECT", marks=pytest.mark.slow)])
def test_emission_of_a_volume_object_equals_cycles(addon, scene, fire, tmp_path, setup, space):
    """No sun is needed. Emission where every grid is 0 fills the bounding boxes in Cycles."""
    scene.render.resolution_x = scene.render.resolution_y = 48
    cloud, node = blender_scenes.add_volume(scene, fire, **BLACK)
    cloud.data.render.space = space
    cloud.scale, cloud.rotation_euler = (1.5, 1.0, 0.8), (0.3, 0.2, 0.5)
    blender_scenes.add_camera(scene)
    setup(node)
    assert_cycles_agrees(addon, scene, tmp_path, bias=0.015)


@pytest.mark.parametrize("cells", [8, 16])
def test_constant_blocks_that_emit_equal_cycles(addon, scene, tmp_path, cells):
    """Files hold them as tiles, around which Cycles 4 has no boxes of light."""
    scene.render.resolution_x = scene.render.resolution_y = 24
    block = blender_scenes.write_vdb(tmp_path, np.ones((cells,) * 3), blender_scenes.centred(cells, 2.0))
    _, node = blender_scenes.add_volume(scene, block, **{**BLACK, "Density": 1.5})
    blender_scenes.add_camera(scene, ortho_scale=4.5)
    even(node)
    layer = layer_of(addon, read(addon))
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=64)
    # Cycles cuts off the half voxel over which the outermost voxels fade.
    assert layer.rgb.mean() == pytest.approx(expected[..., :3].mean(), rel=0.25)


@pytest.mark.parametrize("density", [0.0, 0.8])
def test_emission_inside_a_mesh_equals_cycles(addon, scene, tmp_path, density):
    from benchmarks.cycles.scene_features.stage import cube_mesh

    scene.render.resolution_x = scene.render.resolution_y = 48
    shown = blender_scenes.add_object(scene, "Lamp", cube_mesh(0.8))
    shown.rotation_euler = (0.3, 0.2, 0.5)
    even(blender_scenes.add_fog(shown.data, "Lamp", "ShaderNodeVolumePrincipled", **{**BLACK, "Density": density}))
    blender_scenes.add_camera(scene)
    assert_cycles_agrees(addon, scene, tmp_path, bias=0.015)


def test_smoke_that_scatters_its_own_emission_equals_cycles(addon, scene, fire, tmp_path):
    """Half of the radiance at the camera has been scattered."""
    scene.render.resolution_x = scene.render.resolution_y = 32
    cloud, node = blender_scenes.add_volume(scene, fire, Density=8.0, Anisotropy=0.3, Color=(0.9, 0.9, 0.9, 1.0))
    blender_scenes.add_camera(scene)
    flames(node)
    described = read(addon)
    assert not described.warnings
    layer = render(described.volumes, [], described.camera, Settings(depth_samples=8))
    shown = addon.mrpnn_addon.cycles.reference.volumes_and_lights(blender_scenes.depsgraph())
    reference = addon.mrpnn_addon.cycles.reference
    found = reference.render_reference(scene, shown, reference.PathTracing(samples=32))
    a, b, mask = found.a[..., :3], found.b[..., :3], layer.alpha > 0.02
    assert layer.multiple[mask].mean() > 0.4 * layer.rgb[mask].mean()
    assert abs(relative_bias(layer.rgb, a, b, mask).value) < 0.05
    assert relative_rmse(layer.rgb, a, b, mask).value < 0.2


def test_fire_that_does_not_illuminate_separate_smoke_is_named(addon, scene, fire):
    cloud, node = blender_scenes.add_volume(scene, fire, **BLACK)
    smoke, _ = blender_scenes.add_volume(scene, fire, "Smoke", Density=4.0)
    blender_scenes.add_camera(scene)
    flames(node)
    smoke.location.x = 1.0
    assert not read(addon).warnings
    smoke.location.x = 5.0
    [warning] = read(addon).warnings
    assert '"Cloud" emits does not light volume "Smoke"' in warning


def test_an_extinct_flame_emits_nothing(addon, scene, fire):
    """A grid without voxels above 0 is 0 everywhere, as in the first frames of a fire."""
    cloud, node = blender_scenes.add_volume(scene, fire, **BLACK)
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene)
    linked(node, "ShaderNodeAttribute", "Fac", "Emission Strength", attribute_name="nothing")
    described = read(addon)
    assert layer_of(addon, described).alpha.max() > 0.1
    assert described.volumes[0][0].emission is None
    node.inputs["Density Attribute"].default_value = "nothing"
    with pytest.raises(SceneError, match="Cloud.*empty"):
        read(addon)
