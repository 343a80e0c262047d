# SPDX-License-Identifier: GPL-3.0-or-later
"""Stereoscopic and multi-view pictures: each eye against an ordinary camera where it is, Blender's and Cycles'."""

import itertools

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix

from inference import Settings
from tests.support import blender_scenes
from tests.support.exr_files import channels, header

EYES = ("left", "right")


@pytest.fixture
def stereo(scene, tmp_path):
    """A cloud in front of a stereoscopic camera."""
    blender_scenes.cloud_scene(scene, tmp_path)
    scene.render.resolution_x, scene.render.resolution_y = 24, 16
    scene.render.use_multiview = True
    scene.camera.rotation_euler, scene.camera.location = (0.3, 0.1, 0.2), (0.4, -1.8, 6.0)
    lens = scene.camera.data
    lens.stereo.interocular_distance, lens.stereo.convergence_distance = 0.8, 5.0
    scene.mrpnn.depth_samples = 1
    return scene


def views(addon):
    return {view.name: view.camera for view in read(addon).views}


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


@pytest.mark.parametrize("projection", ["PERSP", "ORTHO"])
def test_each_eye_is_where_blender_has_it(addon, stereo, projection):
    """A camera with the matrix and the shift that Blender tells render engines."""
    camera, told = stereo.camera, {}
    camera.data.type, camera.data.shift_x, camera.scale = projection, 0.1, (2.0, 2.0, 2.0)

    class Engine(bpy.types.RenderEngine):
        bl_idname = "MRPNN_EYES"
        bl_label = "Eyes"

        def render(self, depsgraph):
            for name in EYES:
                self.active_view_set(name)
                evaluated = depsgraph.scene.camera.evaluated_get(depsgraph)
                told[name] = (
                    np.array(self.camera_model_matrix(evaluated, use_spherical_stereo=False)),
                    self.camera_shift_x(evaluated, use_spherical_stereo=False),
                )

    bpy.utils.register_class(Engine)
    try:
        for mode, pivot, size in itertools.product(
            ("OFFAXIS", "PARALLEL", "TOE"), ("LEFT", "RIGHT", "CENTER"), ((24, 16), (16, 24))
        ):
            camera.data.stereo.convergence_mode, camera.data.stereo.pivot = mode, pivot
            stereo.render.resolution_x, stereo.render.resolution_y = size
            stereo.render.engine = Engine.bl_idname
            bpy.ops.render.render()
            found = views(addon)
            assert list(found) == list(EYES)
            for name in EYES:
                other = camera.copy()
                other.data = camera.data.copy()
                stereo.collection.objects.link(other)
                other.matrix_world, other.data.shift_x = Matrix(told[name][0].tolist()), told[name][1]
                stereo.camera, stereo.render.use_multiview = other, False
                bpy.context.view_layer.update()
                expected = addon.mrpnn_addon.objects.camera.read_camera(blender_scenes.depsgraph())[0]
                np.testing.assert_allclose(found[name].world_matrix, expected.world_matrix, atol=1e-5)
                np.testing.assert_allclose(found[name].shift, expected.shift, atol=1e-5)
                stereo.camera, stereo.render.use_multiview = camera, True
                bpy.data.objects.remove(other)
    finally:
        bpy.utils.unregister_class(Engine)


def rendered_views(scene, folder):
    """Each view of a picture that the scene's engine renders, float32 (H, W, 4)."""
    settings = scene.render.image_settings
    scene.render.film_transparent = True
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"
    settings.views_format = "INDIVIDUAL"
    scene.render.filepath = str(folder / f"{scene.render.engine}.exr")
    bpy.ops.render.render(write_still=True)
    found = {}
    for view in scene.render.views:
        path = folder / f"{scene.render.engine}{view.file_suffix}.exr"
        if path.exists():
            found[view.name] = addon_image(path)
            path.unlink()
    return found


def addon_image(path):
    named = channels(path)
    return np.stack([named[letter] for letter in "RGBA"], axis=-1).astype(np.float32)


