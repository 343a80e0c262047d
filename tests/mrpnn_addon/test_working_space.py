# SPDX-License-Identifier: GPL-3.0-or-later
"""Colours where scene linear is not Rec. 709: the tests of this file, in a process whose configuration says ACEScg."""

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Color

from tests.support import blender_scenes, glowing_plane
from tests.support.glowing_plane import add, evaluated, rendered

HERE = Path(__file__)
CONFIGURATION = Path(bpy.utils.system_resource("DATAFILES")) / "colormanagement"


@pytest.mark.slow
def test_all_of_them_in_acescg(tmp_path):
    text = (CONFIGURATION / "config.ocio").read_text()
    text = re.sub(r"(?m)^  (scene_linear|rendering): .*", r"  \1: ACEScg", text)
    folders = re.search(r'(?m)^search_path: "?([^"\n]*)"?', text).group(1).split(":")
    paths = "".join(f"  - {CONFIGURATION / folder}\n" for folder in folders)
    configuration = tmp_path / "config.ocio"
    configuration.write_text(re.sub(r"(?m)^search_path: .*\n", lambda _: f"search_path:\n{paths}", text))
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(HERE), "-k", "not acescg"]
    environment = os.environ | {"OCIO": str(configuration)}
    done = subprocess.run(command, env=environment, cwd=HERE.parents[2], capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-1000:]
    assert "5 passed" in done.stdout


def test_the_configuration_counts():
    red = Color((1.0, 0.0, 0.0)).from_rec709_linear_to_scene_linear()
    assert (red.r < 0.7) == ("OCIO" in os.environ)


def test_blackbodies_and_grey(addon, scene, tmp_path):
    """The Blackbody node, and RGB to BW beside a colour that is linked to a number."""
    tree, emission, _ = glowing_plane.make(scene)
    body = add(tree, "Blackbody")
    tree.links.new(body.outputs[0], emission.inputs["Color"])
    for kelvin in (1000.0, 3000.0, 9000.0):
        body.inputs[0].default_value = kelvin
        np.testing.assert_allclose(evaluated(emission)[0], rendered(scene, tmp_path)[0], atol=0.01)
    colour, grey, number = add(tree, "RGB"), add(tree, "RGBToBW"), add(tree, "Math", operation="ADD")
    colour.outputs[0].default_value = 1.2, 2.6, 0.4, 1.0
    tree.links.new(colour.outputs[0], grey.inputs[0])
    tree.links.new(colour.outputs[0], number.inputs[0])
    tree.links.new(grey.outputs[0], number.inputs[1])
    tree.links.new(number.outputs[0], emission.inputs["Color"])
    np.testing.assert_allclose(evaluated(emission)[0], rendered(scene, tmp_path)[0], rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("floats", [False, True])
def test_images(addon, scene, tmp_path, floats):
    """Of bytes in each colour space that is read, and of floats."""
    tree, emission, coordinates = glowing_plane.make(scene)
    texture = add(tree, "TexImage")
    tree.links.new(coordinates, texture.inputs[0])
    tree.links.new(texture.outputs[0], emission.inputs["Color"])
    world = scene.world.node_tree
    around = world.nodes.new("ShaderNodeTexEnvironment")
    world.links.new(around.outputs[0], world.nodes["Background"].inputs["Color"])
    world.nodes["Background"].inputs["Strength"].default_value = 1.0
    for space in ("sRGB", "Linear Rec.709", "Non-Color"):
        image = bpy.data.images.new("Plain", 4, 4, float_buffer=floats)
        image.colorspace_settings.name = space
        image.pixels.foreach_set(np.tile(np.float32([0.2, 0.5, 0.8, 1.0]), 16))
        image.pack()
        texture.image = around.image = image
        expected = rendered(scene, tmp_path)[0]
        np.testing.assert_allclose(evaluated(emission)[0], expected, rtol=2e-3)
        light = addon.mrpnn_addon.world.lighting.read_world(blender_scenes.depsgraph())[1][0]
        np.testing.assert_allclose(light.radiance.mean(axis=(0, 1)), expected, rtol=2e-3)


def test_lamps_flames_and_pictures_of_worlds(addon, scene, tmp_path):
    """A lamp's temperature, Principled Volume's blackbody, and a World that Cycles renders in its own process."""
    lamp = blender_scenes.add_sun(scene).data
    lamp.use_temperature, lamp.temperature = True, 2500.0
    body = addon.mrpnn_addon.nodes.emission.blackbody_colour(np.array([[2500.0]]))[0]
    blender_scenes.add_volume(
        scene,
        blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 1.0)),
        Density=0.001,
        Blackbody_Intensity=1.0,
        Temperature=2500.0,
    )
    blender_scenes.add_camera(scene, ortho_scale=0.3)
    scene.render.resolution_x = scene.render.resolution_y = 4
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    np.testing.assert_allclose(
        described.suns[0].irradiance / described.suns[0].irradiance[1], body / body[1], rtol=0.01
    )
    lamp.energy = 0.0
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=16)[..., :3].mean(axis=(0, 1))
    scene.render.engine = "MRPNN"
    seen = blender_scenes.rendered(scene, tmp_path)[..., :3].mean(axis=(0, 1))
    np.testing.assert_allclose(seen, expected, rtol=0.02)
    tree = scene.world.node_tree
    checker = tree.nodes.new("ShaderNodeTexChecker")
    for socket in checker.inputs[1:3]:
        socket.default_value = 0.2, 0.5, 0.8, 1.0
    tree.links.new(checker.outputs[0], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = 1.0
    picture = addon.mrpnn_addon.world.picture.world_picture(
        scene.world.evaluated_get(blender_scenes.depsgraph()), scene
    )
    np.testing.assert_allclose(picture.sky.mean(axis=(0, 1)), (0.2, 0.5, 0.8), rtol=1e-3)
