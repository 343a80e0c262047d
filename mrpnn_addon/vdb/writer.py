# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes grids to a .vdb file; a module, or a program without Blender that `light_file` runs.

    python -I writer.py FILE.vdb [FOLDER ...]

FOLDER: search path of the OpenVDB module. Reads a line of JSON, a list of [name, shape, lower index, matrix], and then
the values of each grid, float32. Exit status 0 when the file is complete.
"""

import json
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

try:
    from .worker import load_module, utf8_link
except ImportError:  # As a program.
    sys.path.append(os.path.dirname(__file__))
    from worker import load_module, utf8_link  # type: ignore[no-redef]


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
    """Write a file. Raises OpenVDB's exceptions."""
    with utf8_link(os.path.dirname(path)) as folder:
        openvdb.write(os.path.join(folder, os.path.basename(path)), grids=[_grid(openvdb, one) for one in grids])


def _grid(openvdb: Any, written: LightGrid) -> Any:
    grid = openvdb.FloatGrid() if written.values.ndim == 3 else openvdb.Vec3SGrid()
    grid.copyFromArray(written.values, ijk=tuple(written.low))
    grid.name, grid.gridClass, grid.saveFloatAsHalf = written.name, "fog volume", True
    grid.transform = openvdb.createLinearTransform(written.matrix)
    return grid


def main(path: str, *folders: str) -> int:
    import numpy

    stream, grids = sys.stdin.buffer, []
    for name, shape, low, matrix in json.loads(stream.readline()):
        values = numpy.empty(shape, numpy.float32)
        if stream.readinto(values.data.cast("B")) != values.nbytes:
            return 1
        grids.append(LightGrid(name=name, values=values, low=low, matrix=matrix))
    write_grids(load_module(folders), path, grids)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
