# SPDX-License-Identifier: GPL-3.0-or-later
"""Loads the OpenVDB Python module that ships with Blender."""

import importlib
import importlib.util
import sys
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

import bpy

from ...inference.scene import SceneError

# The module's name, and its name before Blender 4.4.
MODULE_NAMES = ("openvdb", "pyopenvdb")


def load_openvdb() -> Any:
    """The module, imported once.

    In a Blender program it is on the search path. The bpy wheels ship it in a folder that is not, so it is then loaded
    from its file; sys.path is not changed.

    Raises SceneError where this build of Blender has no OpenVDB module.
    """
    for name in MODULE_NAMES:
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError:
            pass
    for name in MODULE_NAMES:
        spec = PathFinder.find_spec(name, FOLDERS)
        if spec is not None:
            module = importlib.util.module_from_spec(spec)
            # Registered first: a compiled module must not be loaded twice in one process.
            sys.modules[name] = module
            spec.loader.exec_module(module)
            return module
    raise SceneError(
        f"this build of Blender ({bpy.app.version_string}) has no OpenVDB module for Python, "
        "so volume files cannot be read; use Blender from blender.org, or bpy 4.4 or later"
    )


def bundled_folders() -> list:
    """Folders of the module where Blender's search path lacks it."""
    utils: Any = bpy.utils
    library = Path(utils.system_resource("PYTHON") or "") / "lib"
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    return [str(library / version / "site-packages"), str(library / "site-packages")]


# Looked up once on the main thread, since other threads read grids.
FOLDERS = bundled_folders()
