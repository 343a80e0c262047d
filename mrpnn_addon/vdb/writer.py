# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes grids to a .vdb file; a module, or a program without Blender that `light_file` runs.

    python -I writer.py FILE.vdb [FOLDER ...]

FOLDER: search path of the OpenVDB module. Reads a line of JSON, a list of [name, shape, lower index, matrix], and then
the values of each grid, float32. Exit status 0 when the file is complete.
"""

import importlib.util
import json
import os
import struct
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np


@dataclass(frozen=True, kw_only=True)
class LightGrid:
    """A fog volume of half floats.

    values: float32 (nx, ny, nz), or (nx, ny, nz, 3) of vectors; voxels that are 0 are not stored. low: index of the
    first. matrix: four lists of four numbers, index to world, acting on rows as OpenVDB's do.
    """

    name: str
    values: "np.ndarray"
    low: Sequence[int]
    matrix: list[list[float]]


def write_grids(openvdb: Any, path: str, grids: Sequence[LightGrid]) -> None:
    """Write a file. Raises OpenVDB's exceptions, and OSError where the file is incomplete: OpenVDB does not notice that
    a disk is full.
    """
    openvdb.write(path, grids=[_grid(openvdb, one) for one in grids])
    if not is_complete(path):
        raise OSError("the file is incomplete; is the disk full?")


def is_complete(path: str) -> bool:
    """Whether a file that OpenVDB wrote is as long as it says."""
    with open(path, "rb") as file:

        def number(kind: str = "<I") -> int:
            return int(struct.unpack(kind, file.read(struct.calcsize(kind)))[0])

        def skip(times: int) -> None:
            for _ in range(times):
                file.seek(number(), os.SEEK_CUR)

        try:
            # Magic number, versions, whether grids have offsets, and the file's own identifier.
            file.seek(8 + 3 * 4 + 1 + 36)
            # Of each property of the file: name, type and value.
            skip(3 * number())
            end = 0
            for _ in range(number()):
                # Name, type and parent, and where the grid, its blocks and its end are.
                skip(3)
                _, _, end = number("<q"), number("<q"), number("<q")
                file.seek(end)
        except (struct.error, ValueError):
            return False
    return end == os.path.getsize(path)


def _grid(openvdb: Any, written: LightGrid) -> Any:
    grid = openvdb.FloatGrid() if written.values.ndim == 3 else openvdb.Vec3SGrid()
    grid.copyFromArray(written.values, ijk=tuple(written.low))
    grid.name, grid.gridClass, grid.saveFloatAsHalf = written.name, "fog volume", True
    grid.transform = openvdb.createLinearTransform(written.matrix)
    return grid


def _load_module(folders: Sequence[str]) -> Any:
    """As `worker.load_module`, of a program, which has no package."""
    spec: Any = importlib.util.spec_from_file_location("worker", Path(__file__).with_name("worker.py"))
    worker = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(worker)
    return worker.load_module(folders)


def main(path: str, *folders: str) -> int:
    import numpy

    stream: Any = sys.stdin.buffer
    grids = []
    for name, shape, low, matrix in json.loads(stream.readline()):
        values = numpy.empty(shape, numpy.float32)
        if stream.readinto(values.data.cast("B")) != values.nbytes:
            return 1
        grids.append(LightGrid(name=name, values=values, low=low, matrix=matrix))
    write_grids(_load_module(folders), path, grids)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
