# SPDX-License-Identifier: GPL-3.0-or-later
"""Deep OpenEXR files: read by other libraries, from every door, and merged with what they do not know."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

# After bpy: the other way round, the process hangs when it ends.
import OpenEXR

from tests.reference.deep_compositor import merged_with_surface, seen_before
from tests.support import blender_scenes
from tests.support.exr_files import combined

SIZE = 32, 24


@pytest.fixture
def cloud(scene, tmp_path):
    """A scene with a small cloud before a transparent film."""
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.mrpnn.depth_samples, scene.mrpnn.use_deep = 4, True
    scene.render.engine, scene.render.film_transparent = "MRPNN", True
    blender_scenes.write_multilayer(scene)
    return blender_scenes.cloud_scene(scene, tmp_path)


def read_deep(path):
    """Header, and samples of each pixel, (rows, columns) lists of (front, back, r, g, b, a)."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        header, channels = dict(file.header()), {name: one.pixels for name, one in file.channels().items()}
    assert header["type"] == OpenEXR.deepscanline and set(channels) == {"R", "G", "B", "A", "Z", "ZBack"}
    order = [channels[name] for name in ("Z", "ZBack", "R", "G", "B", "A")]
    rows, columns = order[0].shape

    def samples(y, x):
        values = [image[y, x] for image in order]
        return [] if values[0] is None else np.stack([np.asarray(v, float) for v in values], axis=1).tolist()

    return header, [[samples(y, x) for x in range(columns)] for y in range(rows)]


def flattened(pixels, depth=np.inf):
    return np.array([[seen_before(samples, depth) for samples in row] for row in pixels])


def check_flat(found, expected):
    np.testing.assert_allclose(found, expected, atol=2.0**-10 * max(expected.max(), 1.0))


def test_f12_writes_deep_samples_beside_the_picture(scene, cloud, tmp_path):
    scene.render.filepath = str(tmp_path / "still.exr")
    bpy.ops.render.render(write_still=True)
    header, pixels = read_deep(tmp_path / "still_deep.exr")
    assert header["maxSamplesPerPixel"] <= 64 and header["mrpnn.model"] == "mrpnn"
    flat = combined(tmp_path / "still.exr")
    check_flat(flattened(pixels), flat)
    assert flat[..., 3].max() > 0.3
    empty = [samples for row in pixels for samples in row if not samples]
    assert len(empty) == np.count_nonzero(flat[..., 3] == 0.0) > 0
    # As a picture of the same channels.
    alone = {name: flat[..., number] for number, name in enumerate("RGBA")}
    with OpenEXR.File({"compression": OpenEXR.ZIPS_COMPRESSION}, {**alone, "Z": flat[..., 3]}) as file:
        file.write(str(tmp_path / "flat.exr"))
    sizes = [os.path.getsize(tmp_path / name) for name in ("still_deep.exr", "flat.exr")]
    assert sizes[0] <= 40 * sizes[1], sizes


def test_openimageio_reads_the_same(scene, cloud, tmp_path):
    if hasattr(bpy.utils, "expose_bundled_modules"):
        bpy.utils.expose_bundled_modules()
    oiio = pytest.importorskip("OpenImageIO")
    scene.render.filepath = str(tmp_path / "still.exr")
    bpy.ops.render.render(write_still=True)
    found = oiio.ImageInput.open(str(tmp_path / "still_deep.exr")).read_native_deep_image()
    _, pixels = read_deep(tmp_path / "still_deep.exr")
    names = {found.channelname(c): c for c in range(found.channels)}
    for number, samples in enumerate(samples for row in pixels for samples in row):
        assert found.samples(number) == len(samples)
        for s, values in enumerate(samples):
            told = [found.deep_value(number, names[n], s) for n in ("Z", "ZBack", "R", "G", "B", "A")]
            assert told == pytest.approx(values, abs=1e-7)


def test_a_mesh_merged_afterwards_is_the_render_with_the_mesh(scene, cloud, tmp_path):
    """The mesh neither shades nor lights the volume."""
    scene.render.filepath = str(tmp_path / "still.exr")
    bpy.ops.render.render(write_still=True)
    _, pixels = read_deep(tmp_path / "still_deep.exr")
    scene.mrpnn.use_deep = False
    brightest = combined(tmp_path / "still.exr")[..., :3].max()
    bpy.ops.mesh.primitive_plane_add(size=60.0)
    wall, colour = bpy.context.object, (0.2, 0.4, 0.1)
    wall.visible_shadow = wall.visible_volume_scatter = False
    for number, z in enumerate((0.5, 0.0, -0.4)):
        wall.location.z = z
        scene.render.filepath = str(tmp_path / f"wall{number}.exr")
        bpy.ops.render.render(write_still=True)
        layer, depth = combined(tmp_path / f"wall{number}.exr"), scene.camera.location.z - z
        expected = layer[..., :3] + (1.0 - layer[..., 3:]) * colour
        found = np.array([[merged_with_surface(samples, depth, colour)[:3] for samples in row] for row in pixels])
        assert np.sqrt(((found - expected) ** 2).mean()) <= 0.01 * brightest, z
        assert np.abs(found - expected).mean() <= 0.01 * brightest, z


