# SPDX-License-Identifier: GPL-3.0-or-later
"""Light groups: a pass for each, by Cycles' names."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes
from tests.support.exr_files import channels


def test_each_light_group_has_a_pass_and_all_light_is_their_sum(addon, scene, tmp_path):
    scene.render.resolution_x, scene.render.resolution_y = 24, 16
    scene.mrpnn.depth_samples = 2
    scene.render.engine, scene.render.film_transparent = "MRPNN", True
    blender_scenes.write_multilayer(scene)
    blender_scenes.cloud_scene(scene, tmp_path)
    lamp = bpy.data.lights.new("Lamp", "POINT")
    lamp.energy = 60.0
    shown = blender_scenes.add_object(scene, "Lamp", lamp)
    shown.location = (1.5, -1.0, 1.0)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.1
    for name in ("key", "fill", "none"):
        scene.view_layers[0].lightgroups.add(name=name)
    bpy.data.objects["Sun"].lightgroup, shown.lightgroup = "key", "fill"
    scene.render.filepath = str(tmp_path / "groups.exr")
    bpy.ops.render.render(write_still=True)
    found = channels(tmp_path / "groups.exr")

    def colour(name):
        return np.stack([found[f"ViewLayer.{name}.{c}"] for c in "RGB"], axis=-1)

    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    alone = {
        name: addon.inference.render(described.volumes, lights, described.camera, scene.mrpnn.settings()).rgb
        for name, lights in (("key", described.suns), ("fill", described.lamps), ("", described.environments))
    }
    for name in ("key", "fill"):
        assert alone[name].max() > 0.0
        np.testing.assert_allclose(colour(f"Combined_{name}"), alone[name], atol=1e-4 * alone[name].max())
    assert not colour("Combined_none").any()
    whole = sum(alone.values())
    np.testing.assert_allclose(colour("Combined"), whole, atol=1e-4 * whole.max())
