# SPDX-License-Identifier: GPL-3.0-or-later
"""Six-way flipbooks: textures of real scenes, read back by other means."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

bpy = pytest.importorskip("bpy")

# After bpy: its compiled libraries must come first.
import OpenEXR

from tests.support import blender_scenes

SIDES = ("right", "top", "back", "left", "bottom", "front")


@pytest.fixture
def smoke(scene, tmp_path):
    """A saved scene with a sequence of three frames, the second of which has no file."""
    for number in (1, 3):
        density = number * blender_scenes.blob()
        # Off the middle: right, at the top and in front have more.
        density[:4] = density[:, :, :4] = 0.0
        path = blender_scenes.write_vdb(tmp_path, density, blender_scenes.centred(16, 2.0))
        shutil.move(path, tmp_path / f"fog_{number}.vdb")
    cloud, shader = blender_scenes.add_volume(
        scene, tmp_path / "fog_1.vdb", Density=3.0, Color=(0.9, 0.9, 0.9, 1.0), Anisotropy=0.3
    )
    cloud.data.is_sequence, cloud.data.frame_start, cloud.data.frame_duration = True, 1, 3
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene)
    scene.frame_start, scene.frame_end = 1, 3
    wanted = scene.mrpnn_flipbook
    wanted.columns, wanted.rows, wanted.size, wanted.file_format = 2, 2, 64, "EXR"
    wanted.filepath, scene.mrpnn.depth_samples = str(tmp_path / "out" / "smoke"), 1
    scene.frame_set(2, subframe=0.25)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    return shader


def read(path):
    """float (H, W, 4), rows from the top, as the file holds it."""
    if path.suffix == ".exr":
        with OpenEXR.File(str(path), separate_channels=True) as file:
            return np.stack([file.channels()[name].pixels for name in "RGBA"], axis=2).astype(np.float32)
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name, image.alpha_mode = "Non-Color", "CHANNEL_PACKED"
    pixels = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)[::-1]


def written(folder):
    return {path.name for path in (folder / "out").iterdir()}


def flipbook():
    assert bpy.ops.mrpnn.flipbook() == {"FINISHED"}


def test_missing_frames_are_empty_tiles_and_the_scene_is_back_in_its_subframe(addon, scene, smoke, tmp_path, capsys):
    flipbook()
    assert (scene.frame_current, scene.frame_subframe) == (2, 0.25)
    assert written(tmp_path) == {"smoke_A.exr", "smoke_B.exr", "smoke.json"}
    first, second = read(tmp_path / "out" / "smoke_A.exr"), read(tmp_path / "out" / "smoke_B.exr")
    assert first.shape == second.shape == (64, 64, 4)
    tiles = [first[y : y + 32, x : x + 32] for y in (0, 32) for x in (0, 32)]
    assert tiles[0].any() and tiles[2].any()
    assert not tiles[1].any() and not tiles[3].any()
    # Three times the density.
    assert tiles[2][..., 3].sum() > 1.2 * tiles[0][..., 3].sum()
    for tile in (tiles[0], tiles[2]):
        assert not tile[:2].any() and not tile[-2:].any() and not tile[:, :2].any() and not tile[:, -2:].any()
        assert tile[2:-2, 2:-2, 3].max() > 0.3
    facts = json.loads((tmp_path / "out" / "smoke.json").read_text())
    assert facts["frames"] == [1, 2, 3] and facts["columns"] == 2 and facts["alpha"] == "premultiplied"
    assert "frame 2" in capsys.readouterr().out


@pytest.mark.slow(seconds=30)
def test_each_map_is_a_render_with_a_sun_from_its_side(addon, scene, smoke, tmp_path):
    """Beside F12 with a sun in the scene, turned with the camera; white matte surfaces facing it would be 1."""
    scene.camera.location, scene.camera.rotation_euler = (3.0, -3.0, 2.0), (1.1, 0.2, 0.8)
    scene.mrpnn_flipbook.view, scene.mrpnn_flipbook.columns, scene.mrpnn_flipbook.rows = "CAMERA", 1, 1
    scene.mrpnn_flipbook.padding, scene.mrpnn_flipbook.size = 0, 48
    scene.render.resolution_x = scene.render.resolution_y = 48
    scene.frame_start = scene.frame_end = 1
    scene.frame_set(1)
    scene.render.engine, scene.mrpnn.depth_samples = "MRPNN", 16
    flipbook()
    maps = [read(tmp_path / "out" / f"smoke_{name}.exr")[..., :3] for name in "AB"]
    maps = dict(zip(SIDES, np.moveaxis(np.concatenate(maps, axis=2), 2, 0)))
    sun = bpy.data.objects["Sun"]
    sun.data.energy = np.pi
    # Blender's suns shine along their -Z.
    turns = {"front": (0, 0, 0), "back": (np.pi, 0, 0), "right": (0, np.pi / 2, 0), "left": (0, -np.pi / 2, 0),
             "top": (-np.pi / 2, 0, 0), "bottom": (np.pi / 2, 0, 0)}  # fmt: skip
    from mathutils import Euler

    for side, turn in turns.items():
        sun.matrix_world = scene.camera.matrix_world @ Euler(turn).to_matrix().to_4x4()
        bpy.context.view_layer.update()
        bpy.ops.mrpnn.render()
        image = bpy.data.images["MRPNN"]
        expected = np.array(image.pixels[:]).reshape(48, 48, 4)[::-1]
        assert expected[..., 0].max() > 0.02
        error = np.sqrt(np.mean((maps[side] - expected[..., 0]) ** 2)) / expected[..., 0].mean()
        assert error < 0.03, (side, error)


def tiles(addon, count):
    """Tiles of 12 x 12 pixels, premultiplied, the second one empty."""
    random = np.random.default_rng(7)
    alpha = random.uniform(0.1, 1.0, (count, 12, 12)).astype(np.float32)
    alpha[:, :, :3] = 0.0
    maps = random.uniform(0.0, 1.5, (count, 12, 12, 6)).astype(np.float32) * alpha[..., None]
    made = [addon.mrpnn_addon.flipbook.light_maps.Tile(maps[n], alpha[n], 0.0 * maps[n, ..., :3]) for n in range(count)]
    made[1] = None
    return made


def packed(addon, **options):
    atlas = addon.mrpnn_addon.flipbook.atlas
    return atlas.textures(atlas.Atlas(columns=2, rows=2, tile=16, padding=2, **options), tiles(addon, 3))


@pytest.mark.parametrize(("file_format", "step"), [("PNG", 255), ("PNG16", 65535), ("TGA", 255), ("EXR", 2048)])
def test_blender_reads_every_format_as_it_was_written(addon, scene, tmp_path, file_format, step):
    files = addon.mrpnn_addon.flipbook.texture_files
    made = packed(addon, normalized=True)
    assert max(made.images[name][..., :3].max() for name in "AB") == pytest.approx(1.0)
    expected = made.images["A"]
    path = tmp_path / f"a{files.FORMATS[file_format][0]}"
    files.write_texture(str(path), expected, file_format)
    assert np.abs(read(path) - expected).max() < 0.51 / step
    assert list(tmp_path.iterdir()) == [path]


def test_layouts_and_straight_alpha(addon):
    unity = packed(addon)
    both = np.concatenate([unity.images["A"], unity.images["B"]], axis=2)
    assert unity.clipped > 0.1 and both.shape == (32, 32, 8)
    # Right, top, back, alpha, left, bottom, front, emission; then right, left, top, alpha, bottom, back, front.
    other = packed(addon, layout="RIGHT_LEFT_TOP").images
    assert np.array_equal(np.concatenate([other["A"], other["B"]], axis=2), both[..., [0, 4, 1, 3, 5, 2, 6, 7]])
    straight = packed(addon, straight=True).images["A"]
    shown = straight[..., 3] > 0.0
    assert np.allclose((straight[..., :3] * straight[..., 3:])[shown], both[shown][:, :3], atol=1e-5)
    # Filtered edges keep their colour.
    edge = ~shown & np.roll(shown, 1, axis=1)
    assert edge.any() and straight[edge][:, :3].max(axis=1).min() > 0.0
    for padding in (slice(0, 2), slice(14, 18), slice(30, 32)):
        assert not both[padding].any() and not both[:, padding].any()


@pytest.mark.slow(seconds=15)
def test_fire_is_its_own_channel(addon, scene, smoke, tmp_path):
    smoke.inputs["Emission Strength"].default_value = 2.0
    smoke.inputs["Emission Color"].default_value = (1.0, 0.5, 0.1, 1.0)
    dark = {}
    for strength in (0.0, 2.0):
        smoke.inputs["Emission Strength"].default_value = strength
        flipbook()
        dark[strength] = {name: read(tmp_path / "out" / f"smoke_{name}.exr") for name in "AB"}
    # Light maps do not hold it.
    assert np.allclose(dark[0.0]["A"], dark[2.0]["A"], atol=0.01)
    colour = read(tmp_path / "out" / "smoke_emission.exr")
    glow = dark[2.0]["B"][..., 3]
    assert not dark[0.0]["B"][..., 3].any() and glow.max() > 0.3
    assert np.allclose(glow, colour[..., :3] @ [0.2126, 0.7152, 0.0722], atol=2e-3)
    assert colour.max() == pytest.approx(1.0, abs=1e-3)
    ratio = colour[..., 1].sum() / colour[..., 0].sum()
    assert 0.4 < ratio < 0.6


def test_dark_maps_in_8_bits_are_named(addon, tmp_path):
    flipbook, one = addon.mrpnn_addon.flipbook, tiles(addon, 2)[0]
    told = {}
    for brightness in (0.1, 1.0):
        for file_format in flipbook.texture_files.FORMATS:
            for normalized in (False, True):
                atlas = flipbook.atlas.Atlas(columns=1, rows=1, tile=16, padding=2, normalized=normalized)
                book = flipbook.flipbook.Flipbook(atlas, [1], str(tmp_path / "smoke"), file_format)
                book.tiles[1] = replace(one, maps=brightness * one.maps / one.maps.max())
                book.write()
                told[brightness, file_format, normalized] = any("few shades" in text for text in book.warnings)
    assert {options for options, named in told.items() if named} == {(0.1, "PNG", False), (0.1, "TGA", False)}


def test_errors_leave_files_frame_and_settings(addon, scene, smoke, tmp_path):
    scene.mrpnn_flipbook.size = 16
    with pytest.raises(RuntimeError, match="too small"):
        bpy.ops.mrpnn.flipbook()
    scene.mrpnn_flipbook.size = 64
    for shown in list(scene.objects):
        if shown.type == "VOLUME":
            shown.hide_render = True
    with pytest.raises(RuntimeError, match="no frame shows a volume"):
        bpy.ops.mrpnn.flipbook()
    assert (scene.frame_current, scene.frame_subframe) == (2, 0.25)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow(seconds=15)
def test_the_command_writes_what_the_operator_does(addon, scene, smoke, tmp_path, capsys):
    flipbook()
    expected = {name: read(tmp_path / "out" / f"smoke_{name}.exr") for name in "AB"}
    scene.mrpnn_flipbook.columns = 5
    command = addon.operators.command.main
    arguments = ["flipbook", "--output", str(tmp_path / "out" / "other.exr"), "--json", str(tmp_path / "facts.json")]
    assert command([*arguments, "--frames", "1-3", "--columns", "2", "--view", "auto"]) == 0
    for name in "AB":
        assert np.array_equal(read(tmp_path / "out" / f"other_{name}.exr"), expected[name])
    facts = json.loads((tmp_path / "facts.json").read_text())
    assert [frame["empty"] for frame in facts["frames"]] == [False, True, False]
    assert (scene.frame_current, scene.frame_subframe) == (2, 0.25)
    assert scene.mrpnn_flipbook.columns == 5
    assert command(["flipbook", "--output", str(tmp_path / "a.png"), "--frames", "1-30"]) == 1
    assert "30 frames do not fit into 5 x 2 tiles" in capsys.readouterr().err
    assert command(["flipbook", "--output", str(tmp_path / "a.jpg")]) == 1
    assert command(["flipbook", "--columns", "0"]) == 1
    assert "must lie between 1 and 64" in capsys.readouterr().err


@pytest.mark.slow(seconds=40)
def test_sliders_relight_the_flipbook_on_its_plane(addon, scene, smoke, tmp_path):
    """Cycles shows the plane as the sum of the maps times the sliders, over what is behind, at each frame's tile."""
    with pytest.raises(RuntimeError, match="render it first"):
        bpy.ops.mrpnn.flipbook_show()
    scene.mrpnn_flipbook.padding = 0
    for alpha in ("PREMULTIPLIED", "STRAIGHT"):
        scene.mrpnn_flipbook.alpha = alpha
        flipbook()
        assert bpy.ops.mrpnn.flipbook_show() == {"FINISHED"}
        plane = bpy.context.object
        for shown in scene.objects:
            shown.hide_render = shown != plane
        scene.camera.rotation_euler = plane.rotation_euler
        scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 2.0
        scene.render.resolution_x = scene.render.resolution_y = 32
        (light,) = [node for node in plane.material_slots[0].material.node_tree.nodes if node.type == "GROUP"]
        strengths = dict(zip(SIDES, (0.5, 0.0, 1.0, 0.25, 0.0, 2.0)))
        for side, strength in strengths.items():
            light.inputs[side.title()].default_value = strength
        A, B = (read(tmp_path / "out" / f"smoke_{name}.exr") for name in "AB")
        for frame, (y, x) in ((1, (0, 0)), (3, (32, 0))):
            scene.frame_set(frame)
            tiles = [texture[y : y + 32, x : x + 32] for texture in (A, B)]
            maps = np.concatenate([tile[..., :3] for tile in tiles], axis=2)
            expected = maps @ list(strengths.values())
            if alpha == "STRAIGHT":
                expected = expected * tiles[0][..., 3]
            found = blender_scenes.render_cycles(scene, tmp_path, samples=16)
            inner = (slice(2, -2),) * 2
            # Cycles' samples cover a pixel, and interpolate.
            assert np.abs(found[inner][..., 0] - expected[inner]).mean() < 0.03 * expected.max()
            assert np.abs(found[inner][..., 3] - tiles[0][inner][..., 3]).mean() < 0.03
            assert expected[inner].max() > 0.1
        bpy.data.objects.remove(plane)
        for shown in scene.objects:
            shown.hide_render = False


