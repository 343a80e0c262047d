# SPDX-License-Identifier: GPL-3.0-or-later
"""Loads the OpenVDB Python module that ships with Blender."""

import functools
import sys
from pathlib import Path
from typing import Any

import bpy

from ...inference.scene import SceneError
from .worker import load_module


@functools.cache
def load_openvdb() -> Any:
    """The module, loaded once.

    In a Blender program it is on the search path. The bpy wheels ship it in a folder that is not.

    Raises SceneError where this build of Blender has no OpenVDB module.
    """
    try:
        return load_module(FOLDERS)
    except ImportError as error:
        raise SceneError(
            f"this build of Blender ({bpy.app.version_string}) has no OpenVDB module for Python, "
            "so volume files cannot be read; use Blender from blender.org, or bpy 4.4 or later"
        ) from error


def bundled_folders() -> list:
    """Folders of the module where Blender's search path lacks it."""
    utils: Any = bpy.utils
    library = Path(utils.system_resource("PYTHON") or "") / "lib"
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    return [str(library / version / "site-packages"), str(library / "site-packages")]


# Looked up once on the main thread, since other threads read grids.
FOLDERS = bundled_folders()
