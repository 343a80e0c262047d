# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light in Cycles against layers, its files, and that its removal leaves nothing behind."""

import json
import os

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import Settings, render
from tests.support import blender_scenes


@pytest.fixture
def cloud(scene, tmp_path):
    scene.render.resolution_x = scene.render.resolution_y = 32
    cloud = blender_scenes.cloud_scene(scene, tmp_path, density=20.0)
    scene.camera.data.angle = 0.5
    scene.cycles.volume_bounces = 7
    return cloud


def layer_of(scene):
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    found = read_scene(blender_scenes.depsgraph())
    return render(found.volumes, found.suns, found.camera, Settings(16))


def in_cycles(scene, folder, samples=32):
    blender_scenes.set_up_cycles(scene, samples, 0)
    scene.cycles.volume_step_rate = 1.0
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    return blender_scenes.rendered(scene, folder)


def lights():
    return [shown for shown in bpy.data.objects if "mrpnn_light" in shown]


def bake(folder, **options):
    return bpy.ops.mrpnn.bake_light(folder=str(folder), **options)


def relative(image, layer):
    shown = layer.alpha > 0.02
    return np.sqrt(np.mean((image[..., :3] - layer.rgb)[shown] ** 2)) / layer.rgb[shown].mean()


@pytest.mark.slow
def test_cycles_shows_the_layer_after_baking_and_single_scattering_before(addon, scene, cloud, tmp_path):
    layer = layer_of(scene)
    before = in_cycles(scene, tmp_path)[..., :3].mean()
    assert before < 0.6 * layer.rgb.mean()
    assert bake(tmp_path) == {"FINISHED"}
    image = in_cycles(scene, tmp_path)
    assert relative(image, layer) < 0.08
    assert image[..., :3].mean() == pytest.approx(layer.rgb.mean(), rel=0.04)


@pytest.mark.parametrize("frames", ["one", "all"])
def test_frames_without_a_volume_leave_the_scene_as_it_is(addon, scene, cloud, tmp_path, frames):
    cloud.scale = (0.0, 0.0, 0.0)
    scene.render.engine, scene.frame_end = "MRPNN", 2
    operator = {"one": bpy.ops.mrpnn.bake_light, "all": bpy.ops.mrpnn.bake_animation}[frames]
    assert operator(folder=str(tmp_path / "light")) == {"FINISHED"}
    assert (scene.render.engine, scene.cycles.volume_bounces, lights()) == ("MRPNN", 7, [])
    assert not bpy.ops.mrpnn.bake_light_remove.poll()


@pytest.mark.slow
def test_another_camera_sees_its_own_light_in_its_colours(addon, scene, cloud, tmp_path):
    shader = next(node for node in cloud.data.materials[0].node_tree.nodes if node.type == "PRINCIPLED_VOLUME")
    shader.inputs["Color"].default_value, shader.inputs["Anisotropy"].default_value = (0.6, 0.8, 1.0, 1.0), 0.8
    assert bake(tmp_path) == {"FINISHED"}
    angle = np.radians(40.0)
    scene.camera.location = 6.0 * np.sin(angle), 0.0, 6.0 * np.cos(angle)
    scene.camera.rotation_euler = 0.0, angle, 0.0
    assert relative(in_cycles(scene, tmp_path), layer_of(scene)) < 0.1


@pytest.mark.slow
def test_the_layer_and_the_volume_are_what_they_were(addon, scene, cloud, tmp_path):
    layer, materials = layer_of(scene), [slot.material.name for slot in cloud.material_slots]
    path = cloud.data.filepath
    bake(tmp_path)
    assert [slot.material.name for slot in cloud.material_slots] == materials and cloud.data.filepath == path
    np.testing.assert_allclose(layer_of(scene).rgb, layer.rgb, rtol=1e-5)


def state_of_file() -> dict:
    """What a .blend file holds: names of all data, and the settings that a bake may touch."""
    found = {}
    for kind in ("objects", "volumes", "materials", "collections", "actions", "node_groups", "scenes"):
        found[kind] = sorted(block.name for block in getattr(bpy.data, kind))
    scene = bpy.data.scenes[0]
    found["engine"] = scene.render.engine
    for settings in (scene.cycles, scene.render):
        scalars = [p for p in settings.bl_rna.properties if p.type in ("INT", "FLOAT", "BOOLEAN") and not p.is_array]
        found |= {p.identifier: getattr(settings, p.identifier) for p in scalars}
    found["denoiser"] = scene.cycles.denoiser, scene.cycles.denoising_input_passes
    found["state"] = scene.mrpnn_light.active, len(scene.mrpnn_light.volumes), scene.mrpnn_light.cycles
    found["children"] = [child.name for child in scene.collection.children]
    return found


