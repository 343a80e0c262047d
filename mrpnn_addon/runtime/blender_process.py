# SPDX-License-Identifier: GPL-3.0-or-later
"""Scripts that run in separate Blender processes."""

import sys
from collections.abc import Sequence
from pathlib import Path

import bpy


def blender_command(script: Path, arguments: Sequence[str]) -> list:
    """The command that runs a script in a new Blender with factory settings."""
    if not bpy.app.binary_path:
        # Running as the bpy module: there is no Blender program.
        return [sys.executable, str(script), *arguments]
    return [
        bpy.app.binary_path,
        "--background",
        "--factory-startup",
        "--disable-autoexec",
        "--python-exit-code",
        "1",
        "--python",
        str(script),
        "--",
        *arguments,
    ]
