# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads one grid of a .vdb file, or a component of one; a module, or a program without Blender that `process` runs.

    python -I worker.py FILE.vdb GRID MOST_VOXELS CPU_SECONDS BYTES [FOLDER ...]

FOLDER: search path of the OpenVDB module. Writes a line of JSON, the facts of `read_grid` or {"error": OpenVDB's
message}, and then its pieces: number of blocks, int64, their numbers and their voxels; the last piece has no blocks.
Exit status NO_MODULE without an OpenVDB module, NO_MEMORY where reading needs more than BYTES.
"""

import contextlib
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

NO_MODULE, NO_MEMORY = 77, 78
SCALAR_GRIDS = ("FloatGrid", "DoubleGrid", "HalfGrid")
VECTOR_GRIDS = ("Vec3SGrid", "Vec3DGrid", "Vec3HGrid")
# What follows the name of a grid of vectors in the names of its components.
COMPONENTS = ("[0]", "[1]", "[2]")
# Voxels per edge of leaves of OpenVDB's trees and of the nodes above them, and the tree depth of their contents.
LEAF, NODE, NODE_DEPTH = 8, 128, 2


def read_grid(openvdb: Any, path: str, name: str, most_voxels: int) -> tuple[dict, Iterator]:
    """(facts, pieces) of a grid; name: its own, or that of a vector grid and one of COMPONENTS.

    facts: "grids": [name, type, class] of each grid in the file. If the first grid of that name is a fog volume, also
        "background"; "low", "shape": lower index and size of the bounding box of active voxels, inverted without any;
        "first", "count": lower index and number of the leaves around it; "matrix": 4 lists of 4, index to object space,
        None for a frustum.
    pieces: yields numbers, int64 (n,), positions in the flattened box of leaves, and values, float32 (n, 8, 8, 8), of
        all leaves that are not 0; none where the box is inverted or has more than `most_voxels`, or the background is
        not 0.

    Raises OpenVDB's exceptions.
    """
    with utf8_link(path) as readable:
        return _read_grid(openvdb, readable, name, most_voxels)


@contextlib.contextmanager
def utf8_link(path: str) -> Iterator[str]:
    """The path of a file or folder, or of a link to it where the path is not UTF-8, which OpenVDB's module refuses.

    Raises OSError where the link cannot be made.
    """
    try:
        path.encode()
    except UnicodeEncodeError:
        with tempfile.TemporaryDirectory() as folder:
            link = os.path.join(folder, "linked.vdb")
            os.symlink(os.path.abspath(path), link)
            yield link
    else:
        yield path


def _name(grid: Any) -> str:
    try:
        return grid.name
    except UnicodeDecodeError as error:
        return error.object.decode("utf-8", "backslashreplace")


def _read_grid(openvdb: Any, path: str, name: str, most_voxels: int) -> tuple[dict, Iterator]:
    # Never readAll: it can end the whole process on unusual files.
    headers = [(_name(grid), type(grid).__name__, grid.gridClass) for grid in openvdb.readAllGridMetadata(path)]
    component = None
    if name.endswith(COMPONENTS) and not any(header[0] == name for header in headers):
        name, component = name[: -len(COMPONENTS[0])], COMPONENTS.index(name[-len(COMPONENTS[0]) :])
    if not is_fog(next((header for header in headers if header[0] == name), None), component is not None):
        return {"grids": headers}, iter(())
    grid = openvdb.read(path, name)
    background = grid.background if component is None else grid.background[component]
    low, high = grid.evalActiveVoxelBoundingBox()
    shape = [b - a + 1 for a, b in zip(low, high)]
    first = [a // LEAF * LEAF for a in low]
    count = [b // LEAF - a // LEAF + 1 for a, b in zip(low, high)]
    facts = {
        "grids": headers,
        "background": float(background),
        "low": list(low),
        "shape": shape,
        "first": first,
        "count": count,
        "matrix": _matrix(grid.transform),
    }
    fits = min(shape) >= 1 and shape[0] * shape[1] * shape[2] <= most_voxels and background == 0.0
    return facts, _pieces(grid, component, low, high, first, count) if fits else iter(())


def _pieces(
    grid: Any,
    component: int | None,
    low: Sequence[int],
    high: Sequence[int],
    first: Sequence[int],
    count: Sequence[int],
) -> "Iterator[tuple[np.ndarray, np.ndarray]]":
    """The pieces of `read_grid`, one per node. component: number of that of a vector grid, None for others."""
    import numpy

    accessor = grid.getConstAccessor()
    spans = [range(a // NODE * NODE, b + 1, NODE) for a, b in zip(low, high)]
    for corner in ((x, y, z) for x in spans[0] for y in spans[1] for z in spans[2]):
        # Without a node, all its voxels have one value.
        if accessor.getValueDepth(corner) < NODE_DEPTH and not numpy.any(accessor.getValue(corner)):
            continue
        # Ends of the voxels in the box, and of the leaves around them.
        start, end = [max(c, a) for c, a in zip(corner, low)], [min(c + NODE - 1, b) + 1 for c, b in zip(corner, high)]
        outer, last = [a // LEAF * LEAF for a in start], [-(-b // LEAF) * LEAF for b in end]
        inside = numpy.empty([b - a for a, b in zip(start, end)] + [3] * (component is not None), numpy.float32)
        grid.copyToArray(inside, ijk=tuple(start))
        inside = inside if component is None else inside[..., component]
        leaves = numpy.zeros([b - a for a, b in zip(outer, last)], numpy.float32)
        leaves[tuple(slice(a - o, b - o) for a, b, o in zip(start, end, outer))] = inside
        split = leaves.reshape([size for n in leaves.shape for size in (n // LEAF, LEAF)]).transpose(0, 2, 4, 1, 3, 5)
        found = numpy.nonzero((split != 0.0).any(axis=(3, 4, 5)))
        if len(found[0]):
            places = [f + (o - a) // LEAF for f, o, a in zip(found, outer, first)]
            yield numpy.ravel_multi_index(places, count).astype(numpy.int64), split[found]


def is_fog(header: Sequence[str], vectors: bool = False) -> bool:
    """Whether a grid, an item of "grids", can be a density or, if it is one of vectors, a colour."""
    return header is not None and header[1] in (VECTOR_GRIDS if vectors else SCALAR_GRIDS) and header[2] != "level set"


def _matrix(transform: Any) -> list[list[float]]:
    if not transform.isLinear:
        return None
    origin = transform.indexToWorld((0.0, 0.0, 0.0))
    ends = [transform.indexToWorld(tuple(float(a == b) for b in range(3))) for a in range(3)]
    return [[*(end[row] - origin[row] for end in ends), origin[row]] for row in range(3)] + [[0.0, 0.0, 0.0, 1.0]]


def limit(seconds: int, size: int) -> None:
    """Limit processor seconds and memory, so that the system ends this process and no other."""
    try:
        import resource
    except ImportError:  # Windows
        return
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform.startswith("linux"):
        resource.setrlimit(resource.RLIMIT_AS, (size, size))
        # If the machine runs out of memory first, the system ends this process.
        with open("/proc/self/oom_score_adj", "w") as file:
            file.write("1000")


def main(path: str, grid_name: str, most_voxels: str, seconds: str, size: str, *folders: str) -> int:
    sys.path += folders
    try:
        import numpy  # noqa: F401, imported before memory is limited

        try:
            import openvdb
        except ImportError:
            import pyopenvdb as openvdb
    except ImportError:
        return NO_MODULE
    limit(int(seconds), int(size))
    write = sys.stdout.buffer.write
    try:
        facts, pieces = read_grid(openvdb, path, grid_name, int(most_voxels))
    except MemoryError:
        return NO_MEMORY
    except Exception as error:
        facts, pieces = {"error": str(error)}, iter(())
    try:
        write(json.dumps(facts).encode() + b"\n")
        for numbers, values in pieces:
            write(len(numbers).to_bytes(8, sys.byteorder))
            write(memoryview(numbers).cast("B"))
            write(memoryview(values).cast("B"))
        write(bytes(8))
        sys.stdout.buffer.flush()
    except MemoryError:
        return NO_MEMORY
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