def test_light_of_an_unsaved_file_is_kept_by_saving_it(addon, scene, cloud, tmp_path, capfd):
    assert not bpy.data.filepath and bpy.ops.mrpnn.bake_light(directional=False) == {"FINISHED"}
    assert "save the file to keep it" in capfd.readouterr().out
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    (light,) = lights()
    path = bpy.path.abspath(light.data.filepath)
    assert os.path.samefile(os.path.dirname(path), tmp_path / "baked_light") and os.path.getsize(path) > 0


def test_removal_restores_the_saved_file(addon, scene, cloud, tmp_path):
    scene.render.engine = "MRPNN"
    blend = str(tmp_path / "scene.blend")
    bpy.ops.wm.save_as_mainfile(filepath=blend)
    bpy.ops.wm.open_mainfile(filepath=blend)
    before = state_of_file()
    assert bake(tmp_path) == {"FINISHED"}
    scene = bpy.context.scene
    assert scene.render.engine == "CYCLES" and scene.cycles.volume_bounces == 0 and len(lights()) == 1
    assert bpy.ops.mrpnn.bake_light_fast() == {"FINISHED"}
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=blend)
    assert len(lights()) == 1 and bpy.context.scene.cycles.samples == 1
    assert bpy.ops.mrpnn.bake_light_remove() == {"FINISHED"}
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=blend)
    assert state_of_file() == before


def shown_light(scene) -> list[tuple[str, str]]:
    return [(shown.name, shown.data.filepath) for shown in scene.objects if "mrpnn_light" in shown]


@pytest.mark.parametrize("kind", ["LINK_COPY", "FULL_COPY", "EMPTY"])
def test_a_bake_in_a_copy_of_a_scene_leaves_the_first_scenes_light(addon, scene, cloud, tmp_path, kind):
    assert bake(tmp_path / "first") == {"FINISHED"}
    before = shown_light(scene)
    bpy.ops.scene.new(type=kind)
    copy = bpy.context.scene
    if kind == "EMPTY":
        copy.collection.objects.link(cloud)
        copy.camera = scene.camera
        blender_scenes.add_sun(copy, strength=2.0)
    assert bake(tmp_path / "copy") == {"FINISHED"}
    assert shown_light(scene) == before
    ((_, path),) = shown_light(copy)
    assert path.startswith(str(tmp_path / "copy"))
    assert bpy.ops.mrpnn.bake_light_remove() == {"FINISHED"}
    assert shown_light(scene) == before and not shown_light(copy)
    bpy.context.window.scene = scene
    assert bpy.ops.mrpnn.bake_light_remove() == {"FINISHED"}
    assert not lights()


def test_a_copy_of_a_scene_loses_its_light_alone(addon, scene, cloud, tmp_path):
    assert bake(tmp_path) == {"FINISHED"}
    before = shown_light(scene)
    bpy.ops.scene.new(type="LINK_COPY")
    assert bpy.ops.mrpnn.bake_light_remove() == {"FINISHED"}
    assert shown_light(scene) == before and not shown_light(bpy.context.scene)


@pytest.mark.parametrize("link", [False, True])
def test_light_of_another_file_shines_once_or_is_named(addon, scene, cloud, tmp_path, capfd, link):
    assert bake(tmp_path / "first") == {"FINISHED"}
    names = [shown.name for shown in scene.objects if shown != scene.camera]
    path = str(tmp_path / "first.blend")
    bpy.ops.wm.save_as_mainfile(filepath=path, copy=True)
    scene = blender_scenes.empty_scene()
    blender_scenes.add_camera(scene)
    with bpy.data.libraries.load(path, link=link) as (_, loaded):
        loaded.objects = names
    for shown in loaded.objects:
        scene.collection.objects.link(shown)
    assert bake(tmp_path / "second") == {"FINISHED"}
    own = [path for _, path in shown_light(scene) if path.startswith(str(tmp_path / "second"))]
    assert len(own) == 1 and len(shown_light(scene)) == (2 if link else 1)
    sentence = '"Cloud Light [first.blend]" adds the baked light of another file; unlink it from the scene'
    assert (sentence in capfd.readouterr().out) == link


