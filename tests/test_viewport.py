"""The preview of Rendered shading: its camera, its pictures, its end. Drawing needs a window."""

import threading
import time

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from . import blender_scenes


@pytest.fixture
def cloud(scene, tmp_path):
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    return blender_scenes.cloud_scene(scene, tmp_path)


def described(addon):
    return addon.mrpnn_addon.scene.read_scene(blender_scenes.depsgraph())


@pytest.mark.parametrize("kind", ['PERSP', 'ORTHO'])
def test_looking_through_the_camera_is_the_render_s_view(addon, scene, cloud, kind):
    camera = scene.camera
    camera.data.type, camera.data.ortho_scale, camera.data.shift_x = kind, 4.0, 0.1
    camera.rotation_euler = (0.1, 0.2, 0.3)
    description = described(addon)
    seen = addon.mrpnn_addon.viewport.viewport_camera(
        camera.matrix_world.inverted(), camera.calc_matrix_camera(blender_scenes.depsgraph(), x=64, y=48),
        kind == 'PERSP', (64, 48), clip_end=100.0)
    settings = addon.inference.Settings(depth_samples=1)
    found, expected = (addon.inference.render(description.volumes, description.suns, view, settings).alpha
                       for view in (seen, description.camera))
    np.testing.assert_allclose(found, expected, atol=2e-4)
    assert expected.max() > 0.3


def test_pictures_get_finer_and_end_as_the_render(addon, scene, cloud):
    description = described(addon)
    settings = addon.inference.Settings(depth_samples=3)
    preview = addon.mrpnn_addon.viewport.Preview(description, description.camera, settings)
    shapes = []
    while not preview.done:
        if preview.picture is not None and preview.picture.shape not in shapes:
            shapes.append(preview.picture.shape)
        time.sleep(0.002)
    assert shapes == sorted(shapes) and shapes[0] == (6, 8, 4) and preview.number == 3
    layer = addon.inference.render(description.volumes, description.suns, description.camera, settings)
    np.testing.assert_array_equal(preview.picture[::-1, :, :3], layer.rgb)


def test_a_stopped_preview_ends_its_thread_within_a_second(addon, scene, cloud):
    description = described(addon)
    preview = addon.mrpnn_addon.viewport.Preview(
        description, description.camera, addon.inference.Settings(depth_samples=256))
    while preview.number < 2:
        time.sleep(0.01)
    preview.stop()
    start = time.monotonic()
    while [thread for thread in threading.enumerate() if thread.name == "mrpnn preview"]:
        time.sleep(0.01)
    assert time.monotonic() - start < 1.0 and not preview.done and preview.number == 2


def test_a_scene_that_cannot_be_rendered_says_why(addon, scene, cloud):
    description = described(addon)
    preview = addon.mrpnn_addon.viewport.Preview(
        description, description.camera, addon.inference.Settings(memory_limit=1))
    while not preview.done:
        time.sleep(0.01)
    assert "limit" in preview.message and preview.picture is None
