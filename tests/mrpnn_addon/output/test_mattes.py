# SPDX-License-Identifier: GPL-3.0-or-later
"""Cryptomattes of volumes, as Blender's own node reads them, and passes of position, depth and shadow."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes
from tests.support.exr_files import channels, header

SIZE = 24, 18
# Names with letters beyond ASCII, and whose hash would be no number: see test_numbers_of_names.
NAMES = "Cloud", "Rauch é"


@pytest.fixture
def clouds(scene, tmp_path):
    """Two clouds, one behind the other, before a floor; everything that is asked for here."""
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.mrpnn.depth_samples = 2
    scene.render.engine, scene.render.film_transparent = "MRPNN", True
    blender_scenes.write_multilayer(scene)
    blender_scenes.cloud_scene(scene, tmp_path)
    path = blender_scenes.write_vdb(tmp_path, blender_scenes.blob(), blender_scenes.centred(16, 1.5))
    second, _ = blender_scenes.add_volume(scene, path, NAMES[1], Density=3.0)
    second.location = 0.8, 0.3, -1.9
    layer = scene.view_layers[0]
    layer.use_pass_cryptomatte_object = layer.use_pass_cryptomatte_material = True
    layer.use_pass_position = layer.mrpnn.use_pass_median_depth = True
    return scene


def write(scene, tmp_path):
    """The files of F12 and of Render Volumes."""
    paths = [tmp_path / "f12.exr", tmp_path / "volumes.exr"]
    scene.render.use_compositing, scene.render.filepath = False, str(paths[0])
    bpy.ops.render.render(write_still=True)
    bpy.ops.mrpnn.render(filepath=str(paths[1]))
    scene.render.use_compositing = True
    return paths


def mattes_of(found, kind):
    """Coverage of each id, by its bits."""
    mattes = {}
    for number in range(3):
        images = [found[f"ViewLayer.{kind}{number:02}.{letter}"] for letter in "rgba"]
        for ids, share in (images[:2], images[2:]):
            for bits in np.unique(ids.view(np.uint32)[share > 0.0]).tolist():
                where = ids.view(np.uint32) == bits
                mattes[bits] = mattes.get(bits, 0.0) + np.where(where, share, 0.0)
    return mattes


def test_files_hold_mattes_as_specified(addon, clouds, tmp_path):
    for path in write(clouds, tmp_path):
        found, told = channels(path), header(path)
        keys = {key.split("/")[1] for key in told if key.startswith("cryptomatte/")}
        kinds = {}
        for key in keys:
            assert told[f"cryptomatte/{key}/hash"] == "MurmurHash3_32"
            assert told[f"cryptomatte/{key}/conversion"] == "uint32_to_float32"
            kinds[told[f"cryptomatte/{key}/name"]] = json.loads(told[f"cryptomatte/{key}/manifest"])
        assert set(kinds) == {"ViewLayer.CryptoObject", "ViewLayer.CryptoMaterial"}
        assert set(kinds["ViewLayer.CryptoObject"]) == set(NAMES)
        assert set(kinds["ViewLayer.CryptoMaterial"]) == {f"{name} fog" for name in NAMES}
        alpha = found["ViewLayer.Combined.A"]
        for name, manifest in kinds.items():
            mattes = mattes_of(found, name.split(".")[1])
            assert set(mattes) == {int(bits, 16) for bits in manifest.values()}
            np.testing.assert_allclose(sum(mattes.values()), alpha, atol=2e-4)
        # The largest coverage comes first.
        first, second = (found[f"ViewLayer.CryptoObject00.{letter}"] for letter in "ga")
        assert np.all(first >= second) and second.max() > 0.05


@pytest.mark.slow
def test_blenders_cryptomatte_node_reads_them(addon, clouds, tmp_path):
    """From F12's result and from files, in every case what one of the volumes covers."""
    paths = write(clouds, tmp_path)
    found = channels(paths[0])
    expected = mattes_of(found, "CryptoObject")[addon.mrpnn_addon.scene.cryptomatte.matte_id(NAMES[1])]
    tree, result = blender_scenes.compositor(clouds)
    matte = tree.nodes.new("CompositorNodeCryptomatteV2")
    layers = tree.nodes.new("CompositorNodeRLayers")
    tree.links.new(layers.outputs["Image"], matte.inputs["Image"])
    tree.links.new(matte.outputs["Matte"], result)
    for path in (None, *paths):
        matte.source = "IMAGE" if path else "RENDER"
        if path:
            matte.image = bpy.data.images.load(str(path))
        else:
            matte.scene = clouds
        matte.layer_name = "ViewLayer.CryptoObject"
        matte.matte_id = NAMES[1]
        shown = blender_scenes.rendered(clouds, tmp_path)[..., 0]
        np.testing.assert_allclose(shown, expected, atol=2e-3, err_msg=str(path))
    assert expected.max() > 0.3


def test_numbers_of_names(addon):
    module = addon.mrpnn_addon.scene.cryptomatte
    # Of the specification, and of the algorithm's author.
    assert [module.murmur3(text) for text in (b"", b"test", b"hello", b"hello, world")] == [
        0x00000000,
        0xBA6BD213,
        0x248BFA47,
        0x149BBB7F,
    ]
    numbers = [module.matte_id(f"name {number}") for number in range(20000)]
    assert np.isfinite(np.array(numbers, np.uint32).view(np.float32)).all()
    assert not any(bits >> 23 & 255 in (0, 255) for bits in numbers)
    assert any(module.murmur3(f"name {number}".encode()) >> 23 & 255 in (0, 255) for number in range(20000))