@pytest.mark.slow
def test_fast_settings_show_the_layer_with_one_sample(addon, scene, cloud, tmp_path):
    # Denoising needs more pixels than the other tests.
    scene.render.engine, scene.render.resolution_x, scene.render.resolution_y = "CYCLES", 128, 128
    layer = layer_of(scene)
    assert not bpy.ops.mrpnn.bake_light_fast.poll()
    bake(tmp_path)
    assert bpy.ops.mrpnn.bake_light_fast() == {"FINISHED"}
    assert scene.cycles.samples == 1 and scene.cycles.use_denoising
    assert scene.cycles.denoising_input_passes == "RGB"
    longer = bpy.app.version < (5, 0, 0)
    assert scene.cycles.volume_step_rate == (4.0 if longer else 1.0)
    assert relative(blender_scenes.rendered(scene, tmp_path), layer) < 0.1


@pytest.mark.slow
@pytest.mark.parametrize("other", ["surface", "lamp"])
def test_surfaces_and_lamps_keep_their_samples(addon, scene, cloud, tmp_path, other):
    mesh = bpy.data.meshes.new("Ground")
    mesh.from_pydata([(-9, -9, -3), (9, -9, -3), (9, 9, -3), (-9, 9, -3)], [], [(0, 1, 2, 3)])
    blender_scenes.add_object(scene, "Other", mesh if other == "surface" else bpy.data.lights.new("Lamp", "POINT"))
    scene.render.engine = "CYCLES"
    scene.cycles.samples, scene.cycles.denoising_input_passes = 77, "RGB_ALBEDO_NORMAL"
    bake(tmp_path)
    assert bpy.ops.mrpnn.bake_light_fast() == {"FINISHED"}
    assert scene.cycles.samples == 77 and scene.cycles.denoising_input_passes == "RGB_ALBEDO_NORMAL"
    assert scene.cycles.use_denoising


@pytest.mark.slow
def test_only_what_has_changed_is_baked_again(addon, scene, cloud, tmp_path):
    other, _ = blender_scenes.add_volume(
        scene,
        blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 1.0)),
        "Other",
        Density=5.0,
    )
    other.location = 4.0, 0.0, 0.0
    bake(tmp_path)
    first = {shown["mrpnn_light"]: shown.data.filepath for shown in lights()}
    assert set(first) == {"Cloud", "Other"}
    bake(tmp_path)
    assert {shown["mrpnn_light"]: shown.data.filepath for shown in lights()} == first
    other.location = 5.0, 0.0, 0.0
    bake(tmp_path)
    second = {shown["mrpnn_light"]: shown.data.filepath for shown in lights()}
    assert second["Cloud"] == first["Cloud"] and second["Other"] != first["Other"]
    bpy.data.objects.remove(other)
    bake(tmp_path)
    assert [shown["mrpnn_light"] for shown in lights()] == ["Cloud"]


@pytest.mark.parametrize("kind", ["SUN", "POINT", "SPOT", "AREA", "MESH"])
def test_light_is_baked_again_where_links_of_lights_change(addon, scene, cloud, tmp_path, kind):
    other, _ = blender_scenes.add_volume(scene, cloud.data.filepath, "Other", Density=5.0)
    other.location.x = 4.0
    if kind == "MESH":
        bpy.ops.mesh.primitive_plane_add(location=(2.0, 0.0, -3.0))
        light, glow = bpy.context.object, bpy.data.materials.new("Glow")
        glow.use_nodes = True
        glow.node_tree.nodes["Principled BSDF"].inputs["Emission Strength"].default_value = 3.0
        light.data.materials.append(glow)
    else:
        light = blender_scenes.add_object(scene, "Linked", bpy.data.lights.new("Linked", kind))
        light.location = 2.0, 0.0, 3.0
    keys = [light_keys_by_name()]
    links = light.light_linking.receiver_collection = bpy.data.collections.new("Links")
    # A mesh lights itself, too.
    links.objects.link(light)
    links.objects.link(cloud)
    keys.append(light_keys_by_name())
    assert keys[0]["Cloud"] == keys[1]["Cloud"] and keys[0]["Other"] != keys[1]["Other"]
    links.objects.unlink(cloud)
    links.objects.link(other)
    keys.append(light_keys_by_name())
    assert keys[0]["Cloud"] != keys[2]["Cloud"] and keys[0]["Other"] == keys[2]["Other"]


