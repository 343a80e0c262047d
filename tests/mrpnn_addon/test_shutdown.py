# SPDX-License-Identifier: GPL-3.0-or-later
"""No thread of the extension outlives its registration or the file that it works for, and its library is given back.

That threads end when Blender quits is tested in whole programs, in tests/package/test_programs.py.
"""

import sys
import threading
import time
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from inference import RenderCache
from inference.kernels import library, structures
from tests.support import blender_scenes


@pytest.fixture
def working(addon, scene, tmp_path):
    """The threads of a preview that renders for minutes, and of a worker that reads until it is told to stop."""
    blender_scenes.cloud_scene(scene, tmp_path)
    scene.render.resolution_x = scene.render.resolution_y = 4096
    scene.mrpnn.depth_samples = 64
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())
    preview = addon.mrpnn_addon.engine.preview

    class Reading(addon.mrpnn_addon.runtime.background.Worker):
        def __init__(self):
            self._start("mrpnn reading", awaited=True)

        def _work(self):
            while not self.stopped:
                time.sleep(0.01)

    before = set(threading.enumerate())
    started = [
        preview.Preview(described, described.camera, scene.mrpnn.settings(), preview.Prepared(RenderCache())),
        Reading(),
    ]
    threads = [thread for thread in threading.enumerate() if thread not in before and thread.name.startswith("mrpnn")]
    assert len(threads) == 2
    yield threads
    for thread in started:
        thread.stop()


@pytest.fixture
def unregistered(addon):
    """unregistered(): the extension is unregistered, until the test ends, whatever happens in it."""
    names = []

    def unregister():
        addon.unregister()
        names.append("unregistered")

    yield unregister
    if names:
        addon.register()


def test_loading_a_file_ends_all_threads(working):
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not any(thread.is_alive() for thread in working)


def test_unregistering_ends_all_threads(unregistered, working):
    unregistered()
    assert not any(thread.is_alive() for thread in working)


def test_work_in_the_background_is_waited_for(addon):
    background = addon.mrpnn_addon.runtime.background
    future = background.in_background(lambda: time.sleep(0.2) or "done")
    assert background.stop_threads(10.0) and future.result(0.0) == "done"
    with pytest.raises(ZeroDivisionError):
        background.in_background(lambda: 1 / 0).result(10.0)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="reads /proc")
def test_unregistering_gives_the_library_of_the_kernels_back(unregistered, monkeypatch, tmp_path):
    """A copy of it, since other tests hold the library itself."""
    copy = tmp_path / "mrpnn_kernels.so"
    copy.write_bytes(library.load_kernels().path.read_bytes())
    loaded = library.Kernels(copy)
    monkeypatch.setattr(library, "_kernels", loaded)
    assert str(copy) in Path("/proc/self/maps").read_text()
    unregistered()
    assert str(copy) not in Path("/proc/self/maps").read_text()
    # What still holds the kernels, such as a cache, loads them again.
    assert loaded.scratch_bytes(structures.Scene(), structures.Rays()) >= 0
    assert str(copy) in Path("/proc/self/maps").read_text()
    loaded.close()
