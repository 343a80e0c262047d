# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendering in Blender: the operator and the worker thread."""

import threading
import time

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

# After bpy: its compiled libraries must come first.
import OpenEXR

from inference import SceneError, Settings, render
from tests.support import blender_scenes
from tests.support.exr_files import channels, combined


@pytest.fixture
def cloud(scene, tmp_path):
    """A scene with a small cloud, at few pixels and depth samples."""
    scene.render.resolution_x, scene.render.resolution_y = 32, 24
    scene.mrpnn.depth_samples = 2
    return blender_scenes.cloud_scene(scene, tmp_path)


def image_pixels():
    """The operator's image, float32 (H, W, 4), rows from the top."""
    image = bpy.data.images["MRPNN"]
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)[::-1]


def test_the_operator_renders_the_librarys_layer(addon, scene, cloud, tmp_path):
    assert bpy.ops.mrpnn.render(filepath=str(tmp_path / "layer.exr")) == {"FINISHED"}
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    layer = render(described.volumes, described.suns, described.camera, Settings(depth_samples=2))
    found = image_pixels()
    np.testing.assert_array_equal(found[..., :3], layer.rgb)
    np.testing.assert_array_equal(found[..., 3], layer.alpha)
    assert layer.alpha.max() > 0.5 and layer.multiple.max() > 0.0
    written = channels(tmp_path / "layer.exr")
    np.testing.assert_array_equal(written["ViewLayer.Multiple.G"], layer.multiple[..., 1])
    np.testing.assert_array_equal(combined(tmp_path / "layer.exr"), found)


def test_alpha_is_that_of_cycles(addon, scene, cloud, tmp_path):
    scene.render.resolution_x = scene.render.resolution_y = 32
    bpy.ops.mrpnn.render()
    alpha = image_pixels()[..., 3]
    reference = blender_scenes.render_cycles(scene, tmp_path, samples=128)[..., 3]
    assert abs(alpha.mean() / reference.mean() - 1.0) < 0.01
    # Pixel by pixel within what a box filter over a pixel's area differs from its centre.
    assert np.abs(alpha - reference).max() < 0.1


def test_settings_of_the_scene_are_used(addon, scene, cloud, tmp_path):
    settings = scene.mrpnn
    settings.depth_samples, settings.seed, settings.threads = 3, 5, 1
    settings.use_exr, settings.exr_path = True, str(tmp_path / "scene.exr")
    bpy.ops.mrpnn.render()
    with OpenEXR.File(settings.exr_path) as file:
        header = dict(file.header())
    assert header["mrpnn.depthSamples"] == 3 and header["mrpnn.seed"] == 5
    one = image_pixels().copy()
    settings.threads = 2
    bpy.ops.mrpnn.render()
    np.testing.assert_array_equal(image_pixels(), one)
    settings.seed = 6
    bpy.ops.mrpnn.render()
    assert not np.array_equal(image_pixels()[..., :3], one[..., :3])
    np.testing.assert_array_equal(image_pixels()[..., 3], one[..., 3])


def test_problems_are_errors_with_a_message(addon, scene, cloud, tmp_path):
    with pytest.raises(RuntimeError, match="folder of the EXR file does not exist"):
        bpy.ops.mrpnn.render(filepath=str(tmp_path / "missing" / "x.exr"))
    with pytest.raises(RuntimeError, match="not saved yet"):
        bpy.ops.mrpnn.render(filepath="//x.exr")
    scene.render.resolution_x = scene.render.resolution_y = 4096
    scene.mrpnn.memory_limit = 1
    with pytest.raises(RuntimeError, match="the memory limit is 1.0 GiB"):
        bpy.ops.mrpnn.render(filepath=str(tmp_path / "x.exr"))
    cloud.data.filepath = str(tmp_path / "gone.vdb")
    with pytest.raises(RuntimeError, match='"Cloud": file not found'):
        bpy.ops.mrpnn.render(filepath=str(tmp_path / "x.exr"))
    assert not (tmp_path / "x.exr").exists() and "MRPNN" not in bpy.data.images


def test_a_worker_thread_gives_the_same_layer(addon, scene, cloud):
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    job = addon.mrpnn_addon.engine.render_job.RenderJob(described, scene.mrpnn.settings(), None)
    job.wait()
    assert job.done and job.error is None and job.fraction > 0.9
    bpy.ops.mrpnn.render()
    np.testing.assert_array_equal(image_pixels()[..., :3], job.result.layer.rgb)


def test_a_cancelled_worker_ends_and_writes_nothing(addon, scene, cloud, tmp_path):
    scene.render.resolution_x = scene.render.resolution_y = 256
    settings = Settings(depth_samples=64)
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    path = tmp_path / "layer.exr"
    job = addon.mrpnn_addon.engine.render_job.RenderJob(described, settings, str(path))
    # Until the network is evaluated, deep inside the render.
    while "multiple" not in job.message and not job.done:
        time.sleep(0.01)
    job.stop()
    job.wait()
    assert job.cancelled and job.result is None and not path.exists()
    assert not [thread for thread in threading.enumerate() if thread.name == "mrpnn render"]


def test_a_workers_error_reaches_the_main_thread(addon, scene, cloud, tmp_path):
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    settings = Settings(model="no such network")
    job = addon.mrpnn_addon.engine.render_job.RenderJob(described, settings, None)
    job.wait()
    assert isinstance(job.error, SceneError) and "no such network" in str(job.error)
