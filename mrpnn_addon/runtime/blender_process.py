# SPDX-License-Identifier: GPL-3.0-or-later
"""Scripts that run in separate Blender processes."""

import sys
from collections.abc import Sequence
from pathlib import Path

import bpy

# Blender converts the colours of what it loads from files with another working space, and clamps some of them to 1.
_WORKING_SPACE = (
    "import bpy, sys; bpy.data.colorspace.working_space == {0!r} or "
    "bpy.ops.wm.set_working_color_space(working_space={0!r}, convert_colors=False)"
)


def _working_space() -> str:
    """The file's space of scene linear colours; "" before Blender 5, where the configuration alone decides."""
    return bpy.data.colorspace.working_space if hasattr(bpy.data, "colorspace") else ""


def blender_command(script: Path, arguments: Sequence[str]) -> list:
    """The command that runs a script in a new Blender with factory settings, in this file's working space."""
    if not bpy.app.binary_path:
        # Running as the bpy module: there is no Blender program.
        run = (
            f"{_WORKING_SPACE.format(_working_space())}; import runpy; runpy.run_path(sys.argv[1], run_name='__main__')"
        )
        return [sys.executable, *(["-c", run] if _working_space() else []), str(script), *arguments]
    return [
        bpy.app.binary_path,
        "--background",
        "--factory-startup",
        "--disable-autoexec",
        "--python-exit-code",
        "1",
        *(["--python-expr", _WORKING_SPACE.format(_working_space())] if _working_space() else []),
        "--python",
        str(script),
        "--",
        *arguments,
    ]
