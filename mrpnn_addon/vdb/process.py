# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids of .vdb files, read by another process.

Damaged files can crash OpenVDB or keep it busy forever, and no other Python thread runs while it reads.
"""

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...inference.scene import SceneError
from .openvdb_module import FOLDERS
from .worker import LEAF, NO_MEMORY

PROGRAM = Path(__file__).with_name("worker.py")
# Looked up once on the main thread, since other threads read grids. An interpreter that is Blender itself would start
# another Blender.
INTERPRETER = "" if sys.executable == bpy.app.binary_path else sys.executable
# Limits of processor seconds, plus seconds per byte of the file, and of memory.
SECONDS, SECONDS_PER_BYTE = 20, 2e-7
MEMORY = 16 << 30
# Wall-clock limit as a multiple of processor seconds, for busy machines.
WALL_CLOCK_FACTOR = 10
# How Cycles bounds what it shows, see `worker.read_grid`.
BY_LEAF = bpy.app.version < (5, 0, 0)
# On Windows, exit statuses from here on are crashes.
WINDOWS_CRASH = 0xC0000000


def read_in_process(
    path: str,
    grid_name: str,
    most_voxels: int,
    where: str,
    collect: Callable[[Iterator[tuple[np.ndarray, np.ndarray]]], Any],
    started: Callable[[subprocess.Popen], None] = lambda process: None,
) -> tuple[dict, Any]:
    """(facts, collect(pieces)) as `worker.read_grid` returns them; facts {"error": reason} where OpenVDB refuses the
    file.

    None where no Python process can be started, or it has no OpenVDB module. started: called with the process, which
    may be killed; this then raises. Any thread may call this.

    Raises SceneError, prefixed with `where`, for a grid that Blender's own process should not read, and whatever
    `collect` raises.
    """
    if not INTERPRETER or not os.path.isfile(path):
        return None
    seconds = int(SECONDS + SECONDS_PER_BYTE * os.path.getsize(path))
    limits = str(most_voxels), str(seconds), str(MEMORY)
    program = [INTERPRETER, "-I", str(PROGRAM), *([] if BY_LEAF else ["--by-box"])]
    command = [*program, path, grid_name, *limits, *FOLDERS]
    try:
        process = subprocess.Popen(
            command,
            bufsize=0,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError:
        return None  # Python cannot be started.
    with process:
        started(process)
        impatient = threading.Timer(WALL_CLOCK_FACTOR * seconds, process.kill)
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
        raise SceneError(
            f'{where}: grid "{grid_name}" of {path} is damaged: a process that read it '
            f"{_ending(status)}; write the file again"
        )
    return None


class _Short(Exception):
    """Output that ends early."""


def _receive(stream: Any, collect: Callable[[Iterator[tuple[np.ndarray, np.ndarray]]], Any]) -> tuple[dict, Any]:
    """(facts, collected pieces) from a process' output; None where it ends early."""
    line = stream.readline()
    if not line.endswith(b"\n"):
        return None
    try:
        return json.loads(line), collect(_pieces(stream))
    except _Short:
        return None


def _pieces(stream: Any) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield what `worker.main` writes. Raises _Short."""
    while count := int(_fill(stream, np.empty(1, np.int64))[0]):
        yield _fill(stream, np.empty(count, np.int64)), _fill(stream, np.empty((count, LEAF, LEAF, LEAF), np.float32))


def _fill(stream: Any, array: np.ndarray) -> np.ndarray:
    place = array.data.cast("B")
    while len(place):
        read = stream.readinto(place)
        if not read:
            raise _Short
        place = place[read:]
    return array


def _died(status: int) -> bool:
    """Whether the file ended the process; a Python that cannot start ends with a small status."""
    return status == NO_MEMORY or status < 0 or status >= WINDOWS_CRASH


def _ending(status: int) -> str:
    if status == NO_MEMORY:
        return f"would have needed more than {MEMORY >> 30} GiB"
    return f"was ended by signal {-status}" if status < 0 else f"crashed with {status:#x}"
