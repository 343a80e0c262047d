"""Scripts in Blender processes of their own."""

import sys
from pathlib import Path

import bpy


def blender_command(script: Path, arguments) -> list:
    """A command that runs a script in a Blender of its own, as it comes from the factory."""
    if not bpy.app.binary_path:
        # The bpy module has no program of its own.
        return [sys.executable, str(script), *arguments]
    return [bpy.app.binary_path, "--background", "--factory-startup", "--disable-autoexec", "--python-exit-code", "1",
            "--python", str(script), "--", *arguments]
