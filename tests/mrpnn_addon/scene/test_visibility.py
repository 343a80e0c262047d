# SPDX-License-Identifier: GPL-3.0-or-later
"""Indirect-only collections and ray visibility: volumes left out or settings ignored, and named; holdouts."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import SceneError, Settings, render
from tests.support import blender_scenes


@pytest.fixture
def two(scene, tmp_path):
    """Two clouds, the second in a collection of its own; gives the second and its layer collection."""
    scene.render.resolution_x, scene.render.resolution_y = 16, 12
    blender_scenes.cloud_scene(scene, tmp_path)
    second, _ = blender_scenes.add_volume(
        scene, blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 1.0)), "Second"
    )
    collection = bpy.data.collections.new("Apart")
    scene.collection.children.link(collection)
    collection.objects.link(second)
    scene.collection.objects.unlink(second)
    return second, scene.view_layers[0].layer_collection.children["Apart"]


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


@pytest.mark.parametrize(
    "how, word",
    [
        ("indirect only", "indirect-only"),
        ("camera", "hidden from the camera"),
    ],
)
def test_a_volume_hidden_from_the_camera_is_left_out_by_name(addon, two, how, word):
    second, layer = two
    assert len(read(addon).volumes) == 2 and not read(addon).warnings[1:]
    if how == "indirect only":
        layer.indirect_only = True
    else:
        second.visible_camera = False
    found = read(addon)
    assert [volume.name for volume, _ in found.volumes] == ["Cloud"]
    (warning,) = [text for text in found.warnings if '"Second"' in text]
    assert word in warning and warning.endswith("(left out)")
    assert addon.mrpnn_addon.status.forecast.forecast(blender_scenes.depsgraph()).volumes == 1


@pytest.mark.parametrize("name", ["Second", "Sun"])
def test_what_the_eye_of_a_collection_hides_is_rendered_as_by_f12(addon, scene, two, name):
    """Blender evaluates it all the same."""
    _, layer = two
    layer.collection.objects.link(scene.objects["Sun"])
    scene.collection.objects.unlink(scene.objects["Sun"])
    before = read(addon)
    layer.hide_viewport = True
    found = read(addon)
    assert [volume.name for volume, _ in found.volumes] == [volume.name for volume, _ in before.volumes]
    assert [light.name for light in found.lights] == [light.name for light in before.lights]
    assert found.warnings == before.warnings
    # What its own eye hides is not, though another object instances it.
    scene.objects[name].hide_set(True)
    shown = blender_scenes.add_object(scene, "Instance", None)
    shown.instance_type, shown.instance_collection = "COLLECTION", layer.collection
    with pytest.raises(ValueError, match=f'"{name}" is hidden in the viewport'):
        read(addon)


def instanced(scene, how):
    """The fog of the scene, shown by another object; gives both."""
    bpy.ops.mesh.primitive_cube_add(size=1.0)
    fog = bpy.context.object
    fog.name = "Fog"
    blender_scenes.add_fog(fog.data, "Fog", "ShaderNodeVolumePrincipled", Density=1.0)
    mesh = bpy.data.meshes.new("Host")
    mesh.from_pydata([(0, 0, 0), (0.1, 0, 0), (0, 0.1, 0)], [], [(0, 1, 2)] if how == "particles" else [])
    host = blender_scenes.add_object(scene, "Host", None if how == "collection" else mesh)
    host.show_instancer_for_render, fog.hide_render = False, how in ("nodes", "particles")
    if how == "collection":
        host.instance_type, host.instance_collection = "COLLECTION", bpy.data.collections.new("Fogs")
        host.instance_collection.objects.link(fog)
        scene.collection.objects.unlink(fog)
    elif how == "vertices":
        fog.parent, host.instance_type = host, "VERTS"
    elif how == "particles":
        host.modifiers.new("Particles", "PARTICLE_SYSTEM")
        particles = host.particle_systems[0].settings
        particles.type, particles.count, particles.use_advanced_hair = "HAIR", 1, True
        particles.render_type, particles.instance_object = "OBJECT", fog
        particles.hair_length = particles.particle_size = 1.0
    else:
        tree = bpy.data.node_groups.new("Fogs", "GeometryNodeTree")
        tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
        node = tree.nodes.new("GeometryNodeObjectInfo")
        node.inputs[0].default_value, node.inputs["As Instance"].default_value = fog, True
        tree.links.new(node.outputs["Geometry"], tree.nodes.new("NodeGroupOutput").inputs[0])
        host.modifiers.new("Nodes", "NODES").node_group = tree
    return fog, host


@pytest.mark.parametrize("how", ["collection", "vertices", "particles", "nodes"])
def test_the_visibility_of_an_instancer_is_that_of_its_instances(addon, scene, tmp_path, how):
    scene.render.resolution_x = scene.render.resolution_y = 5
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene, ortho_scale=3.0)
    fog, host = instanced(scene, how)
    assert len(read(addon).volumes) == 3 if how == "vertices" else 1
    host.visible_shadow = host.visible_volume_scatter = False
    said = " ".join(read(addon).warnings)
    assert '"Fog in Host" is hidden from shadow rays' in said and "from volume scatter rays" in said
    for owner, setting, reason in [
        (host, "visible_camera", "hidden from the camera"),
        (host, "is_shadow_catcher", "shadow catcher"),
        (fog, "is_shadow_catcher", "shadow catcher"),
    ]:
        before = getattr(owner, setting)
        setattr(owner, setting, not before)
        with pytest.raises(SceneError, match=f'"Fog in Host" is .*{reason}'):
            read(addon)
        assert not blender_scenes.render_cycles(scene, tmp_path, samples=4)[..., 3].any()
        setattr(owner, setting, before)
    assert blender_scenes.render_cycles(scene, tmp_path, samples=4)[..., 3].max() > 0.3


@pytest.mark.parametrize("how", ["collection", "vertices", "particles", "nodes", "linked"])
def test_instances_arrive_as_one_array(addon, scene, tmp_path, how):
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene, ortho_scale=3.0)
    fog, host = instanced(scene, "collection" if how == "linked" else how)
    if how == "linked":
        for x in (3.0, 6.0):
            blender_scenes.add_object(scene, "Twin", fog.data).location.x = x
    elif how == "particles":
        host.particle_systems[0].settings.count = 3
    elif how != "vertices":
        twin = host.copy()
        twin.location.x = 3.0
        scene.collection.objects.link(twin)
    volumes = [volume for volume, _ in read(addon).volumes]
    assert len(volumes) == (2 if how in ("collection", "nodes") else 3)
    assert len({volume.world_from_index.tobytes() for volume in volumes}) == len(volumes)
    assert all(volume.density is volumes[0].density for volume in volumes)


@pytest.mark.parametrize("light", ["lamp", "mesh"])
def test_an_instancer_that_volumes_do_not_see_gives_them_no_light(addon, scene, tmp_path, light):
    blender_scenes.cloud_scene(scene, tmp_path)
    if light == "lamp":
        lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    else:
        mesh = bpy.data.meshes.new("Lamp")
        mesh.from_pydata([(4, 0, 0), (4, 1, 0), (4, 0, 1)], [], [(0, 1, 2)])
        glow = bpy.data.materials.new("Glow")
        glow.use_nodes = True
        glow.node_tree.nodes.clear()
        tree = glow.node_tree
        tree.links.new(
            tree.nodes.new("ShaderNodeEmission").outputs[0],
            tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"],
        )
        mesh.materials.append(glow)
        lamp = bpy.data.objects.new("Lamp", mesh)
    host = blender_scenes.add_object(scene, "Host", None)
    host.instance_type, host.instance_collection = "COLLECTION", bpy.data.collections.new("Lamps")
    host.instance_collection.objects.link(lamp)

    def shining():
        found = read(addon)
        return len(found.lamps) + sum(bool(mesh.colour.emission.any()) for mesh in found.opaque)

    assert shining() == 1
    host.visible_volume_scatter = False
    assert shining() == 0


def test_with_nothing_left_every_volume_is_named_with_its_reason(addon, scene, two):
    second, layer = two
    layer.indirect_only = True
    scene.objects["Cloud"].visible_camera = False
    with pytest.raises(SceneError) as problem:
        read(addon)
    assert '"Cloud" is hidden from the camera' in str(problem.value)
    assert '"Second" is in an indirect-only collection' in str(problem.value)


@pytest.mark.parametrize("how", ["layer", "object"])
def test_a_volume_that_is_a_holdout_leaves_a_hole(addon, scene, tmp_path, how):
    """Black smoke in front takes as much light from the cloud; what it covers is none of the layer's."""
    scene.render.resolution_x = scene.render.resolution_y = 16
    blender_scenes.cloud_scene(scene, tmp_path)
    path = blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 1.5))
    black, _ = blender_scenes.add_volume(scene, path, "Black", Density=3.0, Color=(0.0, 0.0, 0.0, 1.0))
    black.location = 0.3, 0.2, 2.0
    held = bpy.data.collections.new("Held")
    scene.collection.children.link(held)
    held.objects.link(black)
    scene.collection.objects.unlink(black)
    settings = Settings(depth_samples=8, outputs=frozenset({"deep", "coverage"}))

    def layer():
        found = read(addon)
        return found, render(found.volumes, found.lights, found.camera, settings)

    _, smoke = layer()
    other = scene.view_layers.new("Other")
    if how == "layer":
        scene.view_layers[0].layer_collection.children["Held"].holdout = True
    else:
        black.is_holdout = True
    described, hole = layer()
    assert not [text for text in described.warnings if "Black" in text and "overlap" not in text]
    np.testing.assert_allclose(hole.rgb, smoke.rgb, atol=0.02 * smoke.rgb.max())
    of_cloud = smoke.coverage.volume == list(smoke.coverage.names).index("Cloud")
    expected = np.bincount(smoke.coverage.pixel[of_cloud], smoke.coverage.share[of_cloud], 256).reshape(16, 16)
    np.testing.assert_allclose(hole.alpha, expected, atol=1e-3)
    assert hole.alpha.sum() < 0.9 * smoke.alpha.sum()
    np.testing.assert_allclose(hole.deep.flat()[..., 3], hole.alpha, atol=1e-4)
    assert {hole.coverage.names[number] for number in set(hole.coverage.volume.tolist())} == {"Cloud"}
    if how == "layer":
        with bpy.context.temp_override(view_layer=other):
            assert not any(medium.holdout for _, medium in read(addon).volumes)


