# SPDX-License-Identifier: GPL-3.0-or-later
"""Files are written completely or not at all: full disks, limits, unwritable folders, killed processes."""

import os
import re
import resource
import signal
import subprocess
import sys
import time

import numpy as np
import pytest

# Before OpenEXR: its compiled libraries must come first.
bpy = pytest.importorskip("bpy")
pytestmark = pytest.mark.blender

from tests.support import blender_scenes
from tests.support.exr_files import channels
from tests.support.paths import ROOT

# Noise does not compress: 3 MB.
PICTURE = {"Z": np.random.default_rng(0).random((768, 1024), np.float32)}


@pytest.fixture
def write_exr(addon):
    return addon.mrpnn_addon.output.exr_file.write_exr


@pytest.fixture
def atomic_write(addon):
    return addon.mrpnn_addon.runtime.atomic_write.atomic_write


@pytest.fixture
def files_of_a_megabyte():
    """No file of this process may grow beyond a megabyte."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1 << 20, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.fixture
def full_disk(tmp_path):
    """A file system of one megabyte."""
    folder = tmp_path / "disk"
    folder.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", folder], capture_output=True).returncode:
        pytest.skip("only an administrator can mount a small file system")
    yield folder
    subprocess.run(["umount", folder], check=True)


def test_a_limit_on_files_keeps_the_old_one(tmp_path, files_of_a_megabyte, write_exr):
    path = tmp_path / "layer.exr"
    path.write_bytes(b"old")
    with pytest.raises(OSError, match="cannot write .*layer.exr: File too large"):
        write_exr(str(path), PICTURE, {})
    assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["layer.exr"]


def test_writing_can_be_cancelled(tmp_path, addon, write_exr):
    """While scan lines are compressed, and while they are written."""
    path, asked = tmp_path / "layer.exr", []
    path.write_bytes(b"old")

    class Stopped(Exception):
        pass

    def check():
        asked.append(len(asked))
        if len(asked) > before:
            raise Stopped()

    lines = PICTURE["Z"].shape[0] // addon.mrpnn_addon.output.exr_file.LINES_PER_BLOCK
    for before in (3, lines + 3):  # noqa: B007 (check reads it)
        asked.clear()
        with pytest.raises(Stopped):
            write_exr(str(path), PICTURE, {}, check)
        assert path.read_bytes() == b"old" and os.listdir(tmp_path) == ["layer.exr"]
    asked.clear()
    before = 2 * lines
    write_exr(str(path), PICTURE, {}, check)
    np.testing.assert_array_equal(channels(path)["Z"], PICTURE["Z"])


def test_a_full_disk_keeps_the_old_file(full_disk, write_exr):
    path = full_disk / "layer.exr"
    path.write_bytes(b"old")
    with pytest.raises(OSError, match="cannot write .*layer.exr: No space left"):
        write_exr(str(path), PICTURE, {})
    assert path.read_bytes() == b"old" and os.listdir(full_disk) == ["layer.exr"]


def test_a_read_only_disk_keeps_the_old_file(full_disk, write_exr):
    path = full_disk / "layer.exr"
    path.write_bytes(b"old")
    subprocess.run(["mount", "-o", "remount,ro", full_disk], check=True)
    with pytest.raises(OSError, match="cannot write .*layer.exr: Read-only file system"):
        write_exr(str(path), PICTURE, {})
    assert path.read_bytes() == b"old" and os.listdir(full_disk) == ["layer.exr"]


def fill(folder):
    """Leave a few kilobytes of a disk."""
    (folder / "other").write_bytes(bytes((1 << 20) - (4 << 10)))


def bake_light(folder):
    bpy.ops.mrpnn.bake_light(folder=str(folder / "light"), directional=True)


def bake_animation(folder):
    bpy.ops.mrpnn.bake_animation(folder=str(folder / "light"), directional=True)


def command(*arguments):
    def run(folder):
        from mrpnn.operators.command import main

        assert main([word.replace("DISK", str(folder)) for word in arguments]) == 1

    return run


# Ways to files, and the ending of the first of them.
WAYS = {
    "bake light": (bake_light, "vdb"),
    "bake animation": (bake_animation, "vdb"),
    "command bake": (command("bake", "--folder", "DISK/light"), "vdb"),
    "command png": (command("render", "--output", "DISK/cloud.png"), "png"),
    "command exr": (command("render", "--output", "DISK/cloud.exr"), "exr"),
    "command flipbook": (command("flipbook", "--output", "DISK/cloud.exr", "--size", "256"), "exr"),
    "saved bake": (
        command("bake", "--no-directions", "--folder", "DISK/../light", "--save", "DISK/lit.blend"),
        "blend",
    ),
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("is_read_only", [False, True], ids=["full", "read-only"])
def test_a_full_or_read_only_disk_is_told_by_every_way_to_files(
    addon, scene, tmp_path, full_disk, capfd, way, is_read_only
):
    """Libraries that write for us may not notice. What was there stays, and nothing is left."""
    blender_scenes.cloud_scene(scene, tmp_path)
    scene.render.resolution_x = scene.render.resolution_y = 160
    scene.frame_end, scene.view_settings.view_transform = 1, "Standard"
    call, ending = WAYS[way]
    fill(full_disk)
    if is_read_only:
        subprocess.run(["mount", "-o", "remount,ro", full_disk], check=True)
    before = sorted(path for path in full_disk.rglob("*") if path.is_file())
    error = ""
    try:
        call(full_disk)
    except RuntimeError as problem:
        error = str(problem)
    said = error + "".join(capfd.readouterr())
    reason = "Read-only file system" if is_read_only else "No space left on device|incomplete|No such file"
    made = "cannot make the folder .*light" if is_read_only and ending == "vdb" else f"cannot write .*[.]{ending}"
    assert re.search(f"{made}.*: .*({reason})", said), said
    assert "Traceback" not in said and "which is a bug" not in said
    assert sorted(path for path in full_disk.rglob("*") if path.is_file()) == before


@pytest.mark.parametrize("folder", ["/proc", "/nowhere/at/all"])
def test_an_unwritable_folder_is_named(folder, write_exr):
    with pytest.raises(OSError, match=f"cannot write {folder}/layer.exr: "):
        write_exr(f"{folder}/layer.exr", PICTURE, {})


def test_any_file_name_works(tmp_path, write_exr):
    path = tmp_path / "Wolke über dem Meer 雲 'n' $HOME" / "Ebene 層 #1.exr"
    path.parent.mkdir()
    write_exr(str(path), PICTURE, {"höhe": "5 m"})
    np.testing.assert_array_equal(channels(path)["Z"], PICTURE["Z"])
    assert os.listdir(path.parent) == [path.name]


def test_a_symbolic_link_is_replaced_not_followed(tmp_path, atomic_write):
    """The link is replaced, not the file that it points to."""
    (tmp_path / "precious").write_bytes(b"old")
    (tmp_path / "layer.exr").symlink_to(tmp_path / "precious")
    with atomic_write(str(tmp_path / "layer.exr")) as file:
        file.write(b"new")
    assert (tmp_path / "precious").read_bytes() == b"old" and not (tmp_path / "layer.exr").is_symlink()


def test_an_error_while_writing_leaves_nothing(tmp_path, atomic_write):
    with pytest.raises(RuntimeError), atomic_write(str(tmp_path / "layer.exr")) as file:
        file.write(b"half")
        raise RuntimeError("in the middle")
    assert os.listdir(tmp_path) == []


def test_killed_while_writing_the_old_file_stays(tmp_path, write_exr):
    path = tmp_path / "layer.exr"
    path.write_bytes(b"old")
    program = (
        "import sys, time; from mrpnn_addon.runtime.atomic_write import atomic_write\n"
        "with atomic_write(sys.argv[1]) as file:\n    file.write(b'x' * 100000); file.flush(); time.sleep(600)"
    )
    writer = subprocess.Popen([sys.executable, "-c", program, path], cwd=ROOT)
    while not list(tmp_path.glob(".mrpnn-*.part")) and writer.poll() is None:
        time.sleep(0.01)
    writer.send_signal(signal.SIGKILL)
    assert writer.wait() == -signal.SIGKILL
    assert path.read_bytes() == b"old"
    # The next render works.
    write_exr(str(path), PICTURE, {})
    np.testing.assert_array_equal(channels(path)["Z"], PICTURE["Z"])