def test_a_volume_too_small_for_its_file_is_named_and_the_others_are_baked(addon, scene, cloud, tmp_path, capfd):
    """OpenVDB refuses transforms of tiny voxels."""
    tiny, _ = blender_scenes.add_volume(scene, cloud.data.filepath, "Tiny", Density=1e5)
    tiny.scale, tiny.location.x = (1e-5,) * 3, 0.1
    other, _ = blender_scenes.add_volume(scene, cloud.data.filepath, "Small", Density=1e3)
    other.scale, other.location.x = (1e-3,) * 3, 4.0
    assert bake(tmp_path / "light") == {"FINISHED"}
    said = "".join(capfd.readouterr())
    assert 'volume "Tiny" is too small; scale the scene up' in said and '"Small" is' not in said
    assert {shown["mrpnn_light"] for shown in lights()} == {"Cloud", "Small"}
    assert all(shown.data.grids.load() for shown in lights())
    assert bpy.ops.mrpnn.bake_light_remove() == {"FINISHED"}


def light_keys_by_name():
    from mrpnn.mrpnn_addon.baking.content import light_keys, volume_names
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    found = read_scene(blender_scenes.depsgraph())
    return dict(zip(volume_names(found), light_keys(found, Settings())))


def test_materials_have_few_nodes(addon, scene, cloud, tmp_path):
    """EEVEE compiles them for seconds, or minutes without a graphics card."""
    counts = []
    for directional in (True, False):
        bake(tmp_path, directional=directional, everything=True)
        [shown] = lights()
        counts.append(len(shown.data.materials[0].node_tree.nodes))
    assert counts[0] <= 150 and counts[1] <= 12


def test_eevee_reads_no_more_grids_than_it_can(addon, scene, cloud, tmp_path):
    """Of a material that reads more, EEVEE shows nothing; light of several colours has the most grids."""
    lamp = bpy.data.lights.new("Red", "POINT")
    lamp.energy, lamp.color = 200.0, (1.0, 0.2, 0.1)
    blender_scenes.add_object(scene, "Red", lamp).location = -1.5, -1.0, 0.5
    bake(tmp_path)
    tree = lights()[0].data.materials[0].node_tree
    assert len(grids_of(tree, "CYCLES")) == 18
    assert len(grids_of(tree, "EEVEE")) <= (16 if bpy.app.version < (5, 2, 0) else 18)


def grids_of(tree, engine):
    """Names of the grids that an engine's output of a material reads."""
    names, left, seen = set(), [tree.get_output_node(engine)], set()
    while left:
        node = left.pop()
        if node.name not in seen:
            seen.add(node.name)
            names |= {node.attribute_name} if node.type == "ATTRIBUTE" else set()
            left += [link.from_node for socket in node.inputs for link in socket.links]
    return names


def test_files_are_half_floats_without_empty_voxels(addon, scene, cloud, tmp_path):
    scene.objects["Sun"].data.energy = 1e9
    bake(tmp_path)
    [shown] = lights()
    openvdb = blender_scenes.openvdb()
    light, own = (openvdb.read(shown.data.filepath, name) for name in ("light", "light_density"))
    assert light.saveFloatAsHalf and light.evalMinMax()[1][0] == pytest.approx(1.0, rel=1e-3)
    assert own.saveFloatAsHalf and own.evalMinMax()[1] == pytest.approx(1.0, rel=1e-3)
    values = np.zeros((16, 16, 16), np.float32)
    density = openvdb.read(cloud.data.filepath, "density")
    density.copyToArray(values)
    assert own.activeVoxelCount() == np.count_nonzero(values)
    # Light goes on for one voxel beyond the density.
    assert np.count_nonzero(values) < light.activeVoxelCount() < np.count_nonzero(np.ones(18**3))
    assert not [name for name in os.listdir(tmp_path) if name.startswith(".")]


def test_large_files_are_the_same_from_another_process(addon, scene, cloud, tmp_path, monkeypatch):
    """Nothing else goes on in Blender while OpenVDB writes in it."""
    light_file, started = addon.mrpnn_addon.vdb.light_file, []
    popen = light_file.subprocess.Popen

    def start(command, **options):
        started.append(command)
        return popen(command, **options)

    monkeypatch.setattr(light_file.subprocess, "Popen", start)
    described = addon.mrpnn_addon.scene.reader.read_frame(blender_scenes.depsgraph())
    [lit] = addon.inference.bake(described.volumes, described.lights, described.camera)
    started.clear()
    paths = [str(tmp_path / name) for name in ("here.vdb", "process.vdb", "without.vdb")]
    light_file.write_light(paths[0], lit, 1.0)
    assert not started
    monkeypatch.setattr(light_file, "LARGE", 0)
    light_file.write_light(paths[1], lit, 1.0)
    assert len(started) == 1 and "writer.py" in str(started[0])
    monkeypatch.setattr(light_file, "PROGRAM", tmp_path / "missing.py")
    light_file.write_light(paths[2], lit, 1.0)
    assert len(started) == 2
    openvdb = blender_scenes.openvdb()
    expected, *found = (
        {grid.name: openvdb.read(path, grid.name) for grid in openvdb.readAllGridMetadata(path)} for path in paths
    )
    assert len(expected) > 10
    for grids in found:
        assert grids.keys() == expected.keys()
        for name, grid in grids.items():
            assert grid.transform == expected[name].transform and grid.saveFloatAsHalf
            shape = [high + 2 for high in grid.evalActiveVoxelBoundingBox()[1]]
            here, there = (np.zeros([*shape, 3] if "Vec" in type(grid).__name__ else shape) for _ in range(2))
            grid.copyToArray(here, ijk=(-1, -1, -1))
            expected[name].copyToArray(there, ijk=(-1, -1, -1))
            np.testing.assert_array_equal(here, there)


