# SPDX-License-Identifier: GPL-3.0-or-later
"""Light linking and ray visibility of lights: what they light is what they light in Cycles."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import Settings, render
from tests.support import blender_scenes


@pytest.fixture
def two(scene, tmp_path):
    """Two clouds side by side, a sun, and the collection that it is linked to."""
    scene.render.resolution_x, scene.render.resolution_y = 32, 16
    path = blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 1.0))
    found = []
    for name, place in (("Left", -1.0), ("Right", 1.0)):
        cloud, _ = blender_scenes.add_volume(scene, path, name, Density=4.0)
        cloud.location[0] = place
        found.append(cloud)
    sun, links = blender_scenes.add_sun(scene), bpy.data.collections.new("Links")
    blender_scenes.add_camera(scene, ortho_scale=4.0)
    sun.light_linking.receiver_collection = links
    return *found, sun, links


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


def nothing(links, left, right):
    """An empty collection."""


def included(links, left, right):
    links.objects.link(left)


def excluded(links, left, right):
    links.objects.link(left)
    links.collection_objects[0].light_linking.link_state = "EXCLUDE"


def within(links, left, right):
    child = bpy.data.collections.new("Within")
    child.objects.link(left)
    links.children.link(child)


def excluded_within(links, left, right):
    within(links, left, right)
    links.collection_children[0].light_linking.link_state = "EXCLUDE"


def both(links, left, right):
    """Included by a collection, and excluded."""
    within(links, left, right)
    excluded(links, left, right)


def nested(links, left, right):
    """States within a collection that is linked do not count."""
    within(links, left, right)
    child, deeper = links.children[0], bpy.data.collections.new("Deeper")
    deeper.objects.link(right)
    child.children.link(deeper)
    child.collection_objects[0].light_linking.link_state = "EXCLUDE"
    child.collection_children[0].light_linking.link_state = "EXCLUDE"


@pytest.mark.parametrize("link", [nothing, included, excluded, within, excluded_within, both, nested])
def test_lights_light_what_they_light_in_cycles(addon, scene, tmp_path, two, link):
    left, right, _, links = two
    link(links, left, right)
    described = read(addon)
    layer = render(described.volumes, described.lights, described.camera, Settings(multiple=False))
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=32)[..., :3]
    halves = [[half.mean() for half in np.split(image, 2, axis=1)] for image in (layer.rgb, expected)]
    assert not described.warnings
    # Few pixels and samples.
    assert halves[0] == pytest.approx(halves[1], rel=0.08)
    assert sum(half > 0.0 for half in halves[0]) == (2 if link in (nothing, nested) else 1)


@pytest.mark.parametrize("linked", ["Left", "Group"])
def test_instances_have_the_links_of_what_instances_them_or_their_own(addon, scene, tmp_path, two, linked):
    left, right, _, links = two
    bpy.data.objects.remove(right)
    group = bpy.data.collections.new("Group")
    group.objects.link(left)
    shown = blender_scenes.add_object(scene, "Group", None)
    shown.instance_type, shown.instance_collection, shown.location = "COLLECTION", group, (2.0, 0.0, 0.0)
    links.objects.link(bpy.data.objects[linked])
    described = read(addon)
    layer = render(described.volumes, described.lights, described.camera, Settings(multiple=False))
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=32)[..., :3]
    halves = [[half.mean() for half in np.split(image, 2, axis=1)] for image in (layer.rgb, expected)]
    # Few pixels and samples.
    assert halves[0] == pytest.approx(halves[1], rel=0.08)


def test_volumes_of_libraries_have_their_own_links_and_names(addon, scene, tmp_path, two):
    """A file may hold objects of the same name, each from its own library."""
    left, right, _, links = two
    links.objects.link(left)
    for name in ("first.blend", "second.blend"):
        bpy.data.libraries.write(str(tmp_path / name), {left})
        with bpy.data.libraries.load(str(tmp_path / name), link=True) as (_, loaded):
            loaded.objects = ["Left"]
        scene.collection.objects.link(loaded.objects[0])
    scene.collection.objects.unlink(right)
    described = read(addon)
    names = [volume.name for volume, _ in described.volumes]
    assert sorted(names) == ["Left", "Left [first.blend]", "Left [second.blend]"]
    assert [name for name in names if described.lights[0].lights(name)] == ["Left"]
    assert set(described.wanted.owners) == set(names)


def test_lights_hidden_from_volumes_light_the_ground(addon, scene, two):
    _, _, sun, links = two
    sun.light_linking.receiver_collection = None
    sun.visible_volume_scatter = False
    blender_scenes.add_sun(scene, "Other")
    described = read(addon)
    assert described.warnings == ['sun "Sun" lights nothing that is rendered (left out)']
    assert [light.name for light in described.lights] == ['sun "Other"']
    bpy.ops.mesh.primitive_plane_add(size=9.0, location=(0.0, 0.0, -1.0))
    (linked,) = [light for light in read(addon).lights if light.receivers is not None]
    assert linked.receivers == {'mesh object "Plane"'}
    sun.visible_diffuse = False
    assert len(read(addon).lights) == 1


def test_shadow_linking_is_named(addon, two):
    _, _, sun, links = two
    sun.light_linking.receiver_collection, sun.light_linking.blocker_collection = None, links
    (warning,) = read(addon).warnings
    assert 'sun "Sun" is shadowed by some objects only' in warning