@pytest.mark.slow
def test_motion_vectors_lead_from_each_tile_to_the_next(addon, scene, smoke, tmp_path):
    """Smoke that drifts by whole voxels: the second tile, warped back, is the first one."""
    drift, frame = np.array([2.0, 0.0, 1.0]), blender_scenes.centred(16, 2.0)
    small = np.zeros((16, 16, 16), np.float32)
    small[2:10, 4:12, 3:11] = blender_scenes.blob(8)
    velocity = np.broadcast_to((drift * 2.0 / 16)[:, None, None, None], (3, 16, 16, 16))
    for number in range(3):
        density = np.roll(small, (drift * number).astype(int), (0, 1, 2))
        path = blender_scenes.write_vdb(tmp_path, density, frame)
        shutil.move(blender_scenes.with_velocity(tmp_path, path, velocity, frame), tmp_path / f"fog_{number + 1}.vdb")
    bpy.ops.wm.open_mainfile(filepath=bpy.data.filepath)
    scene = bpy.context.scene
    [cloud] = (shown for shown in scene.objects if shown.type == "VOLUME")
    # As a velocity per second.
    cloud.data.velocity_unit, cloud.data.velocity_scale = "SECOND", 24.0
    flipbook()
    facts = json.loads((tmp_path / "out" / "smoke.json").read_text())
    alpha = read(tmp_path / "out" / "smoke_A.exr")[..., 3]
    encoded = read(tmp_path / "out" / "smoke_motion.exr")
    assert encoded[..., :2].min() >= 0.0 and encoded[..., :2].max() == pytest.approx(1.0, abs=1e-3)
    # In pixels of a tile, to the right and down.
    steps = (2.0 * encoded[..., :2] - 1.0) * facts["motion_scale"] * facts["tile"] * [1.0, -1.0]
    first, second = alpha[:32, :32], alpha[:32, 32:]
    rows, columns = np.indices(first.shape)
    back = map_coordinates(second, [rows + steps[:32, :32, 1], columns + steps[:32, :32, 0]], order=1)
    shown = first > 0.02
    moved, still = (np.sqrt(np.mean((picture - first)[shown] ** 2)) for picture in (back, second))
    assert shown.sum() > 50 and moved < 0.2 * still


