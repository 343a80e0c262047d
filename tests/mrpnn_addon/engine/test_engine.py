# SPDX-License-Identifier: GPL-3.0-or-later
"""The render engine: the passes and files of F12 and animations."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes
from tests.support.exr_files import channels, combined, header

DIRECT, INDIRECT = ("Volume Direct", "Volume Indirect") if bpy.app.version >= (5, 0, 0) else ("VolumeDir", "VolumeInd")


@pytest.fixture
def cloud(scene, tmp_path):
    """A scene with a small cloud, at few pixels and depth samples, rendered by the engine."""
    scene.render.resolution_x, scene.render.resolution_y = 32, 24
    scene.mrpnn.depth_samples = 2
    scene.render.engine = "MRPNN"
    scene.render.film_transparent = True
    blender_scenes.write_multilayer(scene)
    return blender_scenes.cloud_scene(scene, tmp_path)


def render(scene, path):
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return channels(path)


def layer(addon, scene):
    """The scene rendered by the library."""
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    return addon.inference.render(described.volumes, described.suns, described.camera, scene.mrpnn.settings())


def colour(found, name):
    return np.stack([found[f"{name}.{c}"] for c in "RGB"], axis=-1)


def test_passes_carry_cycles_names_and_the_layers_parts(addon, scene, cloud, tmp_path):
    view_layer = scene.view_layers[0]
    assert set(render(scene, tmp_path / "plain.exr")) == {f"ViewLayer.Combined.{c}" for c in "RGBA"}
    view_layer.use_pass_z = view_layer.mrpnn.use_pass_uncertainty = True
    view_layer.mrpnn.use_pass_volume_direct = view_layer.mrpnn.use_pass_volume_indirect = True
    found, expected = render(scene, tmp_path / "passes.exr"), layer(addon, scene)
    np.testing.assert_array_equal(colour(found, "ViewLayer.Combined"), expected.rgb)
    np.testing.assert_array_equal(found["ViewLayer.Combined.A"], expected.alpha)
    np.testing.assert_array_equal(colour(found, f"ViewLayer.{DIRECT}"), expected.single)
    np.testing.assert_array_equal(colour(found, f"ViewLayer.{INDIRECT}"), expected.multiple)
    np.testing.assert_array_equal(found["ViewLayer.Uncertainty.X"], expected.uncertainty)
    met = expected.alpha > 0
    np.testing.assert_array_equal(found["ViewLayer.Depth.Z"][met], expected.depth[met])
    assert np.all(found["ViewLayer.Depth.Z"][~met] == np.float32(1e10))
    assert expected.multiple.max() > 0.0 and expected.uncertainty.max() > 0.0


def test_the_compositor_sees_each_pass(addon, scene, cloud, tmp_path):
    scene.view_layers[0].mrpnn.use_pass_volume_indirect = True
    tree, result = blender_scenes.compositor(scene)
    node = tree.nodes.new("CompositorNodeRLayers")
    tree.links.new(node.outputs[INDIRECT], result)
    scene.render.image_settings.color_depth = "32"
    found = render(scene, tmp_path / "composed.exr")
    composed = next(
        np.stack([found[f"{name[:-1]}{c}"] for c in "RGB"], axis=-1)
        for name in found
        if "Composite" in name and name.endswith("R")
    )
    np.testing.assert_allclose(composed, layer(addon, scene).multiple, rtol=1e-5, atol=1e-7)


def test_the_engine_renders_what_only_renders_show(addon, scene, cloud, tmp_path):
    """Hidden in the viewport, the cloud is absent for the operator; a render evaluates it."""
    shown = render(scene, tmp_path / "shown.exr")
    cloud.hide_viewport = True
    hidden = render(scene, tmp_path / "hidden.exr")
    for name, values in shown.items():
        np.testing.assert_array_equal(hidden[name], values)


@pytest.mark.parametrize("crop", [False, True])
def test_the_render_region_is_cut_as_blender_cuts_it(addon, scene, cloud, tmp_path, crop):
    # Pixels at the region's border have no neighbours outside it to interpolate from.
    scene.mrpnn.optimizations -= {"shared_pixels"}
    render(scene, tmp_path / "whole.exr")
    whole = combined(tmp_path / "whole.exr")
    region = scene.render
    region.use_border, region.use_crop_to_border = True, crop
    region.border_min_x, region.border_max_x, region.border_min_y, region.border_max_y = 0.25, 0.71, 0.13, 0.62
    # Columns 8 to 21 of 32, rows 3 to 13 of 24 from the bottom.
    rows, columns = slice(24 - 14, 24 - 3), slice(8, 22)
    expected = np.zeros_like(whole)
    expected[rows, columns] = whole[rows, columns]
    if crop:
        expected = whole[rows, columns]
    render(scene, tmp_path / "part.exr")
    np.testing.assert_array_equal(combined(tmp_path / "part.exr"), expected)
    bpy.ops.mrpnn.render(filepath=str(tmp_path / "operator.exr"))
    np.testing.assert_array_equal(combined(tmp_path / "operator.exr"), expected)


def test_half_the_resolution_is_the_same_view(addon, scene, cloud, tmp_path):
    whole = combined_of(scene, tmp_path / "whole.exr")
    scene.render.resolution_percentage = 50
    half = combined_of(scene, tmp_path / "half.exr")
    assert half.shape == (12, 16, 4)
    blocks = whole.reshape(12, 2, 16, 2, 4).mean(axis=(1, 3))
    assert np.abs(half[..., 3] - blocks[..., 3]).mean() < 0.02


def combined_of(scene, path):
    render(scene, path)
    return combined(path)


def test_a_view_layer_shows_its_own_collections(addon, scene, cloud, tmp_path):
    """The cloud is in one view layer, a second one beside it in the other; each renders as if alone."""
    other, _ = blender_scenes.add_volume(
        scene, blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 1.0)), "Other"
    )
    collections = {}
    for volume in (cloud, other):
        collections[volume.name] = bpy.data.collections.new(volume.name)
        scene.collection.children.link(collections[volume.name])
        collections[volume.name].objects.link(volume)
        scene.collection.objects.unlink(volume)
    alone = {}
    for volume, hidden in ((cloud, other), (other, cloud)):
        hidden.hide_render = True
        alone[volume.name] = combined_of(scene, tmp_path / f"{volume.name}.exr")
        hidden.hide_render = False
    scene.view_layers[0].name = "Cloud"
    for name in ("Other", "Neither"):
        scene.view_layers.new(name)
    for view_layer in scene.view_layers:
        for name in ("Cloud", "Other"):
            view_layer.layer_collection.children[name].exclude = name != view_layer.name
    render(scene, tmp_path / "layers.exr")
    for name, expected in alone.items():
        np.testing.assert_array_equal(combined(tmp_path / "layers.exr", f"{name}."), expected)
        assert expected[..., 3].max() > 0.1
    assert np.all(combined(tmp_path / "layers.exr", "Neither.") == 0.0)


def test_an_opaque_film_shows_the_world_behind(addon, scene, cloud, tmp_path):
    scene.world.cycles_visibility.scatter = False
    through = combined_of(scene, tmp_path / "transparent.exr")
    scene.render.film_transparent = False
    node = scene.world.node_tree.nodes["Background"]
    node.inputs["Strength"].default_value = 2.0
    node.inputs["Color"].default_value = (0.1, 0.2, 0.4, 1.0)
    found = combined_of(scene, tmp_path / "opaque.exr")
    behind = np.float32([0.2, 0.4, 0.8])
    # Without its light, the World adds only what is seen through the cloud.
    np.testing.assert_allclose(found[..., :3], through[..., :3] + (1 - through[..., 3:]) * behind, rtol=1e-5)
    assert np.all(found[..., 3] == 1.0)


def test_an_animation_writes_each_frame_as_if_alone(addon, scene, cloud, tmp_path):
    cloud.keyframe_insert("rotation_euler", frame=1)
    cloud.rotation_euler = (0.0, 1.5, 0.0)
    cloud.keyframe_insert("rotation_euler", frame=3)
    scene.frame_start, scene.frame_end = 1, 3
    scene.render.filepath = str(tmp_path / "frame_###")
    bpy.ops.render.render(animation=True)
    frames = [combined(tmp_path / f"frame_{number:03}.exr") for number in (1, 2, 3)]
    assert not np.array_equal(frames[0], frames[1]) and not np.array_equal(frames[1], frames[2])
    scene.frame_set(2)
    np.testing.assert_array_equal(combined_of(scene, tmp_path / "alone.exr"), frames[1])


def test_a_frame_before_a_sequence_begins_is_an_empty_picture(addon, scene, cloud, tmp_path):
    cloud.data.is_sequence, cloud.data.sequence_mode, cloud.data.frame_start = True, "CLIP", 5
    scene.frame_set(1)
    found = render(scene, tmp_path / "empty.exr")
    assert found and all(not values.any() for values in found.values())


@pytest.mark.slow
def test_an_animated_world_follows_the_frame(addon, scene, cloud, tmp_path):
    """Also in F12, which evaluates frames other than the scene's current one."""
    scene.render.film_transparent = False
    strength = scene.world.node_tree.nodes["Background"].inputs["Strength"]
    for frame, value in ((2, 0.4), (1, 0.1)):
        strength.default_value = value
        strength.keyframe_insert("default_value", frame=frame)
    bpy.data.objects.remove(scene.objects["Sun"])
    scene.frame_start, scene.frame_end = 1, 2
    scene.render.filepath = str(tmp_path / "world")
    bpy.ops.render.render(animation=True)
    first, second = (combined(tmp_path / f"world000{frame}.exr") for frame in (1, 2))
    # Its light and the background are four times as bright.
    np.testing.assert_allclose(second[..., :3], 4.0 * first[..., :3], rtol=2e-3, atol=1e-6)
    assert first[..., :3].min() > 0.0


