# SPDX-License-Identifier: GPL-3.0-or-later
"""What counts as a change of the scene, after which panels and Live Light look at it anew."""

import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes


@pytest.fixture
def group(scene, tmp_path):
    """A collection of a cloud and a sun."""
    cloud = blender_scenes.cloud_scene(scene, tmp_path)
    group = bpy.data.collections.new("Group")
    scene.collection.children.link(group)
    for shown in (cloud, bpy.data.objects["Sun"]):
        scene.collection.objects.unlink(shown)
        group.objects.link(shown)
    blender_scenes.depsgraph().update()
    return group


def layer_of(scene):
    return scene.view_layers[0]


def collection_of(scene):
    return layer_of(scene).layer_collection.children["Group"]


def sun_of(scene):
    return scene.objects["Sun"]


# What has the setting, its name and another value of it.
SETTINGS = [
    (layer_of, "use_volumes", False),
    (layer_of, "use_solid", False),
    (layer_of, "use_strand", False),
    (layer_of, "use_sky", False),
    (collection_of, "exclude", True),
    (collection_of, "holdout", True),
    (collection_of, "indirect_only", True),
    (collection_of, "hide_viewport", True),
    (lambda scene: scene.render, "use_motion_blur", True),
    (lambda scene: scene.render, "motion_blur_shutter", 2.0),
    (lambda scene: scene.render, "use_multiview", True),
    (lambda scene: scene.render, "use_border", True),
    (lambda scene: scene.render, "use_crop_to_border", True),
    (lambda scene: scene.render, "pixel_aspect_x", 2.0),
    (lambda scene: scene.render, "resolution_percentage", 50),
    (lambda scene: scene.cycles, "film_exposure", 2.0),
    (sun_of, "hide_render", True),
    (sun_of, "is_holdout", True),
    (sun_of, "visible_volume_scatter", False),
    (lambda scene: sun_of(scene).data, "energy", 3.0),
]


@pytest.mark.parametrize("owner, name, value", SETTINGS, ids=[name for _, name, _ in SETTINGS])
def test_a_setting_that_a_render_depends_on_is_a_change(addon, scene, group, owner, name, value):
    state = addon.mrpnn_addon.scene.changes.scene_state
    before = state(scene)
    setattr(owner(scene), name, value)
    bpy.context.view_layer.update()
    assert state(scene) != before


@pytest.mark.parametrize("name", ["Sun", "Cloud"])
def test_hiding_an_object_is_a_change_and_selecting_it_is_none(addon, scene, group, name):
    state = addon.mrpnn_addon.scene.changes.scene_state
    before, shown = state(scene), scene.objects[name]
    shown.select_set(True)
    bpy.context.view_layer.objects.active = shown
    bpy.context.view_layer.update()
    assert state(scene) == before
    shown.hide_set(True)
    bpy.context.view_layer.update()
    assert state(scene) != before


def test_a_part_of_a_frame_is_a_change(addon, scene, group):
    state = addon.mrpnn_addon.scene.changes.scene_state
    scene.frame_set(3)
    before = state(scene)
    scene.frame_set(3, subframe=0.5)
    assert state(scene) != before
