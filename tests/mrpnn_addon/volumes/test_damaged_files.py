# SPDX-License-Identifier: GPL-3.0-or-later
"""Damaged .vdb files and altered weights: refused with a reason, without a crash of Blender."""

import hashlib
import pathlib
import subprocess
import sys
import time

import numpy as np
import onnx
import pytest

bpy = pytest.importorskip("bpy")

from inference import SceneError
from inference.models import weights_file
from inference.network import network
from tests.support import blender_scenes
from tests.support.paths import ROOT

# Damaged files to try: for so many seconds, and at least so many.
CAMPAIGN, FEWEST = 15, 16
# Bytes at the beginning of the files to damage that describe the file and its grid.
DESCRIPTIONS = 700
CORPUS = ROOT / "tests" / "support" / "damaged_vdb"


@pytest.fixture
def trial(addon):
    return addon.mrpnn_addon.vdb.process


def refusal(addon):
    with pytest.raises(SceneError) as caught:
        addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    return str(caught.value)


def lit(scene):
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene)


def damaged(whole: bytes, number: int) -> bytes:
    """The file with a few bits flipped, bytes replaced, or cut off, by the number: in the tree or in its metadata."""
    random, changed = np.random.default_rng(number), bytearray(whole)
    low, high = (20, DESCRIPTIONS) if number // 4 % 4 == 3 else (DESCRIPTIONS, len(whole) - 8)
    if number % 4 == 0:
        return whole[: random.integers(low, high)]
    for place in random.integers(low, high, 1 + number % 3):
        if number % 4 == 1:
            changed[place] ^= 1 << random.integers(8)
        else:
            changed[place : place + 4] = (b"\xff\xff\xff\x7f", random.bytes(4), b"\0\0\0\0")[number % 3]
    return bytes(changed)


def wholes(folder):
    """Files to damage: a blob, the same in half precision, and a constant block stored as tiles beside a voxel."""
    vdb = blender_scenes.openvdb()
    blob, half, tiles = vdb.FloatGrid(), vdb.FloatGrid(), vdb.FloatGrid()
    for grid in (blob, half):
        grid.copyFromArray(blender_scenes.blob(12))
    half.saveFloatAsHalf = True
    tiles.fill((0, 0, 0), (31, 31, 31), 0.5)
    tiles.copyFromArray(np.ones((2, 1, 1), np.float32), ijk=(40, 40, 40))
    for name, grid in (("blob", blob), ("half", half), ("tiles", tiles)):
        grid.name, grid.gridClass = "density", "fog volume"
        path = folder / f"{name}.vdb"
        vdb.write(str(path), grids=[grid])
        yield path.read_bytes()


@pytest.mark.slow
def test_a_damaged_file_is_read_or_refused(addon, trial, tmp_path, monkeypatch):
    """Whatever happens to the process that reads it, this one goes on. As many as CAMPAIGN allows, always in one order.

    A file that ends badly here belongs into CORPUS.
    """
    monkeypatch.setattr(trial, "SECONDS", 2)
    monkeypatch.setattr(trial, "MEMORY", 2 << 30)
    read, files, outcomes = addon.mrpnn_addon.vdb.density_grid.read_density_grid, list(wholes(tmp_path)), []
    start = time.monotonic()
    for number in range(1000):
        if number >= FEWEST and time.monotonic() - start > CAMPAIGN:
            break
        path = tmp_path / f"damaged{number}.vdb"
        path.write_bytes(damaged(files[number % len(files)], number))
        try:
            grid = read(str(path), "density", "Cloud")
            assert grid.density.ndim == 3 and np.isfinite(grid.density).all()
            outcomes.append("read")
        except SceneError as error:
            assert '"Cloud"' in str(error)
            outcomes.append("refused")
        path.unlink()
    assert set(outcomes) == {"read", "refused"}


@pytest.mark.slow
def test_files_on_which_openvdb_hangs_are_refused(addon, trial):
    """Found by flipping bits; the reading process is killed, this one goes on."""
    for path in sorted(CORPUS.glob("*.vdb")):
        ended = subprocess.run(
            [
                sys.executable,
                "-I",
                trial.PROGRAM,
                path,
                "density",
                "1000000",
                "1",
                str(4 << 30),
                *addon.mrpnn_addon.vdb.openvdb_module.FOLDERS,
            ],
            capture_output=True,
        )
        assert trial._died(ended.returncode), path.name


def test_a_file_that_is_being_rewritten_is_refused(addon, scene, tmp_path, trial, monkeypatch):
    """Blender has read its complete metadata; OpenVDB would hang on the truncated file."""
    path = blender_scenes.write_vdb(tmp_path, blender_scenes.blob())
    blender_scenes.add_volume(scene, path)
    lit(scene)
    assert addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph()).volumes
    whole = pathlib.Path(path).read_bytes()
    pathlib.Path(path).write_bytes((CORPUS / "cut_in_its_descriptions.vdb").read_bytes())
    monkeypatch.setattr(trial, "SECONDS", 1)
    assert f'"Cloud": grid "density" of {path} is damaged' in refusal(addon)
    pathlib.Path(path).write_bytes(whole)
    assert addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph()).volumes


