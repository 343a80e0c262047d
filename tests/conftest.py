# SPDX-License-Identifier: GPL-3.0-or-later
"""What every test shares: markers, what a run leaves out, the order of files, and fixtures.

Tests are quick unless marked `slow`. Those whose fixtures or imports need the bpy module are marked `blender` here.
"""

import os
import sys
from collections import Counter
from pathlib import Path

import pytest

from tests.support.locks import locked
from tests.support.paths import SHARED
from tests.support.window import SCENE, SUITES, opened

# How many tests of each kind this run leaves out.
LEFT_OUT = pytest.StashKey[dict]()
# Seconds of a quick test, and of a slow one that does not state them: for the order of files.
QUICK, SLOW = 0.5, 5.0

# The bpy module may hang for ever at the end of a process in which something still refers to its
# types, as the traceback of a failed test does: leave without it, once pytest has said everything.
_status = None


def pytest_sessionfinish(exitstatus):
    global _status
    _status = int(exitstatus)


@pytest.hookimpl(trylast=True)
def pytest_unconfigure():
    if "bpy" in sys.modules and _status is not None:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(_status)


def pytest_addoption(parser):
    parser.addoption("--all", action="store_true", help="run slow tests and those that drive windows, too")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_collection_modifyitems(config, items):
    _mark(items)
    _leave_to_newest(config, items)
    _longest_first(items)
    # -k and -m choose among them.
    yield
    # A file or test that is named runs with all that is in it.
    named = any(name.partition("::")[0].endswith(".py") for name in config.args)
    if not (config.option.all or config.option.markexpr or named):
        _leave_out(config, items)


def _mark(items):
    for item in items:
        if "addon" in item.fixturenames or hasattr(item.module, "bpy"):
            item.add_marker("blender")
        # One worker runs a whole file, for its fixtures, and all that drives the one screen of a Blender.
        item.add_marker(pytest.mark.xdist_group(_group(item)))


def _leave_to_newest(config, items):
    """Tests of what our own code does with a window, which versions of Blender do not change, run in the last named."""
    others = [
        item
        for item in items
        if item.get_closest_marker("newest") and getattr(item, "callspec", None) and _suite(item) not in SUITES[-1:]
    ]
    if SUITES and others:
        config.hook.pytest_deselected(items=others)
        items[:] = [item for item in items if item not in others]


def _suite(item) -> str:
    return item.callspec.params.get("window", "")


def _group(item) -> str:
    if item.get_closest_marker("window"):
        return f"windows {_suite(item)}" if SUITES else "windows"
    return str(item.path)


def _longest_first(items):
    """So that no worker is left alone with a long file at the end. Windows take the longest by far."""
    cost = Counter()
    for item in items:
        slow = item.get_closest_marker("slow")
        cost[_group(item)] += slow.kwargs.get("seconds", SLOW) if slow else QUICK
    items.sort(key=lambda item: (not item.get_closest_marker("window"), -cost[_group(item)], _group(item)))


def _leave_out(config, items):
    windows = [item for item in items if item.get_closest_marker("window")]
    slow = [item for item in items if item.get_closest_marker("slow") and item not in windows]
    config.stash[LEFT_OUT] = counts = {"slow": len(slow), "with a window": len(windows)}
    if hasattr(config, "workeroutput"):
        config.workeroutput["left_out"] = counts
    if out := {*slow, *windows}:
        config.hook.pytest_deselected(items=[*slow, *windows])
        items[:] = [item for item in items if item not in out]


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node):
    """The tests are collected by xdist's workers, and the summary is written by the process that started them."""
    if counts := getattr(node, "workeroutput", {}).get("left_out"):
        node.config.stash[LEFT_OUT] = counts


def pytest_terminal_summary(terminalreporter, config):
    counts = config.stash.get(LEFT_OUT, {})
    if any(counts.values()):
        said = " and ".join(f"{count} {kind}" for kind, count in counts.items() if count)
        terminalreporter.write_line(f"left out: {said}; `python3.11 run.py test --all` runs every test")


@pytest.fixture(scope="session")
def addon():
    """The extension's package, imported from the repository and registered in this process.

    The repository's root is the package; Blender gives it its name, and so does this.
    """
    pytest.importorskip("bpy")
    from benchmarks.support.extension import extension

    return extension()


@pytest.fixture
def scene(addon):
    """An empty scene with a black World; the extension stays registered."""
    from tests.support import blender_scenes

    return blender_scenes.empty_scene()


@pytest.fixture
def uncalibrated(addon, tmp_path, monkeypatch):
    """Nothing is known of volumes or of the machine's speed, as before the first render."""
    monkeypatch.setenv("BLENDER_USER_EXTENSIONS", str(tmp_path))
    monkeypatch.setattr(addon.mrpnn_addon.volumes.bounding_boxes, "_densities", {})
    addon.mrpnn_addon.status.calibration.forget()
    yield
    addon.mrpnn_addon.status.calibration.forget()


@pytest.fixture(scope="session")
def real_volumes():
    """The folder of real volumes in the repository."""
    from benchmarks.support.data import VOLUMES

    return VOLUMES


@pytest.fixture(scope="session")
def shared_volumes():
    """The folder beside the project of real volumes that may not be copied into it."""
    folder = SHARED / "volumes"
    if not folder.is_dir():
        pytest.skip("the folder ../shared/volumes is absent")
    return folder


@pytest.fixture(scope="session")
def zips(tmp_path_factory, worker_id):
    """The built zips, one for each platform; one of the processes of a run builds them for all."""
    import build_extension

    # Of this process, in a folder of all of the run where there are several.
    folder = tmp_path_factory.getbasetemp()
    built = (folder if worker_id == "master" else folder.parent) / "zips.txt"
    with locked(built.with_suffix(".lock")):
        if not built.exists():
            built.write_text("\n".join(map(str, build_extension.build())))
    return [Path(line) for line in built.read_text().splitlines()]


@pytest.fixture(scope="session")
def linux_zip(zips):
    """The zip for Blender of blender.org."""
    (path,) = [path for path in zips if path.name.endswith("linux_x64.zip")]
    return path


@pytest.fixture(scope="session")
def zip_of(zips, linux_zip):
    """zip_of(Blender): the zip for a program or suite. Sid has Python 3.14, for which there is no onnxruntime."""
    (other,) = [path for path in zips if path.name.endswith("linux_x64-any_python.zip")]
    return lambda blender: other if str(blender).endswith("sid") else linux_zip


@pytest.fixture(scope="module", params=SUITES)
def window(request, zip_of):
    with opened(request.param, zip_of(request.param)) as window:
        made = window.do(SCENE)
        assert made.endswith("made"), made
        yield window
