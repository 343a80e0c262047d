# SPDX-License-Identifier: GPL-3.0-or-later
"""Layers as EXR files, Image data-blocks and display-ready files."""

import json
import os

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

# After bpy: the other way round, the process hangs when it ends.
import OpenEXR

from inference import Layer
from tests.support import blender_scenes


@pytest.fixture
def layer(addon):
    """Random values, taller than one compressed block and not a multiple of it; infinite depth in places."""
    random = np.random.default_rng(5)
    shape = (37, 21)
    single, multiple = (random.uniform(0, 3, (*shape, 3)).astype(np.float32) for _ in range(2))
    alpha = random.uniform(0.1, 1, shape).astype(np.float32)
    depth = np.where(random.random(shape) < 0.3, np.inf, random.uniform(1, 9, shape)).astype(np.float32)
    single[:5], multiple[:5], alpha[:5] = 0.0, 0.0, 0.0
    return Layer(
        1.2 * single + multiple, alpha, depth, single, multiple, uncertainty=0.1 * alpha, emission=0.2 * single
    )


def channels(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}, dict(file.header())


def test_openexr_reads_what_was_written(addon, layer, tmp_path):
    path = tmp_path / "layer.exr"
    metadata = {"Frame": 12, "model": "mrpnn", "seconds": 1.25, "words": "déjà vu"}
    addon.mrpnn_addon.output.layer_exr.write_layer(str(path), layer, "Fog", metadata)
    found, header = channels(path)
    assert set(found) == {
        *(f"Fog.{name}.{c}" for name in ("Combined", "Single", "Multiple", "Emission") for c in "RGB"),
        "Fog.Combined.A",
        "Fog.Alpha.A",
        "Fog.Depth.Z",
        "Fog.Uncertainty.X",
    }
    for name, values in (
        ("Combined", layer.rgb),
        ("Single", layer.single),
        ("Multiple", layer.multiple),
        ("Emission", layer.emission),
    ):
        for index, c in enumerate("RGB"):
            np.testing.assert_array_equal(found[f"Fog.{name}.{c}"], values[..., index])
    np.testing.assert_array_equal(found["Fog.Alpha.A"], layer.alpha)
    np.testing.assert_array_equal(found["Fog.Combined.A"], layer.alpha)
    np.testing.assert_array_equal(found["Fog.Uncertainty.X"], layer.uncertainty)
    finite = np.isfinite(layer.depth)
    np.testing.assert_array_equal(found["Fog.Depth.Z"][finite], layer.depth[finite])
    assert np.all(found["Fog.Depth.Z"][~finite] == np.float32(1e10))
    assert header["compression"] == OpenEXR.ZIP_COMPRESSION
    for name, value in metadata.items():
        assert header[name] == value


@pytest.mark.parametrize("shape", [(1, 1), (16, 3), (17, 1), (40, 130)])
def test_any_size_and_long_names(addon, tmp_path, shape):
    random = np.random.default_rng(1)
    written = {
        "ViewLayer with a name beyond thirty-one bytes.Combined.R": random.random(shape, np.float32),
        "Z": np.zeros(shape, np.float32),
        "A": np.full(shape, np.nan, np.float32),
    }
    path = tmp_path / "any.exr"
    addon.mrpnn_addon.output.exr_file.write_exr(str(path), written, {})
    found, _ = channels(path)
    assert set(found) == set(written)
    for name, values in written.items():
        np.testing.assert_array_equal(found[name], values)


def test_zeros_compress(addon, tmp_path):
    path = tmp_path / "zeros.exr"
    addon.mrpnn_addon.output.exr_file.write_exr(str(path), {"Z": np.zeros((512, 512), np.float32)}, {})
    assert path.stat().st_size < 512 * 512 * 4 / 100


def test_a_write_that_fails_leaves_nothing_and_keeps_the_old_file(addon, layer, tmp_path):
    write = addon.mrpnn_addon.output.layer_exr.write_layer
    with pytest.raises(OSError):
        write(str(tmp_path / "missing" / "layer.exr"), layer, "Fog", {})
    path = tmp_path / "layer.exr"
    path.write_bytes(b"old")
    with pytest.raises(ValueError, match="255"):
        write(str(path), layer, "F" * 300, {})
    # A folder cannot be replaced by a file: the failure comes at the very last step.
    (tmp_path / "folder.exr").mkdir()
    with pytest.raises(OSError):
        write(str(tmp_path / "folder.exr"), layer, "Fog", {})
    assert path.read_bytes() == b"old"
    assert sorted(os.listdir(tmp_path)) == ["folder.exr", "layer.exr"]


def test_blenders_compositor_sees_the_layers(addon, scene, layer, tmp_path):
    path = tmp_path / "layer.exr"
    addon.mrpnn_addon.output.layer_exr.write_layer(str(path), layer, "ViewLayer", {})
    tree, result = blender_scenes.compositor(scene)
    node = tree.nodes.new("CompositorNodeImage")
    node.image = bpy.data.images.load(str(path))
    assert node.image.type == "MULTILAYER"
    assert {"Combined", "Alpha", "Depth", "Single", "Multiple"} <= {output.name for output in node.outputs}
    # Through the compositor and out again, the multiple layer is what was written.
    tree.links.new(node.outputs["Multiple"], result)
    scene.render.resolution_y, scene.render.resolution_x = layer.alpha.shape
    blender_scenes.add_camera(scene)
    composed = blender_scenes.render_cycles(scene, tmp_path, samples=1)
    np.testing.assert_allclose(composed[..., :3], layer.multiple, rtol=1e-6)