def test_a_mistake_ends_the_render_with_its_message_and_without_a_file(addon, scene, cloud, tmp_path):
    cloud.data.filepath = str(tmp_path / "gone.vdb")
    scene.render.filepath = str(tmp_path / "never")
    with pytest.raises(RuntimeError, match='"Cloud": file not found'):
        bpy.ops.render.render(write_still=True)
    assert not list(tmp_path.glob("never*"))


def test_files_hold_metadata_of_the_render(addon, scene, cloud, tmp_path):
    scene.mrpnn.seed = 5
    render(scene, tmp_path / "stamped.exr")
    found = header(tmp_path / "stamped.exr")
    assert (found["mrpnn.ViewLayer.depthSamples"], found["mrpnn.ViewLayer.seed"]) == ("2", "5")
    assert len(found["mrpnn.ViewLayer.modelChecksum"]) == 64 and float(found["mrpnn.ViewLayer.seconds"]) > 0.0


def test_built_in_panels_show_for_the_engine_only_while_registered(addon):
    panels = [
        bpy.types.RENDER_PT_format,
        bpy.types.DATA_PT_volume_file,
        bpy.types.EEVEE_MATERIAL_PT_context_material,
        bpy.types.VIEWLAYER_PT_layer_passes_lightgroups,
        bpy.types.VIEWLAYER_PT_filter,
    ]
    assert all("MRPNN" in panel.COMPAT_ENGINES for panel in panels)
    addon.unregister()
    try:
        assert not [
            panel for panel in bpy.types.Panel.__subclasses__() if "MRPNN" in getattr(panel, "COMPAT_ENGINES", ())
        ]
        assert not hasattr(bpy.types.Scene, "mrpnn") and not hasattr(bpy.types, "MRPNN_OT_render")
    finally:
        addon.register()
