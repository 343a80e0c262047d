# SPDX-License-Identifier: GPL-3.0-or-later
"""Ends the extension's threads before Blender loads another file, unregisters the extension or quits."""

from typing import Any

import bpy

from ...inference.kernels.library import unload_kernels
from .background import stop_threads

# A thread looks whether it is to stop several times a second; one in a system call may take longer.
PATIENCE = 10.0


@bpy.app.handlers.persistent
def _before_load(*_: Any) -> None:
    stop_threads(PATIENCE)


def register() -> None:
    bpy.app.handlers.load_pre.append(_before_load)


def unregister() -> None:
    """Blender calls this when it disables or updates the extension, and when it quits."""
    bpy.app.handlers.load_pre.remove(_before_load)
    if stop_threads(PATIENCE):
        # Windows does not let a loaded library be replaced, as an update must.
        unload_kernels()
