"""Grids of .vdb files, read by another process: damaged files can crash OpenVDB, or keep it busy for ever, and while it
reads no other thread of Python runs."""

import json
import os
import subprocess
import sys
import threading
from pathlib import Path

import bpy
import numpy as np

from ...inference.scene import SceneError
from .openvdb_module import FOLDERS
from .worker import LEAF, NO_MEMORY

PROGRAM = Path(__file__).with_name("worker.py")
# Asked of Blender once, since threads read grids. One without an interpreter beside it would start another Blender.
INTERPRETER = "" if sys.executable == bpy.app.binary_path else sys.executable
# Processor seconds that a file may take, and how much more for each of its bytes; and of memory.
SECONDS, SECONDS_A_BYTE = 20, 2e-7
MEMORY = 16 << 30
# Of waiting, on a busy machine.
PATIENCE = 10
# Statuses of Windows from here on are crashes.
WINDOWS_CRASH = 0xC0000000


def read_alone(path: str, grid_name: str, most_voxels: int, where: str, collect, started=lambda process: None):
    """(facts, collect(pieces)) with `worker.read_grid`'s, facts {"error": reason} for what OpenVDB refuses.

    None where Python cannot be started, or has no OpenVDB module outside Blender. started: called with the process,
    which may be killed; then this raises. Any thread may call.

    Raises SceneError, beginning with `where`, for a grid that Blender's own process had better not read, and what
    `collect` raises.
    """
    if not INTERPRETER or not os.path.isfile(path):
        return None
    seconds = int(SECONDS + SECONDS_A_BYTE * os.path.getsize(path))
    command = [INTERPRETER, "-I", str(PROGRAM), path, grid_name, str(most_voxels), str(seconds), str(MEMORY), *FOLDERS]
    try:
        process = subprocess.Popen(command, bufsize=0, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE,
                                   stderr=subprocess.DEVNULL, creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0))
    except OSError:
        return None  # There is no Python to be started.
    with process:
        started(process)
        impatient = threading.Timer(PATIENCE * seconds, process.kill)
        impatient.start()
        try:
            found = _receive(process.stdout, collect)
        finally:
            process.stdout.close()
            status, late = process.wait(), impatient.finished.is_set()
            impatient.cancel()
    if status == 0 and found is not None:
        return found
    if late or _died(status):
        raise SceneError(f"{where}: grid \"{grid_name}\" of {path} is damaged: a process that read it "
                         f"{_ending(status)}; write the file again")
    return None


class _Short(Exception):
    """Output that ends too early."""


def _receive(stream, collect):
    """(facts, collected pieces) from a process' output, None where it ends too early."""
    line = stream.readline()
    if not line.endswith(b"\n"):
        return None
    try:
        return json.loads(line), collect(_pieces(stream))
    except _Short:
        return None


def _pieces(stream):
    """Yield what `worker.main` wrote. Raises _Short."""
    while count := int(_fill(stream, np.empty(1, np.int64))[0]):
        yield _fill(stream, np.empty(count, np.int64)), _fill(stream, np.empty((count, LEAF, LEAF, LEAF), np.float32))


def _fill(stream, array):
    place = memoryview(array).cast("B")
    while len(place):
        read = stream.readinto(place)
        if not read:
            raise _Short
        place = place[read:]
    return array


def _died(status) -> bool:
    """Whether the file ended the process; a Python that cannot start ends with a small status of its own."""
    return status == NO_MEMORY or status < 0 or status >= WINDOWS_CRASH


def _ending(status) -> str:
    if status == NO_MEMORY:
        return f"would have needed more than {MEMORY >> 30} GiB"
    return f"was ended by signal {-status}" if status < 0 else f"crashed with {status:#x}"