def test_a_crash_of_the_reading_process_is_a_message(addon, scene, tmp_path, trial, monkeypatch):
    path = blender_scenes.write_vdb(tmp_path, blender_scenes.blob())
    blender_scenes.add_volume(scene, path)
    lit(scene)
    with monkeypatch.context() as short:
        # No processor time at all: the system ends the process, as it does where a file takes too long.
        short.setattr(trial, "SECONDS", 0)
        assert f'"Cloud": grid "density" of {path} is damaged' in refusal(addon)
    with monkeypatch.context() as small:
        small.setattr(trial, "MEMORY", 1 << 20)
        assert "is damaged" in refusal(addon)
    assert addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph()).volumes


def test_openvdbs_own_error_messages_are_kept(addon, scene, tmp_path):
    whole = pathlib.Path(blender_scenes.write_vdb(tmp_path, blender_scenes.blob())).read_bytes()
    path = tmp_path / "cut.vdb"
    path.write_bytes(whole[: len(whole) - 2000])
    blender_scenes.add_volume(scene, path)
    lit(scene)
    assert '"Cloud"' in refusal(addon)


def test_grids_far_apart_do_not_share_a_bounding_box(addon, scene, tmp_path):
    vdb = blender_scenes.openvdb()
    grids = []
    for name, low in (("density", (0, 0, 0)), ("heat", (100000, 100000, 100000))):
        grid = vdb.FloatGrid()
        grid.copyFromArray(np.ones((3, 3, 3), np.float32), ijk=low)
        grid.name, grid.gridClass = name, "fog volume"
        grids.append(grid)
    path = str(tmp_path / "apart.vdb")
    vdb.write(path, grids=grids)
    cloud, node = blender_scenes.add_volume(scene, path)
    tree = cloud.data.materials[0].node_tree
    sum_of = tree.nodes.new("ShaderNodeMath")
    sum_of.operation = "ADD"
    for socket, name in zip(sum_of.inputs, ("density", "heat")):
        attribute = tree.nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = name
        tree.links.new(attribute.outputs["Fac"], socket)
    node.inputs["Density Attribute"].default_value = ""
    tree.links.new(sum_of.outputs[0], node.inputs["Density"])
    lit(scene)
    assert "far apart" in refusal(addon)


@pytest.fixture
def weights(tmp_path, monkeypatch):
    """The shipped network in a folder of its own."""
    for path in weights_file.WEIGHTS.glob("mrpnn.*"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    monkeypatch.setattr(weights_file, "WEIGHTS", tmp_path)
    return tmp_path


def sign(folder):
    """Set the checksum to that of the file."""
    digest = hashlib.sha256((folder / "mrpnn.onnx").read_bytes()).hexdigest()
    (folder / "mrpnn.sha256").write_text(f"{digest}  mrpnn.onnx\n")


@pytest.mark.parametrize("place", [0, 100, 400_000, -1])
def test_one_flipped_bit_in_the_weights_is_found(weights, place):
    content = bytearray((weights / "mrpnn.onnx").read_bytes())
    content[place] ^= 1
    (weights / "mrpnn.onnx").write_bytes(content)
    with pytest.raises(SceneError, match="'mrpnn' cannot be read.*checksum"):
        network.load_network("mrpnn")


def test_weights_without_a_checksum_are_refused(weights):
    (weights / "mrpnn.sha256").unlink()
    with pytest.raises(SceneError, match="checksum cannot be read"):
        network.load_network("mrpnn")


def test_weights_in_another_file_are_refused(weights):
    model = onnx.load(weights / "mrpnn.onnx")
    tensor = model.graph.initializer[0]
    onnx.external_data_helper.set_external_data(tensor, location="../../outside.bin")
    tensor.ClearField("raw_data")
    (weights / "mrpnn.onnx").write_bytes(model.SerializeToString())
    sign(weights)
    with pytest.raises(SceneError, match="outside their file"):
        network.load_network("mrpnn")


@pytest.mark.parametrize(
    "key, value",
    [
        ("kind", "pickle"),
        ("points", "AAAA"),
        ("points", "%%"),
        ("configuration", "{"),
        ("configuration", "[]"),
        ("configuration", '{"anisotropy_range": [1, -1], "sigma_hat_range": [1, 2]}'),
        ("configuration", '{"anisotropy_range": [0, NaN], "sigma_hat_range": [1, 2]}'),
    ],
)
def test_invalid_metadata_is_refused(weights, key, value):
    model = onnx.load(weights / "mrpnn.onnx")
    for entry in model.metadata_props:
        if entry.key == key:
            entry.value = value
    (weights / "mrpnn.onnx").write_bytes(model.SerializeToString())
    sign(weights)
    with pytest.raises(SceneError, match="'mrpnn' cannot be read"):
        network.load_network("mrpnn")
