# SPDX-License-Identifier: GPL-3.0-or-later
"""The preview of Rendered shading: its camera, its refinement and its end. Drawing needs a window."""

import threading
import time
from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import RenderCache, Settings, render
from inference.scene.optimizations import ALL
from tests.support import blender_scenes


@pytest.fixture
def cloud(scene, tmp_path):
    scene.render.resolution_x, scene.render.resolution_y = 64, 48
    return blender_scenes.cloud_scene(scene, tmp_path)


def described(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_looking_through_the_camera_is_the_renders_view(addon, scene, cloud, kind):
    camera = scene.camera
    camera.data.type, camera.data.ortho_scale, camera.data.shift_x = kind, 4.0, 0.1
    camera.rotation_euler = (0.1, 0.2, 0.3)
    description = described(addon)
    seen = addon.mrpnn_addon.engine.viewport.viewport_camera(
        camera.matrix_world.inverted(),
        camera.calc_matrix_camera(blender_scenes.depsgraph(), x=64, y=48),
        kind == "PERSP",
        (64, 48),
        clip_end=100.0,
    )
    settings = Settings(depth_samples=1)
    found, expected = (
        render(description.volumes, description.suns, view, settings).alpha for view in (seen, description.camera)
    )
    np.testing.assert_allclose(found, expected, atol=2e-4)
    assert expected.max() > 0.3


@pytest.mark.parametrize("kind", ["PERSP", pytest.param("ORTHO", marks=pytest.mark.slow)])
def test_a_region_of_the_view_is_cut_out_of_the_whole(addon, scene, cloud, kind):
    """Of any position and shape, as a render region is."""
    camera = scene.camera
    camera.data.type, camera.data.ortho_scale, camera.data.shift_x = kind, 4.0, 0.1
    description = described(addon)
    view = (
        camera.matrix_world.inverted(),
        camera.calc_matrix_camera(blender_scenes.depsgraph(), x=64, y=48),
        kind == "PERSP",
        (64, 48),
    )
    make = addon.mrpnn_addon.engine.viewport.viewport_camera
    # Pixels at the region's border have no neighbours outside it to interpolate from.
    settings = Settings(depth_samples=1, optimizations=ALL - {"shared_pixels"})
    whole, part = (
        render(description.volumes, description.suns, make(*view, clip_end=100.0, part=part), settings).alpha
        for part in ((0.0, 0.0, 1.0, 1.0), (16 / 64, 6 / 48, 48 / 64, 40 / 48))
    )
    np.testing.assert_allclose(part, whole[48 - 40 : 48 - 6, 16:48], atol=2e-4)
    assert part.max() > 0.3


def prepared(addon):
    return addon.mrpnn_addon.engine.preview.Prepared(RenderCache())


def pictures(preview):
    """Every picture of the preview, by number."""
    found = {}
    while not preview.done:
        if preview.picture is not None:
            found[preview.number] = preview.picture
        time.sleep(0.002)
    return {**found, preview.number: preview.picture}


@pytest.mark.slow
def test_the_preview_refines_to_the_final_render(addon, scene, cloud):
    description = described(addon)
    large = replace(description.camera, resolution=(160, 120))
    settings, shared = Settings(depth_samples=3), prepared(addon)
    first = pictures(addon.mrpnn_addon.engine.preview.Preview(description, large, settings, shared))
    shapes = [picture.shape for _, picture in sorted(first.items())]
    assert shapes == sorted(shapes) and shapes[0] == (40, 53, 4) and max(first) == 4
    layer = render(description.volumes, description.suns, large, settings)
    np.testing.assert_array_equal(first[4][::-1, :, :3], layer.rgb)
    # The next view finds all fields in the cache, and begins with multiple scattering.
    turned = replace(large, fov=0.5)
    second = pictures(addon.mrpnn_addon.engine.preview.Preview(description, turned, settings, shared))
    assert max(second) == 2 and second[1].shape == (40, 53, 4)
    layer = render(description.volumes, description.suns, turned, settings)
    np.testing.assert_array_equal(second[2][::-1, :, :3], layer.rgb)
    rough = render(
        description.volumes,
        description.suns,
        replace(turned, resolution=(53, 40)),
        Settings(depth_samples=1, detail_width=turned.resolution[0]),
    )
    np.testing.assert_array_equal(second[1][::-1, :, :3], rough.rgb)
    # In large regions there is a picture in between.
    wide = replace(turned, resolution=(1920, 1080))
    found = addon.mrpnn_addon.engine.preview.steps(description, wide, settings, shared)
    # Rough pictures share the light of the last one, which is resolved for its pixels.
    assert {step.settings.detail_width or step.size[0] for step in found} == {1920}
    sizes = [step.size for step in found]
    assert len(sizes) == 3 and sizes == sorted(sizes) and sizes[-1] == (1920, 1080)


def test_viewport_pixel_size_makes_pictures_coarser(addon, scene):
    """As in Cycles; AUTO is 2 on screens of many pixels per inch alone."""
    region = addon.mrpnn_addon.engine.viewport_region
    assert scene.render.preview_pixel_size == "AUTO"
    found = []
    for size in ("AUTO", "1", "2", "4", "8"):
        scene.render.preview_pixel_size = size
        found.append(region.coarser((1001, 7), region.pixel_size(scene)))
    dense = bpy.context.preferences.system.pixel_size > 1.5
    assert found == [(500, 4) if dense else (1001, 7), (1001, 7), (500, 4), (250, 2), (125, 1)]


@pytest.mark.slow
def test_a_changed_scene_is_shown_as_changed(addon, scene, cloud):
    """Sun, position, density, colour and anisotropy, one after another, with one render cache."""
    settings, shared = Settings(depth_samples=1), prepared(addon)
    sun = next(item for item in scene.objects if item.type == "LIGHT")
    node = cloud.data.materials[0].node_tree.nodes["Principled Volume"]

    def turn():
        sun.rotation_euler = (1.0, 0.4, 0.0)

    def move():
        cloud.location.x = 0.3

    def thicken():
        cloud.scale = (1.0, 1.0, 1.4)

    def second():
        blender_scenes.add_sun(scene, "Second", rotation=(0.3, 0.9, 0.0))

    def shade():
        node.inputs["Color"].default_value = (0.9, 0.6, 0.3, 1.0)
        node.inputs["Anisotropy"].default_value = 0.6

    last = None
    for change in (lambda: None, turn, move, thicken, second, shade):
        change()
        description = described(addon)
        found = pictures(addon.mrpnn_addon.engine.preview.Preview(description, description.camera, settings, shared))
        layer = render(description.volumes, description.suns, description.camera, settings)
        np.testing.assert_array_equal(found[max(found)][::-1, :, :3], layer.rgb)
        assert last is None or np.abs(layer.rgb - last).max() > 1e-4
        last = layer.rgb


@pytest.mark.parametrize(
    "pictures_before", [0, *(pytest.param(number, marks=pytest.mark.slow) for number in (1, 2, 3))]
)
def test_a_cancelled_preview_ends_its_thread(addon, scene, cloud, pictures_before):
    """At any stage of refinement, within a second of two threads."""
    description = described(addon)
    large = replace(description.camera, resolution=(512, 384))
    preview = addon.mrpnn_addon.engine.preview.Preview(description, large, Settings(depth_samples=256), prepared(addon))
    while preview.number < pictures_before:
        time.sleep(0.001)
    time.sleep(0.05)
    start = time.process_time()
    preview.stop()
    while [thread for thread in threading.enumerate() if thread.name == "mrpnn preview"]:
        time.sleep(0.01)
    assert time.process_time() - start < 2.0
    assert not preview.done and preview.number >= pictures_before


def test_a_scene_that_cannot_be_rendered_says_why(addon, scene, cloud):
    description = described(addon)
    preview = addon.mrpnn_addon.engine.preview.Preview(
        description, description.camera, Settings(memory_limit=1), prepared(addon)
    )
    while not preview.done:
        time.sleep(0.01)
    assert "limit" in preview.message and preview.picture is None
