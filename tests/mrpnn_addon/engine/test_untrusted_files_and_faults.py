# SPDX-License-Identifier: GPL-3.0-or-later
"""Untrusted .blend files, and faults during a render."""

import os
import sys
import threading
import time

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import RenderCache, SceneError
from inference.models import weights_file
from inference.network import network
from inference.network.baselines import Baseline, BaselinePredictor, SingleScattering
from tests.support import blender_scenes

# Python's audit events; hooks stay for the life of the process, so this one has a switch.
_told = None


@sys.addaudithook
def _listen(event, arguments):
    if _told is not None and event.startswith(
        (
            "socket.",
            "urllib.",
            "http.",
            "ftplib.",
            "os.exec",
            "os.posix_spawn",
            "os.system",
            "subprocess.",
            "ctypes.dlopen",
            "import",
            "open",
        )
    ):
        _told.append((event, arguments))


@pytest.fixture
def told():
    """Audit events while the test runs, as (name, arguments)."""
    global _told
    _told = []
    yield _told
    _told = None


@pytest.fixture
def cloud(scene, tmp_path):
    scene.render.resolution_x, scene.render.resolution_y = 24, 16
    scene.mrpnn.depth_samples = 2
    return blender_scenes.cloud_scene(scene, tmp_path)


def test_a_render_opens_no_connection_and_writes_only_its_output(addon, scene, cloud, tmp_path, told):
    path = tmp_path / "layer.exr"
    bpy.ops.mrpnn.render(filepath=str(path))
    assert not [event for event, _ in told if event.startswith(("socket", "urllib", "http", "ftplib"))]
    # The only process is the one that reads the .vdb file.
    commands = [arguments[1] for event, arguments in told if event == "subprocess.Popen"]
    assert all(os.path.join("vdb", "worker.py") in str(command) for command in commands) and len(commands) <= 1
    written = {
        str(arguments[0])
        for event, arguments in told
        if event == "open" and isinstance(arguments[1], str) and set(arguments[1]) & set("wxa+")
    }
    # Its output, and the machine's measured speed in the extension's own folder.
    own = os.path.dirname(addon.mrpnn_addon.status.calibration._path())
    assert all(str(tmp_path) in name or own in name or name == "/dev/null" for name in written)
    assert path.exists()


def test_a_scene_cannot_name_a_model_that_is_not_shipped(addon, scene, cloud):
    with pytest.raises(TypeError):
        scene.mrpnn.model = "../../tmp/evil"
    # As a file may store it: a number of no network.
    scene.mrpnn["model"] = 12345
    assert scene.mrpnn.settings().model == "mrpnn"
    bpy.ops.mrpnn.render()
    with pytest.raises(SceneError, match="no network called"):
        network.load_network(str(weights_file.WEIGHTS / "mrpnn"))


@pytest.mark.parametrize("name", ["bashrc", "authorized_keys", "startup.py", "layer.exr.py"])
def test_a_scenes_output_path_replaces_only_exr_files(addon, scene, cloud, tmp_path, name):
    (tmp_path / name).write_text("precious")
    scene.mrpnn.use_exr, scene.mrpnn.exr_path = True, str(tmp_path / name)
    with pytest.raises(RuntimeError, match="must end in .exr"):
        bpy.ops.mrpnn.render()
    assert (tmp_path / name).read_text() == "precious"


def test_a_scripts_folder_beside_the_file_is_not_imported(addon, scene, cloud, tmp_path, monkeypatch, told):
    for name in ("openvdb", "pyopenvdb", "onnxruntime", "numpy", "inference"):
        (tmp_path / f"{name}.py").write_text("raise SystemExit('code of a stranger')")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    monkeypatch.chdir(tmp_path)
    bpy.ops.mrpnn.render()
    assert not [arguments for event, arguments in told if event == "import" and str(tmp_path) in str(arguments)]


def job(addon, scene, path=None):
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    return addon.mrpnn_addon.engine.render_job.RenderJob(described, scene.mrpnn.settings(), path)


def test_two_renders_at_once_and_a_scene_that_changes_under_them(addon, scene, cloud, tmp_path):
    alone = job(addon, scene)
    alone.wait()
    both = [job(addon, scene, str(tmp_path / "layer.exr")) for _ in range(2)]
    # The workers own what they read: the scene's data is removed while they render.
    for data in (bpy.data.objects, bpy.data.volumes, bpy.data.materials, bpy.data.lights, bpy.data.cameras):
        for block in list(data):
            data.remove(block)
    for worker in both:
        worker.wait()
        np.testing.assert_array_equal(worker.result.layer.rgb, alone.result.layer.rgb)
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".exr", ".vdb"]