@pytest.mark.parametrize("how", ["object", "shader"])
def test_a_mesh_that_is_a_holdout_covers_whatever_its_shader(addon, scene, tmp_path, how):
    blender_scenes.cloud_scene(scene, tmp_path)
    bpy.ops.mesh.primitive_plane_add(size=9.0, location=(0.0, 0.0, 3.0))
    plane = bpy.context.object
    material = bpy.data.materials.new("Through")
    material.use_nodes = True
    tree = material.node_tree
    kind = "ShaderNodeHoldout" if how == "shader" else "ShaderNodeBsdfTransparent"
    tree.links.new(tree.nodes.new(kind).outputs[0], tree.get_output_node("ALL").inputs["Surface"])
    plane.data.materials.append(material)
    plane.is_holdout = how == "object"
    found = read(addon)
    assert len(found.opaque) == 1
    layer = render(found.volumes, found.lights, found.camera, Settings(depth_samples=1), surfaces=found.surfaces)
    assert not layer.alpha.any()


def test_what_one_view_layer_hides_is_rendered_in_another(addon, scene, two):
    _, layer = two
    layer.indirect_only = True
    other = scene.view_layers.new("Other")
    with bpy.context.temp_override(view_layer=other):
        found = addon.mrpnn_addon.scene.reader.read_scene(bpy.context.evaluated_depsgraph_get())
    assert len(found.volumes) == 2