def pixels(image):
    values = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)


def test_the_image_holds_the_layer_and_is_reused(addon, scene, layer):
    show = addon.mrpnn_addon.output.layer_image.show_in_image
    image = show(layer)
    assert image.is_float and image.alpha_mode == "PREMUL" and image.colorspace_settings.name == "Linear Rec.709"
    # Blender's rows start at the bottom.
    np.testing.assert_array_equal(pixels(image)[::-1, :, :3], layer.rgb)
    np.testing.assert_array_equal(pixels(image)[::-1, :, 3], layer.alpha)

    smaller = type(layer)(*(values[:10, :7] for values in list(vars(layer).values())[:7]))
    assert show(smaller) == image and tuple(image.size) == (7, 10)
    np.testing.assert_array_equal(pixels(image)[::-1, :, :3], smaller.rgb)
    assert len(bpy.data.images) == 1


def test_a_packed_image_of_the_name_is_replaced_for_its_users(addon, scene, layer):
    show = addon.mrpnn_addon.output.layer_image.show_in_image
    show(layer).pack()
    texture = bpy.data.textures.new("User", "IMAGE")
    texture.image = bpy.data.images["MRPNN"]
    image = show(layer)
    assert [image.name for image in bpy.data.images] == ["MRPNN"] and texture.image == image
    np.testing.assert_array_equal(pixels(image)[::-1, :, 3], layer.alpha)


def test_png_has_the_view_transform_applied(addon, scene, layer, tmp_path):
    output = addon.mrpnn_addon.output.layer_image
    scene.view_settings.view_transform = "Standard"
    scene.render.image_settings.file_format = "OPEN_EXR"
    image = output.show_in_image(layer)
    path = tmp_path / "shown.png"
    output.save_view_transformed(image, str(path), scene)
    assert scene.render.image_settings.file_format == "OPEN_EXR"
    from PIL import Image

    with Image.open(path) as png:
        assert png.mode == "RGBA"
        found = np.asarray(png) / 255.0
    # PNG holds straight alpha: sRGB of the colour divided by alpha.
    colour = np.clip(layer.rgb / np.maximum(layer.alpha, 1e-6)[..., None], 0, 1)
    srgb = np.where(colour <= 0.0031308, 12.92 * colour, 1.055 * colour ** (1 / 2.4) - 0.055)
    covered = layer.alpha > 0.05
    np.testing.assert_allclose(found[..., 3], layer.alpha, atol=1 / 255)
    np.testing.assert_allclose(found[covered][:, :3], srgb[covered], atol=2 / 255)
    with pytest.raises(OSError):
        output.save_view_transformed(image, str(tmp_path / "missing" / "x.png"), scene)
    assert os.listdir(tmp_path) == ["shown.png"]


def test_a_region_lies_in_the_full_frame_or_is_cropped(addon, layer):
    inference, in_frame = addon.inference, addon.mrpnn_addon.output.layer_frame.in_frame
    camera = inference.Camera(np.eye(4), resolution=(50, 60), region=(4, 9, 4 + 21, 9 + 37))
    assert in_frame(layer, camera, crop=True) is layer
    full = in_frame(layer, camera, crop=False)
    assert full.rgb.shape == (60, 50, 3) and full.alpha.shape == (60, 50)
    np.testing.assert_array_equal(full.rgb[9:46, 4:25], layer.rgb)
    np.testing.assert_array_equal(full.depth[9:46, 4:25], layer.depth)
    assert full.alpha.sum(dtype=float) == pytest.approx(layer.alpha.sum(dtype=float))
    assert np.all(np.isinf(full.depth[:9])) and np.all(full.multiple[46:] == 0.0)


def test_metadata_holds_settings_network_and_seconds(addon, tmp_path):
    inference, job = addon.inference, addon.mrpnn_addon.engine.render_job
    report = inference.Report(model="mrpnn", checksum="abc", seconds={"march": 0.5, "network loading": 0.25})
    scene = addon.mrpnn_addon.scene.reader.SceneDescription(frame=7)
    found = job.metadata(scene, inference.Settings(depth_samples=5, seed=3), report)
    addon.mrpnn_addon.output.exr_file.write_exr(str(tmp_path / "x.exr"), {"A": np.zeros((2, 2), np.float32)}, found)
    header = channels(tmp_path / "x.exr")[1]
    assert header["Frame"] == 7 and header["mrpnn.depthSamples"] == 5 and header["mrpnn.seed"] == 3
    assert header["mrpnn.model"] == "mrpnn" and header["mrpnn.modelChecksum"] == "abc"
    assert header["mrpnn.seconds.march"] == 0.5 and header["mrpnn.seconds.network_loading"] == 0.25
    assert json.loads(header["mrpnn.report"])["checksum"] == "abc"
