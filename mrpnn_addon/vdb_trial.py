"""A trial reading of a .vdb file by another process: damaged files can crash OpenVDB, or keep it busy for ever."""

import os
import subprocess
import sys
from pathlib import Path

import bpy

from ..inference.scene import SceneError
from .openvdb_module import bundled_folders
from .read_vdb_alone import NO_MEMORY

PROGRAM = Path(__file__).with_name("read_vdb_alone.py")
# Processor seconds that a file may take, and how much more for each of its bytes; and of memory.
SECONDS, SECONDS_A_BYTE = 20, 2e-7
MEMORY = 16 << 30
# Of waiting, on a busy machine.
PATIENCE = 10
# Statuses of Windows from here on are crashes.
WINDOWS_CRASH = 0xC0000000

_read = set()


def require_readable(path: str, grid_name: str, most_voxels: int, where: str) -> None:
    """Raise SceneError, beginning with `where`, for a grid that Blender's own process had better not read.

    A file is tried once, until it changes. Where Python cannot be started, or has no OpenVDB module outside
    Blender, nothing is tried.
    """
    try:
        facts = os.stat(path)
    except OSError:
        return  # Reading says what is wrong.
    key = path, facts.st_mtime_ns, facts.st_size, grid_name
    # In a Blender that has no interpreter beside it this would start another Blender.
    if key in _read or sys.executable in ("", bpy.app.binary_path):
        return
    seconds = int(SECONDS + SECONDS_A_BYTE * facts.st_size)
    command = [sys.executable, "-I", str(PROGRAM), path, grid_name, str(most_voxels), str(seconds), str(MEMORY),
               *bundled_folders()]
    try:
        status = subprocess.run(
            command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
            timeout=PATIENCE * seconds, creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0)).returncode
    except subprocess.TimeoutExpired:
        status = None
    except OSError:
        return  # There is no Python to be started.
    if _died(status):
        raise SceneError(f"{where}: grid \"{grid_name}\" of {path} is damaged: a process that read it "
                         f"{_ending(status)}; write the file again")
    _read.add(key)


def _died(status) -> bool:
    """Whether the file ended the process; a Python that cannot start ends with a small status of its own."""
    return status is None or status == NO_MEMORY or status < 0 or status >= WINDOWS_CRASH


def _ending(status) -> str:
    if status is None:
        return "did not come to an end"
    if status == NO_MEMORY:
        return f"would have needed more than {MEMORY >> 30} GiB"
    return f"was ended by signal {-status}" if status < 0 else f"crashed with {status:#x}"
