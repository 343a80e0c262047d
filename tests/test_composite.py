"""The volumes by MRPNN over the rest of the scene by Cycles, in one F12."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from . import blender_scenes


@pytest.fixture
def cloud(scene, tmp_path):
    scene.render.resolution_x = scene.render.resolution_y = 24
    scene.mrpnn.depth_samples = 1
    return blender_scenes.cloud_scene(scene, tmp_path)


def wall(scene, z):
    """A glowing square of edge 4 over the left half of the view."""
    mesh = bpy.data.meshes.new("Wall")
    mesh.from_pydata([(-4, -2, z), (0, -2, z), (0, 2, z), (-4, 2, z)], [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new("ScatteredEmission")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    glow = nodes.new("ShaderNodeEmission")
    glow.inputs["Color"].default_value = (0.2, 0.4, 0.8, 1.0)
    material.node_tree.links.new(glow.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    mesh.materials.append(material)
    return blender_scenes.add_object(scene, "Wall", mesh)


@pytest.mark.parametrize("z, before", [(-3.0, False), (3.0, True)])
def test_the_layer_lies_over_surfaces_behind_it_and_under_those_before_it(addon, scene, cloud, tmp_path, z, before):
    # The wall keeps a little light from the layer too.
    wall(scene, z)
    bpy.ops.mrpnn.render()
    image = bpy.data.images["MRPNN"]
    layer = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(layer)
    layer = layer.reshape(24, 24, 4)[::-1]
    assert bpy.ops.mrpnn.composite(shadows=False) == {'FINISHED'}
    assert scene.render.engine == 'CYCLES' and bpy.data.scenes["Scene MRPNN"].render.engine == 'MRPNN'
    found = blender_scenes.render_cycles(scene, tmp_path, samples=4)
    left = found[:, 2:10]
    glow = np.float32([0.2, 0.4, 0.8])
    if before:
        np.testing.assert_allclose(left[4:20, ..., :3], np.broadcast_to(glow, left[4:20, ..., :3].shape), rtol=1e-3)
    else:
        under = layer[:, 2:10]
        seen = under[..., :3] + (1 - under[..., 3:]) * glow
        np.testing.assert_allclose(left[8:16, ..., :3], seen[8:16], rtol=0.02)
        assert under[8:16, ..., 3].max() > 0.2
    # Where there is no wall, the layer alone.
    np.testing.assert_allclose(found[:, 14:, :3], layer[:, 14:, :3], rtol=1e-3, atol=1e-5)


def test_volumes_stay_in_cycles_for_their_shadows_where_asked(addon, scene, cloud):
    assert bpy.ops.mrpnn.composite() == {'FINISHED'}
    (child,) = scene.view_layers[0].layer_collection.children
    assert child.indirect_only and not child.exclude and list(child.collection.objects) == [cloud]
    with pytest.raises(RuntimeError, match="\"Scene MRPNN\" already"):
        bpy.ops.mrpnn.composite()


def test_a_scene_without_volumes_is_refused_and_left_alone(addon, scene):
    blender_scenes.add_sun(scene)
    with pytest.raises(RuntimeError, match="no Volume object"):
        bpy.ops.mrpnn.composite()
    assert list(bpy.data.scenes) == [scene] and not scene.collection.children


@pytest.mark.parametrize("angle", [0.0, 0.7])
def test_a_wall_through_a_volume_equals_cycles_rendering_both(addon, scene, cloud, tmp_path, angle):
    """Fog that only absorbs, and a wall that glows: pixel by pixel, edges included."""
    scene.render.resolution_x = scene.render.resolution_y = 48
    fog = cloud.data.materials[0].node_tree.nodes["Principled Volume"].inputs
    fog["Color"].default_value, fog["Density"].default_value = (0.0, 0.0, 0.0, 1.0), 2.0
    wall(scene, 0.0).rotation_euler = (0.0, angle, 0.3)
    together = blender_scenes.render_cycles(scene, tmp_path, samples=64)
    assert bpy.ops.mrpnn.composite(shadows=False) == {'FINISHED'}
    found = blender_scenes.render_cycles(scene, tmp_path, samples=64)
    level = together[..., :3].mean()
    assert np.sqrt(((found - together)[..., :3] ** 2).mean()) < 0.05 * level
    np.testing.assert_allclose(found[..., :3].mean(axis=(0, 1)), together[..., :3].mean(axis=(0, 1)), rtol=0.01)