@pytest.mark.parametrize("stage", ["shadows", "single", "multiple"])
def test_rendering_can_be_cancelled_in_every_stage(addon, scene, cloud, tmp_path, stage):
    scene.render.resolution_x = scene.render.resolution_y = 256
    scene.mrpnn.depth_samples = 64
    worker = job(addon, scene, str(tmp_path / "layer.exr"))
    while stage not in worker.message and not worker.done:
        time.sleep(0.001)
    # In processor time: a second with two threads, however busy the machine.
    start = time.process_time()
    worker.stop()
    worker.wait()
    assert time.process_time() - start < 2.0
    assert worker.cancelled and not (tmp_path / "layer.exr").exists()
    assert not [thread for thread in threading.enumerate() if thread.name == "mrpnn render"]


def test_rendering_can_be_cancelled_while_writing(addon, scene, cloud, tmp_path):
    """A large, nearly empty picture; the old file stays."""
    scene.render.resolution_x = scene.render.resolution_y = 2048
    scene.camera.data.angle = 3.0
    (tmp_path / "layer.exr").write_bytes(b"old")
    worker = job(addon, scene, str(tmp_path / "layer.exr"))
    while "writing" not in worker.message and not worker.done:
        time.sleep(0.001)
    time.sleep(0.1)
    start = time.process_time()
    worker.stop()
    worker.wait()
    assert worker.cancelled and time.process_time() - start < 1.0
    assert (tmp_path / "layer.exr").read_bytes() == b"old"
    assert sorted(path.suffix for path in tmp_path.iterdir()) == [".exr", ".vdb"]


class Breaks(Baseline):
    """A model that fails in the middle of a render, as a bug would."""

    def predictor(self, volume, cube, anisotropy, cancel=None):
        return BreakingPredictor(self.name, cube, anisotropy)


class BreakingPredictor(BaselinePredictor):
    def prepare(self, conditions, tasks=None):
        return BreakingPrediction()


class BreakingPrediction(SingleScattering):
    def predict(self, points, albedos):
        raise ZeroDivisionError("in a thread")


@pytest.fixture
def breaks(addon, monkeypatch):
    monkeypatch.setitem(network._systems, "breaks", lambda: Breaks("breaks"))


def test_an_exception_in_a_render_thread_ends_that_render_alone(addon, scene, cloud, tmp_path, breaks):
    scene.render.engine, scene.render.filepath = "MRPNN", str(tmp_path / "frame.png")
    (tmp_path / "frame.png").write_bytes(b"old")
    scene.mrpnn.model = "breaks"
    with pytest.raises(RuntimeError, match="which is a bug: ZeroDivisionError: in a thread"):
        bpy.ops.render.render(write_still=True)
    worker = job(addon, scene, str(tmp_path / "layer.exr"))
    worker.wait()
    assert isinstance(worker.error, ZeroDivisionError) and not (tmp_path / "layer.exr").exists()
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    module = addon.mrpnn_addon.engine.preview
    preview = module.Preview(described, described.camera, scene.mrpnn.settings(), module.Prepared(RenderCache()))
    while not preview.done:
        time.sleep(0.01)
    assert "which is a bug" in preview.message
    assert (tmp_path / "frame.png").read_bytes() == b"old"
    assert not [thread for thread in threading.enumerate() if thread.name.startswith("mrpnn")]
    scene.mrpnn.model = "mrpnn"
    bpy.ops.render.render(write_still=True)
    assert (tmp_path / "frame.png").stat().st_size > 100


@pytest.mark.slow
def test_too_little_memory_is_a_message(addon, scene, cloud):
    """The memory limit allows the render, the operating system does not."""
    resource = pytest.importorskip("resource")
    scene.render.resolution_x = scene.render.resolution_y = 8192
    scene.mrpnn.memory_limit = 1024
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    before = resource.getrlimit(resource.RLIMIT_AS)
    with open("/proc/self/statm") as file:
        held = int(file.read().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (held + (1 << 30), before[1]))
    try:
        with pytest.raises(SceneError, match="not enough memory"):
            addon.mrpnn_addon.engine.render_job.render_scene(described, scene.mrpnn.settings())
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
    scene.render.resolution_x = scene.render.resolution_y = 16
    assert bpy.ops.mrpnn.render() == {"FINISHED"}