def test_a_folder_that_cannot_be_made_is_named(addon, scene, cloud, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(RuntimeError, match="file"):
        bake(tmp_path / "file" / "light")
    assert not lights() and not scene.mrpnn_light.active


@pytest.mark.parametrize("baked_before", [False, True])
def test_without_light_the_bake_is_dark_and_says_what_is_missing(addon, scene, cloud, tmp_path, baked_before):
    """As in the picture of every other door: black, with the alpha of the volume."""
    if baked_before:
        bake(tmp_path)
    bpy.data.objects.remove(scene.objects["Sun"])
    job = addon.mrpnn_addon.baking.bake_job
    described = addon.mrpnn_addon.scene.reader.read_frame(blender_scenes.depsgraph())
    warned = job.bake_scene(described, scene.mrpnn.settings(), job.BakeTarget(str(tmp_path / "other"))).warnings
    assert any("frame 1 is black" in text and "add a sun" in text for text in warned)
    bake(tmp_path)
    assert len(lights()) == 1
    found = in_cycles(scene, tmp_path, samples=4)
    assert not found[..., :3].any() and found[..., 3].max() > 0.3


@pytest.mark.slow
def test_light_that_ground_throws_back_is_baked(addon, scene, cloud, tmp_path):
    mesh = bpy.data.meshes.new("Ground")
    mesh.from_pydata([(-9, -9, -1.2), (9, -9, -1.2), (9, 9, -1.2), (-9, 9, -1.2)], [], [(0, 1, 2, 3)])
    ground = blender_scenes.add_object(scene, "Ground", mesh)
    mesh.materials.append(bpy.data.materials.new("White"))
    mesh.materials[0].use_nodes = True
    mesh.materials[0].node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.8, 0.8, 0.8, 1.0)
    # The picture shows nothing but what the cloud scatters.
    ground.visible_camera = False
    reference = blender_scenes.render_cycles(scene, tmp_path, samples=128, bounces=256)[..., :3]
    alone = layer_of(scene).rgb
    bake(tmp_path)
    image = in_cycles(scene, tmp_path)[..., :3]
    assert image.mean() == pytest.approx(reference.mean(), rel=0.05)
    assert alone.mean() < 0.8 * reference.mean()


@pytest.mark.slow
def test_the_command_bakes_a_sequence_and_saves_a_file_that_shows_it(addon, scene, cloud, tmp_path):
    sun = scene.objects["Sun"]
    for frame, angle in ((1, 0.0), (3, 1.0)):
        sun.rotation_euler[0] = angle
        sun.keyframe_insert("rotation_euler", frame=frame)
    scene.render.engine, blend = "CYCLES", tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    out, facts = tmp_path / "lit.blend", tmp_path / "facts.json"
    command = addon.operators.command.main
    assert command(["bake", "--frames", "1-3", "--save", str(out), "--json", str(facts), "--fast"]) == 0
    files = [next(iter(frame["files"].values())) for frame in json.loads(facts.read_text())["frames"]]
    assert all(os.path.exists(path) for path in files) and len(set(files)) == 3
    bpy.ops.wm.open_mainfile(filepath=str(out))
    scene, [shown] = bpy.context.scene, lights()
    assert scene.cycles.samples == 1 and scene.cycles.use_denoising
    for frame, path in enumerate(files, start=1):
        scene.frame_set(frame)
        assert shown.evaluated_get(blender_scenes.depsgraph()).data.grids.load()
        assert os.path.samefile(shown.evaluated_get(blender_scenes.depsgraph()).data.grids.frame_filepath, path)
    assert command(["bake", "--frames", "1,5"]) == 1
    assert command(["bake", "--save", "x.png"]) == 1