def test_more_volumes_than_levels_and_a_manifest_of_many(addon, scene, tmp_path):
    module, random = addon.mrpnn_addon.scene.cryptomatte, np.random.default_rng(0)
    names = [f"volume {number} with a name of some length" for number in range(60)]
    share = random.uniform(0.0, 0.01, (12, 60)).astype(np.float32)
    pixel, volume = (index.ravel() for index in np.indices(share.shape))
    coverage = addon.inference.image.layer.Coverage(pixel, volume, share.ravel(), names)
    images = module.matte_passes(coverage, names, (3, 4), 5)
    assert len(images) == 3 and not images[2][..., 2:].any()
    kept = np.stack([image[..., channel] for image in images for channel in (1, 3)], axis=-1)[..., :5]
    np.testing.assert_allclose(kept.reshape(12, 5), -np.sort(-share, axis=1)[:, :5])
    told = module.matte_metadata("ViewLayer.CryptoObject", names)
    (manifest,) = (text for key, text in told.items() if key.endswith("manifest"))
    assert len(manifest) > 2000 and len(json.loads(manifest)) == 60


def test_position_and_depth_are_where_half_of_the_opacity_is_in_front(addon, clouds, tmp_path):
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    settings = addon.inference.Settings(depth_samples=64, multiple=False, outputs=frozenset({"deep"}))
    deep = addon.inference.render(described.volumes, described.lights, described.camera, settings).deep
    camera = np.array(clouds.camera.matrix_world)
    for path in write(clouds, tmp_path):
        found = channels(path)
        depth, alpha = found["ViewLayer.Median Depth.Z"], found["ViewLayer.Combined.A"]
        assert np.all(depth[alpha == 0.0] == np.float32(1e10)) and np.any(alpha == 0.0)
        point = np.stack([found[f"ViewLayer.Position.{axis}"] for axis in "XYZ"], axis=-1)
        met = alpha > 0.02
        away = np.linalg.norm(point - camera[:3, 3], axis=-1)
        np.testing.assert_allclose(away[met], depth[met], rtol=1e-5)
        # Along the viewing axis, which is -Z, in the deep samples.
        along, ends = camera[2, 3] - point[..., 2], np.cumsum(deep.counts.ravel())
        for y, x in zip(*np.nonzero(met)):
            number = y * SIZE[0] + x
            span = slice(ends[number] - deep.counts[y, x], ends[number])
            fraction = np.clip((along[y, x] - deep.front[span]) / (deep.back[span] - deep.front[span]), 0.0, 1.0)
            passed = np.prod((1.0 - deep.rgba[span, 3]) ** fraction)
            assert (1.0 - passed) / alpha[y, x] == pytest.approx(0.5, abs=0.03)


def test_shadow_is_what_volumes_let_through_to_surfaces(addon, scene, tmp_path):
    """Below a slab of black smoke, exp(-depth) of a sun above it; elsewhere, and without a surface, 1."""
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.mrpnn.depth_samples = 1
    scene.render.engine, scene.render.film_transparent = "MRPNN", True
    blender_scenes.write_multilayer(scene)
    path = blender_scenes.write_vdb(tmp_path, np.ones((8, 8, 8)), blender_scenes.centred(8, 1.0))
    blender_scenes.add_volume(scene, path, "Slab", Density=1.2, Color=(0.0, 0.0, 0.0, 1.0))
    blender_scenes.add_sun(scene, rotation=(0.0, 0.0, 0.0))
    bpy.ops.mesh.primitive_plane_add(size=3.0, location=(0.0, 0.0, -1.0))
    blender_scenes.add_camera(scene, location=(0.0, 0.0, 5.0), ortho_scale=4.0)
    scene.view_layers[0].use_pass_shadow = True
    for path in write(scene, tmp_path):
        found = channels(path)
        shadow = np.stack([found[f"ViewLayer.Shadow.{c}"] for c in "RGB"], axis=-1)
        assert shadow[9, 12] == pytest.approx(np.exp(-1.2), rel=0.02)
        assert shadow[9, 5] == pytest.approx(1.0) and np.all(shadow[0, 0] == 1.0)
        dark = (shadow[..., 0] < 0.9).mean() * (SIZE[0] * SIZE[1]) / (SIZE[0] / 4.0) ** 2
        assert dark == pytest.approx(1.0, abs=0.4)


@pytest.mark.slow
def test_a_region_in_the_full_frame_has_its_passes_in_place(addon, clouds, tmp_path):
    clouds.render.use_border, clouds.render.use_crop_to_border = True, False
    clouds.render.border_min_x, clouds.render.border_max_x = 0.25, 0.75
    clouds.render.border_min_y, clouds.render.border_max_y = 0.25, 0.75
    clouds.mrpnn.use_deep = True
    part = channels(write(clouds, tmp_path)[1])
    clouds.render.use_border = False
    whole = channels(write(clouds, tmp_path)[1])
    inside = part["ViewLayer.Combined.A"] > 0.0
    for name in ("CryptoObject00.g", "Position.X", "Median Depth.Z"):
        one, other = part[f"ViewLayer.{name}"], whole[f"ViewLayer.{name}"]
        np.testing.assert_allclose(one[inside], other[inside], rtol=1e-3, atol=1e-4)
    assert inside.any() and not part["ViewLayer.CryptoObject00.g"][~inside].any()