def test_ignored_settings_are_named(addon, scene, two):
    second, _ = two
    before = read(addon)
    second.visible_shadow = second.visible_volume_scatter = False
    scene.view_layers[0].material_override = bpy.data.materials.new("Clay")
    found = read(addon)
    said = set(found.warnings) - set(before.warnings)
    words = {"shadow rays", "volume scatter rays", "overrides materials"}
    assert {word for word in words if any(word in text for text in said)} == words
    assert len(said) == 3
    np.testing.assert_array_equal(found.volumes[1][0].density, before.volumes[1][0].density)


@pytest.mark.slow
def test_the_view_layers_filter_hides_what_it_hides_in_cycles(addon, scene, tmp_path):
    """A cloud on the left, fog in a mesh on the right, a World that lights both and stands behind them."""
    cloud = blender_scenes.cloud_scene(scene, tmp_path)
    cloud.location.x = -1.0
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(1.2, 0.0, 0.0))
    blender_scenes.add_fog(bpy.context.object.data, "Box", "ShaderNodeVolumeScatter", Density=2.0)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.5
    scene.objects["Sun"].data.energy = 0.3
    scene.render.resolution_x, scene.render.resolution_y = 16, 8
    layer = scene.view_layers[0]
    for hidden in (None, "use_volumes", "use_solid", "use_sky"):
        layer.use_volumes = layer.use_solid = layer.use_sky = True
        if hidden:
            setattr(layer, hidden, False)
        blender_scenes.set_up_cycles(scene, samples=16, bounces=4)
        pictures = {}
        for engine in ("CYCLES", "MRPNN"):
            scene.render.engine = engine
            pictures[engine] = blender_scenes.rendered(scene, tmp_path, transparent=hidden != "use_sky")
        for half in (slice(0, 8), slice(8, 16)):
            expected, found = (picture[:, half].mean(axis=(0, 1)) for picture in pictures.values())
            np.testing.assert_allclose(found, expected, rtol=0.25, atol=1e-3, err_msg=f"{hidden} {half}")