def test_animations_views_and_view_layers_have_files_of_their_own(scene, cloud, tmp_path):
    scene.frame_start, scene.frame_end = 3, 4
    scene.view_layers.new("Second: one")
    scene.render.filepath = f"{tmp_path}/####"
    bpy.ops.render.render(animation=True)
    deep = sorted(path.name for path in tmp_path.glob("*_deep.exr"))
    assert deep == [f"{frame}_{name}_deep.exr" for frame in ("0003", "0004") for name in ("Second__one", "ViewLayer")]
    scene.view_layers.remove(scene.view_layers[1])
    scene.render.use_multiview = True
    scene.render.filepath = str(tmp_path / "eyes.exr")
    bpy.ops.render.render(write_still=True)
    assert sorted(path.name for path in tmp_path.glob("eyes*_deep*")) == ["eyes_deep_L.exr", "eyes_deep_R.exr"]


def test_render_volumes_and_the_command_write_the_same_samples(addon, scene, cloud, tmp_path):
    scene.render.filepath = str(tmp_path / "still.exr")
    bpy.ops.render.render(write_still=True)
    expected = read_deep(tmp_path / "still_deep.exr")[1]
    bpy.ops.mrpnn.render(filepath=str(tmp_path / "volumes.exr"))
    assert read_deep(tmp_path / "volumes_deep.exr")[1] == expected
    scene.mrpnn.use_deep = False
    main = addon.operators.command.main
    assert main(["render", "--output", str(tmp_path / "plain.exr")]) == 0
    assert not (tmp_path / "plain_deep.exr").exists()
    for name in ("command.exr", "command.png"):
        assert main(["render", "--deep", "--output", str(tmp_path / name)]) == 0
        assert read_deep(tmp_path / "command_deep.exr")[1] == expected
        (tmp_path / "command_deep.exr").unlink()
    # The picture is there, and its samples are not.
    again = ["render", "--deep", "--skip-existing", "--output", str(tmp_path / "command.exr")]
    assert main(again) == 0 and read_deep(tmp_path / "command_deep.exr")[1] == expected
    written = os.stat(tmp_path / "command_deep.exr").st_mtime_ns
    assert main(again) == 0 and os.stat(tmp_path / "command_deep.exr").st_mtime_ns == written


def test_a_composite_writes_samples_of_each_frame(scene, cloud, tmp_path):
    bpy.ops.mrpnn.composite(shadows=False)
    scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.device = 1, False, "CPU"
    scene.frame_start, scene.frame_end = 3, 4
    scene.render.filepath = f"{tmp_path}/shot_####"
    bpy.ops.render.render(animation=True)
    assert sorted(path.name for path in tmp_path.glob("*deep*")) == [
        f"volumes_shot_000{frame}_deep.exr" for frame in (3, 4)
    ]


def test_light_groups_share_samples_and_a_frame_without_volumes_has_none(scene, cloud, tmp_path):
    scene.view_layers[0].lightgroups.add(name="key")
    bpy.data.objects["Sun"].lightgroup = "key"
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.2
    scene.render.filepath = str(tmp_path / "groups.exr")
    bpy.ops.render.render(write_still=True)
    check_flat(flattened(read_deep(tmp_path / "groups_deep.exr")[1]), combined(tmp_path / "groups.exr"))
    scene.camera.rotation_euler.y = 3.14159
    scene.render.filepath = str(tmp_path / "away.exr")
    bpy.ops.render.render(write_still=True)
    header, pixels = read_deep(tmp_path / "away_deep.exr")
    assert header["maxSamplesPerPixel"] == 0 and not any(samples for row in pixels for samples in row)


@pytest.mark.skipif(sys.platform == "win32" or not hasattr(os, "geteuid"), reason="folders that refuse files")
def test_a_deep_file_that_cannot_be_written_keeps_the_picture(scene, cloud, tmp_path, capfd):
    path = Path(tmp_path / "still_deep.exr")
    path.mkdir()
    (path / "taken").write_text("")
    scene.render.filepath = str(tmp_path / "still.exr")
    bpy.ops.render.render(write_still=True)
    assert combined(tmp_path / "still.exr")[..., 3].max() > 0.3
    assert "no deep samples are written" in capfd.readouterr().out
