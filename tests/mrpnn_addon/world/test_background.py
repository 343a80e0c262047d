# SPDX-License-Identifier: GPL-3.0-or-later
"""The World behind the volumes, as Cycles shows it."""

import importlib
import math
import time
from dataclasses import replace

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import Cancelled
from tests.support import blender_scenes
from tests.support.exr_files import combined

SAMPLES = 64


@pytest.fixture
def veil(scene, tmp_path):
    """A scene whose only volume is too thin to be seen and to take light from the World."""
    cloud = blender_scenes.cloud_scene(scene, tmp_path, density=1e-7)
    scene.mrpnn.depth_samples = 1
    scene.world.cycles_visibility.scatter = False
    scene.render.resolution_x, scene.render.resolution_y = 48, 32
    scene.camera.rotation_euler = 1.3, 0.1, 0.4
    blender_scenes.set_up_cycles(scene, SAMPLES)
    # It is invisible to the camera, and takes seconds.
    scene.world.cycles.sampling_method = "NONE"
    return cloud


def feed(scene, kind, output=0):
    """Link a new node to the World's colour; gives the node."""
    tree = scene.world.node_tree
    node = tree.nodes.new(kind)
    tree.links.new(node.outputs[output], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = 1.0
    return node


def around(scene, width=256):
    """An environment image with stripes, rotated by a mapping."""
    image = bpy.data.images.new("Around", width, width // 2, float_buffer=True)
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(width // 2) + 0.5) / width * 2)
    colours = np.stack([0.2 + u, 0.3 + v, 0.6 + 0.5 * np.sin(24 * np.pi * u) * np.sin(20 * v), np.ones_like(u)], axis=2)
    image.pixels.foreach_set(colours.astype(np.float32).ravel())
    image.pack()
    texture, tree = feed(scene, "ShaderNodeTexEnvironment"), scene.world.node_tree
    texture.image = image
    mapping = tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Rotation"].default_value = 0.3, -0.2, 1.1
    tree.links.new(tree.nodes.new("ShaderNodeTexCoord").outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
    return image


def colour(scene):
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = 0.1, 0.4, 0.9, 1.0
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1.7


def gradient(scene):
    texture = feed(scene, "ShaderNodeTexGradient")
    tree = scene.world.node_tree
    ramp = tree.nodes.new("ShaderNodeValToRGB")
    ramp.color_ramp.elements[0].color, ramp.color_ramp.elements[1].color = (0.9, 0.2, 0.1, 1.0), (0.1, 0.3, 0.8, 1.0)
    tree.links.new(texture.outputs[0], ramp.inputs[0])
    tree.links.new(ramp.outputs[0], tree.nodes["Background"].inputs["Color"])


def window(scene):
    """Colours that follow the window coordinates, not the direction."""
    feed(scene, "ShaderNodeTexCoord", "Window")


def sky(scene):
    texture = feed(scene, "ShaderNodeTexSky")
    texture.sun_elevation, texture.sun_rotation, texture.sun_size = 0.1, 0.2, math.radians(4.0)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.1
    return texture


def sky_without_disc(scene):
    sky(scene).sun_disc = False


def sunwards(scene):
    """A lens through which the disc of `sky` is ten pixels across."""
    scene.camera.rotation_euler, scene.camera.data.angle = (math.pi / 2.0 + 0.1, 0.0, -0.2), math.radians(20.0)


def perspective(scene):
    scene.camera.data.shift_x, scene.camera.data.shift_y = 0.2, -0.1


def portrait(scene):
    """Taller than wide, so that Blender fits the sensor to the height, of tall pixels."""
    scene.render.resolution_x, scene.render.resolution_y = 32, 48
    scene.render.pixel_aspect_y = 1.3
    scene.camera.data.angle = 1.2


def orthographic(scene):
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 3.0


def equirectangular(scene):
    lens = scene.camera.data
    lens.type = "PANO"
    lens = lens if hasattr(lens, "panorama_type") else lens.cycles
    lens.panorama_type = "EQUIRECTANGULAR"
    lens.longitude_min, lens.longitude_max, lens.latitude_min = -2.0, 2.5, -0.8


def region(scene):
    perspective(scene)
    render = scene.render
    render.use_border = render.use_crop_to_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.21, 0.8, 0.13, 0.62


def shown(scene, path):
    """Combined of MRPNN and of Cycles without the volumes, float32 (H, W, 4)."""
    scene.render.engine, scene.render.film_transparent = "MRPNN", False
    blender_scenes.write_multilayer(scene)
    scene.render.filepath = str(path / "behind.exr")
    bpy.ops.render.render(write_still=True)
    found = combined(path / "behind.exr")
    scene.objects["Cloud"].hide_render = True
    scene.render.engine = "CYCLES"
    scene.render.filepath = str(path / "cycles.exr")
    bpy.ops.render.render(write_still=True)
    scene.objects["Cloud"].hide_render = False
    return found, combined(path / "cycles.exr")


@pytest.mark.parametrize(
    "world, view",
    [
        (colour, perspective),
        (around, orthographic),
        (window, region),
        (sky, sunwards),
        *(
            pytest.param(world, view, marks=pytest.mark.slow)
            for world, view in (
                (around, perspective),
                (around, portrait),
                (around, equirectangular),
                (around, region),
                (gradient, perspective),
                (gradient, orthographic),
                (window, perspective),
                (sky_without_disc, equirectangular),
            )
        ),
    ],
)
def test_the_background_equals_that_of_cycles(veil, scene, tmp_path, world, view):
    world(scene)
    view(scene)
    found, expected = shown(scene, tmp_path)
    assert found.shape == expected.shape and np.all(found[..., 3] == 1.0) and np.all(expected[..., 3] == 1.0)
    # Pixels of the horizon and of the disc's edge are as noisy as 16 samples are.
    error = np.abs(found - expected).max(axis=2) / expected[..., :3].mean()
    median, most = np.quantile(error, (0.5, 0.95))
    assert median < 0.01 and most < 0.05, (median, most)
    assert found[..., :3].mean(axis=(0, 1)) == pytest.approx(expected[..., :3].mean(axis=(0, 1)), rel=0.01)


def background(addon, scene):
    """Of the scene's camera, and the camera."""
    depsgraph = blender_scenes.depsgraph()
    camera, _ = addon.mrpnn_addon.objects.camera.read_camera(depsgraph)
    return addon.mrpnn_addon.scene.film.read_background(depsgraph, camera), camera


def mixed_by_light_path(scene):
    """Volumes are lit by red; the camera still sees the former colour."""
    tree = scene.world.node_tree
    mixed, path, red = (tree.nodes.new(f"ShaderNode{name}") for name in ("MixShader", "LightPath", "Background"))
    red.inputs["Color"].default_value = 1.0, 0.0, 0.0, 1.0
    tree.links.new(path.outputs["Is Camera Ray"], mixed.inputs[0])
    tree.links.new(red.outputs[0], mixed.inputs[1])
    tree.links.new(tree.nodes["Background"].outputs[0], mixed.inputs[2])
    tree.links.new(mixed.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])


@pytest.mark.parametrize(
    "world", [colour, *(pytest.param(world, marks=pytest.mark.slow) for world in (gradient, around))]
)
def test_the_camera_may_see_another_world_than_volumes_do(addon, veil, scene, tmp_path, world):
    world(scene)
    alone = background(addon, scene)[0].pixels()
    mixed_by_light_path(scene)
    found, expected = shown(scene, tmp_path)
    np.testing.assert_allclose(found[..., :3], alone, atol=2e-5)
    assert np.median(np.abs(found - expected)) < 0.005
    scene.world.cycles_visibility.scatter = True
    bpy.data.objects.remove(scene.objects["Sun"])
    lights = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph()).environments
    np.testing.assert_allclose(
        sum(light.fluence() for light in lights), [4.0 * math.pi, 0.0, 0.0], rtol=1e-3, atol=1e-6
    )


def test_a_world_hidden_from_the_camera_is_black(veil, scene, tmp_path):
    around(scene)
    scene.world.cycles_visibility.camera = False
    found, expected = shown(scene, tmp_path)
    np.testing.assert_allclose(found, expected, atol=1e-6)
    assert not found[..., :3].any() and np.all(found[..., 3] == 1.0)


def test_it_shows_through_a_cloud_by_alpha(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    scene.render.engine, scene.mrpnn.depth_samples = "MRPNN", 1
    scene.world.cycles_visibility.scatter = False
    gradient(scene)
    blender_scenes.write_multilayer(scene)
    images = []
    for transparent in (True, False):
        scene.render.film_transparent = transparent
        scene.render.filepath = str(tmp_path / f"{transparent}.exr")
        bpy.ops.render.render(write_still=True)
        images.append(combined(tmp_path / f"{transparent}.exr"))
    layer, image = images
    alpha, behind = layer[..., 3:], background(addon, scene)[0].pixels()
    assert 0.2 < alpha.max() and alpha.min() == 0.0
    np.testing.assert_allclose(image[..., :3], layer[..., :3] + (1.0 - alpha) * behind, rtol=1e-5, atol=1e-6)
    assert np.all(image[..., 3] == 1.0)


def test_regions_equal_those_of_the_whole_background(addon, veil, scene):
    around(scene)
    whole, _ = background(addon, scene)
    assert whole.pixels().shape == (32, 48, 3) and not whole.warnings
    np.testing.assert_array_equal(whole.pixels((5, 3, 20, 30)), whole.pixels()[3:30, 5:20])
    region(scene)
    scene.camera.data.shift_x = scene.camera.data.shift_y = 0.0
    part, camera = background(addon, scene)
    x0, y0, x1, y1 = camera.region
    assert np.median(np.abs(part.pixels() - whole.pixels()[y0:y1, x0:x1])) < 0.02
    np.testing.assert_array_equal(part.pixels((x0 + 2, y0 + 1, x1, y1)), part.pixels()[1:, 2:])
    scene.world.node_tree.links.clear()
    scene.world = bpy.data.worlds.new("Plain")
    plain, _ = background(addon, scene)
    assert plain.pixels((x0, y0, x1, y1)).shape == (y1 - y0, x1 - x0, 3)


def test_it_is_rendered_again_only_after_changes(addon, veil, scene):
    around(scene)
    first = background(addon, scene)[0].radiance
    scene.world.node_tree.nodes["Background"].location = 10.0, 20.0
    assert background(addon, scene)[0].radiance is first
    scene.camera.rotation_euler.z += 0.5
    turned = background(addon, scene)[0].radiance
    assert np.abs(turned - first).max() > 0.05
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 2.0
    np.testing.assert_allclose(background(addon, scene)[0].radiance, 2.0 * turned, rtol=1e-5)


def test_an_image_in_another_colour_space_is_another_world(addon, veil, scene):
    image = around(scene)
    image.colorspace_settings.name = "Non-Color"
    first = background(addon, scene)[0].radiance
    image.colorspace_settings.name = "sRGB"
    assert np.abs(background(addon, scene)[0].radiance - first).max() > 0.05


def test_a_world_that_cannot_be_shown_is_black_and_named(addon, veil, scene, tmp_path, monkeypatch):
    broken = tmp_path / "broken.py"
    broken.write_text("raise SystemExit('no Cycles here')")
    process = importlib.import_module("mrpnn.mrpnn_addon.world.process")
    gradient(scene)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.77
    with monkeypatch.context() as patched:
        patched.setattr(process, "WORKER", broken)
        found, _ = background(addon, scene)
    (warning,) = found.warnings
    assert not found.pixels().any() and 'World "World"' in warning and "no Cycles here" in warning
    # Unsaved edits of an image are not used.
    around(scene).pixels[0] = 3.0
    found, _ = background(addon, scene)
    (warning,) = found.warnings
    assert not found.pixels().any() and 'image "Around"' in warning and "save or pack" in warning


@pytest.mark.parametrize("view", [perspective, pytest.param(orthographic, marks=pytest.mark.slow)])
def test_a_viewport_looks_it_up_in_a_panorama_before_it_is_sharp(addon, veil, scene, view):
    """Within a redraw."""
    backdrop = importlib.import_module("mrpnn.mrpnn_addon.engine.backdrop")
    around(scene)
    view(scene)
    depsgraph = blender_scenes.depsgraph()
    camera, _ = addon.mrpnn_addon.objects.camera.read_camera(depsgraph)
    camera = replace(camera, resolution=(1600, 900))
    shown, watched = backdrop.Backdrop(lambda worker: watched.append(worker)), []
    shown.read(depsgraph)
    shown.update(camera)
    (first,) = watched
    first.wait()
    assert first.error is None and first.number >= 2 and not shown.status
    # A known panorama is there at once.
    shown.update(camera)
    assert watched == [first]
    start = time.process_time()
    shown.update(replace(camera, fov=camera.fov * 1.0001))
    assert time.process_time() - start < 0.1
    rough, sharp = watched[1].picture, first.picture
    shown.stop()
    assert rough.shape[1] == 320 and sharp.shape == (900, 1600, 4) and np.all(sharp[..., 3] == 1.0)
    # A pixel of the coarse picture against the mean of the pixels that it covers.
    blocks = sharp.reshape(180, 5, 320, 5, 4).mean(axis=(1, 3))
    assert np.abs(rough - blocks).mean() < 0.01 * sharp[..., :3].mean()
    scene.render.film_transparent = True
    shown.read(blender_scenes.depsgraph())
    shown.update(camera)
    assert len(watched) == 2 and not shown.status


def test_cancelling_ends_the_process(addon, veil, scene):
    """Within a second, however many pixels there are."""
    gradient(scene)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.55
    depsgraph = blender_scenes.depsgraph()
    scene.render.resolution_x = scene.render.resolution_y = 4096
    camera, _ = addon.mrpnn_addon.objects.camera.read_camera(depsgraph)
    asked = []

    def check():
        asked.append(time.monotonic())
        if asked[-1] - asked[0] > 3.0:
            raise Cancelled()

    with pytest.raises(Cancelled):
        addon.mrpnn_addon.scene.film.read_background(depsgraph, camera, check)
    assert time.monotonic() - asked[-1] < 1.0
    assert not addon.mrpnn_addon.scene.film.world_behind(depsgraph)._process._running