@pytest.mark.parametrize("kind", ["off-axis", "toe-in", "panorama", "spherical", "merged", "cameras"])
def test_each_view_is_that_of_cycles(addon, stereo, tmp_path, kind):
    lens = stereo.camera.data
    stereo.objects["Cloud"].data.materials[0].node_tree.nodes["Principled Volume"].inputs["Color"].default_value = (
        *(0.0, 0.0, 0.0),
        1.0,
    )
    if kind == "toe-in":
        lens.stereo.convergence_mode, lens.stereo.pivot = "TOE", "LEFT"
    elif kind == "cameras":
        stereo.render.views_format = "MULTIVIEW"
        stereo.camera.name = "Shot_L"
        other = stereo.camera.copy()
        other.name, other.location.x = "Shot_R", 1.4
        stereo.collection.objects.link(other)
    elif kind != "off-axis":
        lens.type, settings = "PANO", lens if hasattr(lens, "panorama_type") else lens.cycles
        settings.panorama_type = "EQUIRECTANGULAR"
        settings.longitude_min, settings.longitude_max, settings.latitude_min, settings.latitude_max = (
            -0.5,
            0.5,
            -0.4,
            0.4,
        )
        lens.stereo.use_spherical_stereo = kind != "panorama"
        lens.stereo.use_pole_merge = kind == "merged"
        lens.stereo.pole_merge_angle_from, lens.stereo.pole_merge_angle_to = 0.05, 0.25
    stereo.render.engine = "MRPNN"
    ours = rendered_views(stereo, tmp_path)
    blender_scenes.set_up_cycles(stereo, samples=64)
    expected = rendered_views(stereo, tmp_path)
    assert list(ours) == list(expected) == list(EYES)
    differ = np.abs(expected["left"][..., 3] - expected["right"][..., 3]).mean()
    for name in EYES:
        error = np.abs(ours[name][..., 3] - expected[name][..., 3]).mean()
        assert expected[name][..., 3].mean() > 0.01 and error < 0.25 * differ, (name, error, differ)


def test_a_composite_lays_each_eye_over_that_of_cycles(addon, stereo, tmp_path):
    """Also after another set of views was chosen."""
    stereo.render.engine = "MRPNN"
    layers = rendered_views(stereo, tmp_path)
    assert bpy.ops.mrpnn.composite(shadows=False) == {"FINISHED"}
    blender_scenes.set_up_cycles(stereo, samples=1)
    found = rendered_views(stereo, tmp_path)
    for name in EYES:
        np.testing.assert_allclose(found[name], layers[name], atol=2e-3)
    volumes = bpy.data.scenes["Scene MRPNN"]
    stereo.render.views.new("third").camera_suffix = "_C"
    stereo.render.views["right"].use = False
    bpy.context.view_layer.update()
    assert [(view.name, view.use, view.camera_suffix) for view in volumes.render.views] == [
        (view.name, view.use, view.camera_suffix) for view in stereo.render.views
    ]


def test_the_render_volumes_operator_has_an_image_for_each_eye(addon, stereo, tmp_path):
    blender_scenes.write_multilayer(stereo)
    stereo.render.image_settings.views_format = "MULTIVIEW"
    bpy.ops.mrpnn.render(filepath=str(tmp_path / "both.exr"))
    images = [np.array(bpy.data.images[f"MRPNN{suffix}"].pixels[:]) for suffix in ("_L", "_R")]
    assert all(image.max() > 0.0 for image in images) and np.abs(images[0] - images[1]).max() > 0.01
    found = channels(tmp_path / "both.exr")
    for name, image in zip(EYES, images):
        np.testing.assert_allclose(found[f"ViewLayer.Combined.{name}.A"][::-1].ravel(), image[3::4], atol=1e-6)
    assert header(tmp_path / "both.exr")["multiView"] == list(EYES)
    # Names and views as in the file that F12 writes.
    stereo.render.engine, stereo.render.film_transparent = "MRPNN", True
    stereo.render.filepath = str(tmp_path / "blender.exr")
    bpy.ops.render.render(write_still=True)
    blenders = channels(tmp_path / "blender.exr")
    assert {name for name in blenders if "Combined" in name} == {name for name in found if "Combined" in name}
    for name in blenders:
        np.testing.assert_allclose(found[name], blenders[name], atol=1e-4)


def test_the_command_writes_a_file_for_each_eye(addon, stereo, tmp_path):
    actions = addon.operators.command
    for name in ("one.exr", "one.png"):
        assert actions.main(["render", "--output", str(tmp_path / name)]) == 0
    assert {path.name for path in tmp_path.glob("one*")} == {"one_L.exr", "one_R.exr", "one_L.png", "one_R.png"}
    left, right = (channels(tmp_path / f"one_{side}.exr")["ViewLayer.Combined.A"] for side in "LR")
    # What lies behind the convergence plane is further left for the left eye.
    columns = np.arange(left.shape[1])
    assert (left.sum(axis=0) * columns).sum() / left.sum() < (right.sum(axis=0) * columns).sum() / right.sum() - 0.2
    stereo.render.views["right"].use = False
    finished = addon.mrpnn_addon.engine.render_job.render_scene(read(addon), Settings(depth_samples=1))
    assert [view.name for view, _ in finished.layers] == ["left"]
