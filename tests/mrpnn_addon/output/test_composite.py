# SPDX-License-Identifier: GPL-3.0-or-later
"""Compositing: the volumes by MRPNN over the rest of the scene by Cycles, in one F12."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes


@pytest.fixture
def cloud(scene, tmp_path):
    scene.render.resolution_x = scene.render.resolution_y = 24
    scene.mrpnn.depth_samples = 1
    return blender_scenes.cloud_scene(scene, tmp_path)


def wall(scene, z):
    """An emissive square of edge 4 over the left half of the view."""
    mesh = bpy.data.meshes.new("Wall")
    mesh.from_pydata([(-4, -2, z), (0, -2, z), (0, 2, z), (-4, 2, z)], [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new("Emission")
    material.use_nodes = True
    nodes = material.node_tree.nodes
    nodes.clear()
    glow = nodes.new("ShaderNodeEmission")
    glow.inputs["Color"].default_value = (0.2, 0.4, 0.8, 1.0)
    material.node_tree.links.new(glow.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    mesh.materials.append(material)
    return blender_scenes.add_object(scene, "Wall", mesh)


@pytest.mark.slow
@pytest.mark.parametrize("z, before", [(-3.0, False), (3.0, True)])
def test_the_layer_covers_surfaces_behind_it_and_is_covered_by_those_in_front(addon, scene, cloud, tmp_path, z, before):
    # The wall also blocks a little light from the layer.
    wall(scene, z)
    bpy.ops.mrpnn.render()
    image = bpy.data.images["MRPNN"]
    layer = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(layer)
    layer = layer.reshape(24, 24, 4)[::-1]
    assert bpy.ops.mrpnn.composite(shadows=False) == {"FINISHED"}
    assert scene.render.engine == "CYCLES" and bpy.data.scenes["Scene MRPNN"].render.engine == "MRPNN"
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


def layer_of(scene):
    """What Render Volumes shows of a scene: float32 (H, W, 4), rows from the top."""
    with bpy.context.temp_override(scene=scene, view_layer=scene.view_layers[0]):
        bpy.ops.mrpnn.render()
    image = bpy.data.images["MRPNN"]
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)[::-1]


def state(scene):
    """Everything in a scene that compositing could leave changed."""
    tree = scene.node_tree if bpy.app.version < (5, 0, 0) else scene.compositing_node_group
    return {
        "scenes": sorted(one.name for one in bpy.data.scenes),
        "collections": {one.name: sorted(o.name for o in one.objects) for one in bpy.data.collections},
        "objects": {one.name: (one.visible_camera, one.visible_shadow, one.hide_render) for one in bpy.data.objects},
        "layers": [
            (one.name, one.use, one.use_pass_z, one.layer_collection.indirect_only) for one in scene.view_layers
        ],
        "engine": scene.render.engine,
        "film": scene.render.film_transparent,
        "compositing": scene.render.use_compositing,
        "nodes": bool(scene.use_nodes) if bpy.app.version < (5, 0, 0) else tree is not None,
    }


def ground(scene, z=-1.5):
    """A white diffuse floor under the cloud."""
    mesh = bpy.data.meshes.new("Ground")
    mesh.from_pydata([(-6, -6, z), (6, -6, z), (6, 6, z), (-6, 6, z)], [], [(0, 1, 2, 3)])
    return blender_scenes.add_object(scene, "Ground", mesh)


@pytest.mark.slow
def test_volumes_cast_shadows_on_surfaces_on_request(addon, scene, cloud, tmp_path):
    ground(scene)
    found, before = {}, state(scene)
    for shadows in (True, False):
        # Again, to change the setting.
        assert bpy.ops.mrpnn.composite(shadows=shadows) == {"FINISHED"}
        assert [one.name for one in bpy.data.scenes] == ["Scene", "Scene MRPNN"]
        found[shadows] = blender_scenes.render_cycles(scene, tmp_path, samples=32)[..., 1]
    # The sunlight that the cloud blocks from the floor.
    assert np.median(found[True]) > 0.9 * np.median(found[False]) and (found[True] < 0.7 * found[False]).sum() > 20
    after = state(scene)
    assert [after[name] for name in ("collections", "objects", "layers")] == [
        before[name] for name in ("collections", "objects", "layers")
    ]


def nested(scene, cloud):
    """The cloud and a small bright block in a nested collection, shown only by an instance."""
    inner, outer = bpy.data.collections.new("Inner"), bpy.data.collections.new("Outer")
    outer.children.link(inner)
    block = wall(scene, 0.5)
    block.scale, block.location = (0.2, 0.2, 1.0), (-1.5, 1.5, 0.0)
    for shown in (cloud, block):
        scene.collection.objects.unlink(shown)
        inner.objects.link(shown)
    return outer


def instance(scene, collection):
    empty = blender_scenes.add_object(scene, "Instance", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    return empty


@pytest.mark.parametrize("linked", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_instances_of_a_collection_show_its_volumes_and_surfaces(addon, scene, cloud, tmp_path, linked):
    outer = nested(scene, cloud)
    if linked:
        library = str(tmp_path / "library.blend")
        bpy.data.libraries.write(library, {outer}, fake_user=True)
        for block in (cloud, bpy.data.objects["Wall"]):
            bpy.data.objects.remove(block)
        for collection in list(bpy.data.collections):
            bpy.data.collections.remove(collection)
        with bpy.data.libraries.load(library, link=True) as (there, here):
            here.collections = ["Outer"]
        outer = here.collections[0]
        assert outer.library is not None
    instance(scene, outer)
    # Up to Cycles' noise, the picture is the layer over the block, which nowhere shows twice.
    alone = layer_of(scene)
    assert alone[..., 3].max() > 0.2
    before = state(scene)
    assert bpy.ops.mrpnn.composite(shadows=False) == {"FINISHED"}
    found = blender_scenes.render_cycles(scene, tmp_path, samples=4)
    blue = found[..., 2] - alone[..., 2] > 0.3
    assert 4 < blue.sum() < 60
    # Pixels at its edge show some of it.
    blue |= np.roll(blue, 1, 0) | np.roll(blue, -1, 0)
    blue |= np.roll(blue, 1, 1) | np.roll(blue, -1, 1)
    np.testing.assert_allclose(found[~blue], alone[~blue], rtol=2e-3, atol=0.02)
    # Where Cycles keeps the volumes for their shadows, the camera still sees them once.
    bpy.ops.mrpnn.composite(shadows=True)
    found = blender_scenes.render_cycles(scene, tmp_path, samples=4)
    np.testing.assert_allclose(found[~blue], alone[~blue], rtol=2e-3, atol=0.02)
    bpy.ops.mrpnn.composite_remove()
    assert {**state(scene), "film": False} == before


@pytest.mark.slow
def test_the_scene_of_the_volumes_follows_the_first_one(addon, scene, cloud, tmp_path):
    bpy.ops.mrpnn.composite(shadows=False)
    volumes = bpy.data.scenes["Scene MRPNN"]
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 60, 40, 50
    scene.frame_start, scene.frame_end, scene.frame_step = 3, 9, 2
    scene.camera = blender_scenes.add_camera(scene, (0.5, 0.3, 5.0))
    scene.timeline_markers.new("Cut", frame=5).camera = scene.camera
    scene.mrpnn.depth_samples = 2
    scene.world = bpy.data.worlds.new("Other")
    second, _ = blender_scenes.add_volume(
        scene,
        blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 2.0)),
        "Second",
        Density=4.0,
    )
    second.location.x = 1.5
    hidden = bpy.data.collections.new("Hidden")
    scene.collection.children.link(hidden)
    third = second.copy()
    hidden.objects.link(third)
    scene.view_layers[0].layer_collection.children["Hidden"].exclude = True
    found = blender_scenes.render_cycles(scene, tmp_path, samples=1)
    assert found.shape == (20, 30, 4)
    np.testing.assert_allclose(found, layer_of(scene), rtol=1e-3, atol=1e-5)
    for name in ("frame_start", "frame_end", "frame_step", "camera", "world"):
        assert getattr(volumes, name) == getattr(scene, name), name
    assert [(m.frame, m.camera) for m in volumes.timeline_markers] == [(5, scene.camera)]
    assert volumes.render.image_settings.file_format == "OPEN_EXR" != "PNG"
    assert volumes.render.image_settings.color_depth == "32" and volumes.render.filepath != scene.render.filepath
    assert volumes.render.engine == "MRPNN" and scene.render.engine == "CYCLES"
    # Another rendered view layer shows what the first one does not.
    layer = scene.view_layers.new("Behind")
    layer.layer_collection.children["Hidden"].exclude = False
    third.location = (-1.5, 0.0, 0.0)
    both = blender_scenes.render_cycles(scene, tmp_path, samples=1)
    assert not volumes.view_layers[0].layer_collection.children["Hidden"].exclude
    assert both[:, :12, 3].sum() > 1.2 * found[:, :12, 3].sum()
    layer.use = False
    scene.collection.objects.unlink(second)
    blender_scenes.render_cycles(scene, tmp_path, samples=1)
    assert volumes.view_layers[0].layer_collection.children["Hidden"].exclude
    assert second.name not in volumes.objects


def test_a_saved_file_keeps_both_scenes_in_step(addon, scene, cloud, tmp_path):
    bpy.ops.mrpnn.composite()
    scene.render.resolution_x, scene.frame_end = 33, 12
    path = str(tmp_path / "composite.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.wm.open_mainfile(filepath=path)
    volumes = bpy.data.scenes["Scene MRPNN"]
    assert (volumes.render.resolution_x, volumes.frame_end) == (33, 12)
    assert not addon.mrpnn_addon.output.composite.out_of_date(bpy.data.scenes["Scene"])


def broken_scene(scene):
    bpy.data.scenes.remove(bpy.data.scenes["Scene MRPNN"])


def broken_nodes(scene):
    tree = scene.node_tree if bpy.app.version < (5, 0, 0) else scene.compositing_node_group
    tree.nodes.remove(next(node for node in tree.nodes if node.label == "Volumes by MRPNN"))


def broken_engine(scene):
    scene.render.engine = "MRPNN"


def broken_compositing(scene):
    scene.render.use_compositing = False


def turned_panorama(scene):
    lens = scene.camera.data
    lens.type = "PANO"
    (lens if hasattr(lens, "panorama_type") else lens.cycles).panorama_type = "EQUIRECTANGULAR"


@pytest.mark.parametrize(
    "change, said",
    [
        (broken_scene, "was deleted"),
        (broken_nodes, "does not show the volumes"),
        (broken_engine, "not Cycles"),
        (broken_compositing, "Compositing is off"),
        (turned_panorama, "panorama now"),
    ],
)
def test_differences_that_do_not_follow_are_named_and_repaired(addon, scene, cloud, tmp_path, change, said):
    bpy.ops.mrpnn.composite(shadows=False)
    out_of_date = addon.mrpnn_addon.output.composite.out_of_date
    assert out_of_date(scene) == []
    change(scene)
    assert any(said in problem for problem in out_of_date(scene)), out_of_date(scene)
    assert bpy.ops.mrpnn.composite(shadows=False) == {"FINISHED"}
    assert out_of_date(scene) == []
    found = blender_scenes.render_cycles(scene, tmp_path, samples=1)
    np.testing.assert_allclose(found, layer_of(scene), rtol=1e-3, atol=1e-5)
    assert found.max() > 0.01


def test_a_panorama_without_a_depth_pass_is_composited(addon, scene, cloud, tmp_path):
    turned_panorama(scene)
    scene.view_layers[0].use_pass_z = False
    assert bpy.ops.mrpnn.composite(shadows=False) == {"FINISHED"}
    found = blender_scenes.render_cycles(scene, tmp_path, samples=1)
    np.testing.assert_allclose(found, layer_of(scene), rtol=1e-3, atol=1e-5)


@pytest.mark.parametrize("depth", [False, True])
@pytest.mark.parametrize("repaired", [False, True])
def test_removing_a_panoramas_composite_restores_the_depth_pass(addon, scene, cloud, depth, repaired):
    turned_panorama(scene)
    scene.view_layers[0].use_pass_z = depth
    bpy.ops.mrpnn.composite()
    if repaired:
        bpy.ops.mrpnn.composite()
    assert scene.view_layers[0].use_pass_z
    bpy.ops.mrpnn.composite_remove()
    assert scene.view_layers[0].use_pass_z is depth


@pytest.mark.parametrize("persistent", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_removing_the_composite_restores_the_scene(addon, scene, cloud, tmp_path, persistent):
    wall(scene, -3.0)
    scene.render.use_persistent_data = persistent
    plain, before = blender_scenes.render_cycles(scene, tmp_path, samples=4), state(scene)
    bpy.ops.mrpnn.composite()
    composited = blender_scenes.render_cycles(scene, tmp_path, samples=4)
    assert np.abs(composited - plain).max() > 0.01
    # From the scene of the volumes as well.
    assert bpy.ops.mrpnn.composite_remove() == {"FINISHED"}
    assert state(scene) == before
    np.testing.assert_array_equal(blender_scenes.render_cycles(scene, tmp_path, samples=4), plain)


def test_the_users_compositor_is_kept_and_restored(addon, scene, cloud, tmp_path):
    tree, result = blender_scenes.compositor(scene)
    shown, invert = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeBlur")
    tree.links.new(shown.outputs["Image"], invert.inputs["Image"])
    tree.links.new(invert.outputs["Image"], result)
    before = sorted(node.name for node in tree.nodes)
    bpy.ops.mrpnn.composite()
    assert len(tree.nodes) == len(before) + 2
    bpy.ops.mrpnn.composite_remove()
    assert sorted(node.name for node in tree.nodes) == before
    assert result.links[0].from_node == invert and invert.inputs["Image"].links[0].from_node == shown


def test_a_copy_of_the_scene_warns_that_it_shares_volumes(addon, scene, cloud, tmp_path):
    bpy.ops.mrpnn.composite()
    other = scene.copy()
    other.render.resolution_x = 50
    composite = addon.mrpnn_addon.output.composite
    assert any("another scene" in problem for problem in composite.out_of_date(other))
    assert composite.out_of_date(scene) == []
    blender_scenes.depsgraph().update()
    assert bpy.data.scenes["Scene MRPNN"].render.resolution_x == 24


def test_the_viewport_shows_the_volumes_as_before(addon, scene, cloud, tmp_path):
    """What Cycles is given for a viewport, also after a render."""
    instance(scene, nested(scene, cloud))
    bpy.ops.mrpnn.composite(shadows=False)
    blender_scenes.render_cycles(scene, tmp_path, samples=1)
    graph = blender_scenes.depsgraph()
    graph.update()
    (seen,) = [one.object for one in graph.object_instances if one.object.type == "VOLUME"]
    assert seen.visible_camera and seen.visible_shadow and graph.mode == "VIEWPORT"
    assert not any(
        one.object.indirect_only_get(view_layer=scene.view_layers[0])
        for one in graph.object_instances
        if not one.is_instance
    )


def test_a_scene_without_volumes_is_refused_and_left_alone(addon, scene):
    blender_scenes.add_sun(scene)
    with pytest.raises(RuntimeError, match="no Volume object"):
        bpy.ops.mrpnn.composite()
    assert list(bpy.data.scenes) == [scene] and not scene.collection.children


@pytest.mark.parametrize("angle", [pytest.param(0.0, marks=pytest.mark.slow), 0.7])
def test_a_wall_through_a_volume_equals_cycles_rendering_both(addon, scene, cloud, tmp_path, angle):
    """Absorbing fog and an emissive wall: pixel by pixel, edges included."""
    scene.render.resolution_x = scene.render.resolution_y = 48
    fog = cloud.data.materials[0].node_tree.nodes["Principled Volume"].inputs
    fog["Color"].default_value, fog["Density"].default_value = (0.0, 0.0, 0.0, 1.0), 2.0
    wall(scene, 0.0).rotation_euler = (0.0, angle, 0.3)
    together = blender_scenes.render_cycles(scene, tmp_path, samples=64)
    assert bpy.ops.mrpnn.composite(shadows=False) == {"FINISHED"}
    found = blender_scenes.render_cycles(scene, tmp_path, samples=64)
    level = together[..., :3].mean()
    assert np.sqrt(((found - together)[..., :3] ** 2).mean()) < 0.05 * level
    np.testing.assert_allclose(found[..., :3].mean(axis=(0, 1)), together[..., :3].mean(axis=(0, 1)), rtol=0.01)
