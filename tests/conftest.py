"""Fixtures for the tests that run inside Blender (the bpy module)."""

import os
import shutil
import sys
from pathlib import Path

import pytest

from .window import SCENE, SUITES, WORK, Window

ROOT = Path(__file__).resolve().parent.parent
SHARED = ROOT.parent / "shared"


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


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Keep each file in one process, and all that use Blender's windows, which share a screen, in the same one."""
    for item in items:
        uses_window = "window" in getattr(item, "fixturenames", ())
        item.add_marker(pytest.mark.xdist_group("windows" if uses_window else item.path.name))


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
    from . import blender_scenes
    return blender_scenes.empty_scene()


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
def zips():
    """The built zips, one a platform."""
    import build_extension
    return build_extension.build()


@pytest.fixture(scope="session")
def linux_zip(zips):
    (path,) = [path for path in zips if "linux_x64" in path.name]
    return path


@pytest.fixture(scope="module", params=SUITES)
def window(request, linux_zip):
    window = Window(request.param)
    shutil.copy(linux_zip, window.work / "window.zip")
    window.start()
    try:
        window.do(f"WORK = '{WORK}'")
        window.do("bpy.ops.extensions.package_install_files(filepath=WORK + '/window.zip', repo='user_default', "
                  "enable_on_install=True, overwrite=True)")
        made = window.do(SCENE)
        assert made.endswith("made"), made
        yield window
    finally:
        window.stop()
