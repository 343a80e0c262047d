"""The comparison: its arithmetic against planted images, its operator on a real scene in Blender."""

import importlib
import json

import bpy
import numpy as np
import pytest

from . import blender_scenes as make

SIZE = 48


@pytest.fixture
def comparison(addon):
    return importlib.import_module("mrpnn.mrpnn_addon.comparison")


@pytest.fixture
def planted(comparison):
    """A layer 5 % brighter than a noisy reference: gives (layer, reference)."""
    from mrpnn.inference.layer import Layer
    from mrpnn.mrpnn_addon.cycles_reference import Reference

    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE - 0.5
    alpha = np.clip(1.4 - 4 * np.hypot(x, y), 0, 1).astype(np.float32)
    truth = alpha[..., None] * np.array([1.0, 0.8, 0.6], np.float32)
    halves = [np.concatenate([truth * rng.gamma(11.0, 1 / 11.0, truth.shape), alpha[..., None]], axis=-1)
              for _ in range(2)]
    black = np.zeros_like(truth)
    layer = Layer(1.05 * truth, alpha, np.ones_like(alpha), 1.05 * truth, black, black[..., 0])
    return layer, Reference(*halves, seconds=12.0, samples=16, bounces=1024, version="4.5.15")


def test_planted_bias_noise_and_times_are_reported(comparison, planted):
    layer, reference = planted
    result = comparison.compare(layer, 1.5, reference, ["a mesh is left out"])
    assert result.bias.value == pytest.approx(0.05, abs=0.01)
    # Each sample of the halves varies by 1/sqrt(11) of itself; the mean of both by 1/sqrt(2) of that.
    shown = layer.alpha > comparison.MASK_ALPHA
    spread = np.sqrt((layer.rgb[shown] ** 2).mean()) / layer.rgb[shown].mean()
    assert result.noise == pytest.approx(spread / np.sqrt(22), rel=0.1)
    assert result.alpha_bias.value == 0.0
    assert result.pixels == shown.sum() and result.resolution == (SIZE, SIZE)
    table = result.table()
    for figure in ("+5.", "12.0", "1.5", "2 x 16 samples", "1024 bounces", "4.5.15"):
        assert figure in table, table


def test_json_holds_every_figure_and_replaces_the_file_whole(comparison, planted, tmp_path):
    result = comparison.compare(planted[0], 1.5, planted[1], ["left out"])
    path = tmp_path / "figures.json"
    path.write_text("old")
    result.write_json(str(path))
    found = json.loads(path.read_text())
    assert found["bias"]["value"] == result.bias.value and found["bias"]["low"] < found["bias"]["high"]
    assert found["layer_seconds"] == 1.5 and found["warnings"] == ["left out"]
    assert [entry.name for entry in tmp_path.iterdir()] == ["figures.json"]


def test_json_that_cannot_be_written_is_a_plain_error(comparison, planted, tmp_path):
    (tmp_path / "file").write_text("")
    result = comparison.compare(planted[0], 1.5, planted[1])
    with pytest.raises(comparison.SceneError, match="cannot write"):
        result.write_json(str(tmp_path / "file" / "figures.json"))


def test_images_of_different_size_and_an_empty_view_are_refused(comparison, planted):
    layer, reference = planted
    reference.a = reference.a[:-1]
    with pytest.raises(comparison.SceneError, match="48 x 48 pixels and Cycles' image 48 x 47"):
        comparison.compare(layer, 1.0, reference)
    layer, reference = planted[0], planted[1]
    reference.a = reference.b
    layer.alpha = np.zeros_like(layer.alpha)
    with pytest.raises(comparison.SceneError, match="nothing to compare"):
        comparison.compare(layer, 1.0, reference)


def test_operator_measures_a_thin_cloud_right_and_leaves_the_scene_alone(scene, tmp_path):
    make.cloud_scene(scene, tmp_path, density=1.0)
    scene.camera.location.z = 4.0
    scene.render.engine = 'BLENDER_WORKBENCH'
    scene.cycles.samples = 7
    path = tmp_path / "figures.json"
    assert bpy.ops.mrpnn.compare(samples=32, scale=50, json_path=str(path)) == {'FINISHED'}

    found = json.loads(path.read_text())
    assert found["resolution"] == [32, 32] and found["samples"] == 32
    # Thin: nearly all light is scattered once, which is computed, not predicted.
    assert abs(found["bias"]["value"]) < 0.1
    assert abs(found["alpha_bias"]["value"]) < 0.02
    assert found["noise"] > 0.0 and found["cycles_seconds"] > 0.0

    layer, cycles, error = (image_pixels(name) for name in ("MRPNN", "MRPNN Cycles", "MRPNN error"))
    assert layer.shape == (32, 32, 4)
    assert np.allclose(layer[..., :3] - cycles[..., :3], error[..., :3], atol=1e-6)
    assert "relative bias" in bpy.data.texts["MRPNN comparison"].as_string()

    assert scene.render.engine == 'BLENDER_WORKBENCH' and scene.cycles.samples == 7
    assert scene.render.resolution_percentage == 100 and list(bpy.data.scenes) == [scene]


def test_operator_refuses_a_scene_without_volume_and_writes_nothing(scene, tmp_path):
    make.add_sun(scene)
    make.add_camera(scene)
    path = tmp_path / "figures.json"
    with pytest.raises(RuntimeError, match="Volume"):
        bpy.ops.mrpnn.compare(samples=1, json_path=str(path))
    assert not path.exists() and scene.render.resolution_percentage == 100


def test_operator_refuses_an_instancer_that_shows_a_surface_beside_the_volume(scene, tmp_path):
    cloud = make.cloud_scene(scene, tmp_path)
    group = bpy.data.collections.new("group")
    wall = bpy.data.objects.new("wall", bpy.data.meshes.new("wall"))
    for member in (cloud, wall):
        group.objects.link(member)
    scene.collection.objects.unlink(cloud)
    instancer = make.add_object(scene, "both", None)
    instancer.instance_type, instancer.instance_collection = 'COLLECTION', group
    with pytest.raises(RuntimeError, match="\"both\" instances a volume"):
        bpy.ops.mrpnn.compare(samples=1)


def test_a_region_is_compared_at_its_own_size(scene, tmp_path):
    make.cloud_scene(scene, tmp_path, density=1.0)
    render = scene.render
    render.use_border, render.use_crop_to_border = True, False
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.75, 0.5, 1.0
    path = tmp_path / "figures.json"
    assert bpy.ops.mrpnn.compare(samples=16, scale=100, json_path=str(path)) == {'FINISHED'}
    found = json.loads(path.read_text())
    assert found["resolution"] == [32, 32]
    assert abs(found["alpha_bias"]["value"]) < 0.03


def image_pixels(name):
    image = bpy.data.images[name]
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)[::-1]