def test_velocities_of_empty_voxels_move_nothing(addon):
    """A domain's cache leaves them out, as a simulation does not."""
    inference = addon.inference
    density = np.zeros((8, 8, 8), np.float32)
    density[3:5, 3:5, 3:5] = 1.0
    matrix = np.diag([1 / 8] * 3 + [1.0])
    matrix[:3, 3] = 0.5 / 8 - 0.5
    above = np.eye(4)
    above[2, 3] = 3.0
    camera = inference.Camera(above, "orthographic", (16, 16), ortho_scale=1.0)
    everywhere = np.full((8, 8, 8), 0.25, np.float32)
    vectors = addon.mrpnn_addon.flipbook.motion_vectors.motion_vectors
    found = []
    for part in (everywhere, everywhere * density, np.where(density > 0.0, everywhere, -7.0)):
        velocity = inference.Velocity((part, 0.0 * part, 0.0 * part), matrix, np.eye(3), (0.0, 1.0))
        volume = inference.Volume(density, matrix, velocity=velocity)
        distance = np.full((16, 16), np.inf, np.float32)
        # Within a voxel of the smoke.
        distance[5:11, 5:11] = 3.0
        found.append(vectors(camera, distance, [(volume, inference.Medium(1.0))], 1))
    np.testing.assert_allclose(found[0][5:11, 5:11, 0], 4.0, rtol=1e-5)
    for vectors_found in found[1:]:
        np.testing.assert_allclose(vectors_found, found[0], rtol=1e-5, atol=1e-6)
