# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads one grid of a .vdb file, or a component of one; a module, or a program without Blender that `process` runs.

    python -I worker.py [--by-box] FILE.vdb GRID MOST_VOXELS CPU_SECONDS BYTES [FOLDER ...]

--by-box: not by leaf, as of `read_grid`. FOLDER: search path of the OpenVDB module. Writes a line of JSON, the facts of
`read_grid` or {"error": OpenVDB's message}, and then its pieces: number of blocks, int64, their numbers and their
voxels; the last piece has no blocks. Exit status NO_MODULE without an OpenVDB module, NO_MEMORY where reading needs
more than BYTES.
"""

import contextlib
import importlib
import importlib.util
import json
import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from importlib.machinery import PathFinder
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np

NO_MODULE, NO_MEMORY = 77, 78
# The module's name, and its name before Blender 4.4.
MODULE_NAMES = ("openvdb", "pyopenvdb")
# Types whose values Cycles reads as numbers or as vectors of numbers.
SCALAR_GRIDS = ("FloatGrid", "DoubleGrid", "HalfGrid", "Int32Grid", "Int64Grid", "BoolGrid")
VECTOR_GRIDS = ("Vec3SGrid", "Vec3DGrid", "Vec3HGrid", "Vec3IGrid")
# What follows the name of a grid of vectors in the names of its components.
COMPONENTS = ("[0]", "[1]", "[2]")
# Voxels per edge of leaves of OpenVDB's trees and of the nodes above them, and the tree depths of their contents.
LEAF, NODE, NODE_DEPTH, LEAF_DEPTH = 8, 128, 2, 3


def load_module(folders: Sequence[str]) -> Any:
    """OpenVDB's module for Python, from Python's search path or else from folders; raises ImportError without one.

    sys.path stays as it is, and so does sys.modules, into which Python itself enters compiled modules.
    """
    for name in MODULE_NAMES:
        try:
            return importlib.import_module(name)
        except ModuleNotFoundError:
            pass
    for name in MODULE_NAMES:
        spec = PathFinder.find_spec(name, folders)
        if spec is not None and spec.loader is not None:
            module = importlib.util.module_from_spec(spec)
            spec.loader.exec_module(module)
            return module
    raise ImportError("there is no OpenVDB module for Python")


def read_grid(openvdb: Any, path: str, name: str, most_voxels: int, by_leaf: bool) -> tuple[dict, Iterator]:
    """(facts, pieces) of a grid; name: its own, or that of a vector grid and one of COMPONENTS.

    by_leaf: Cycles shows all voxels, active or not, of leaves with an active voxel and of those across a face of one,
    as before 5.0. Otherwise it shows those in the box around the active ones and one more on each side.

    facts: "grids": [name, type, class] of each grid in the file. If the first grid of that name is a fog volume, also
        "background"; "low", "shape": lower index and size of the bounding box of active voxels, inverted without any;
        "first", "count": lower index and number of leaves of a box around all that is shown; "matrix": 4 lists of 4,
        index to object space, None for a frustum.
    pieces: yields numbers, int64 (n,), positions in the flattened box of leaves, and values, float32 (n, 8, 8, 8), of
        all shown leaves that differ from the background; none where the box is inverted or has more than `most_voxels`.

    Raises OpenVDB's exceptions.
    """
    with utf8_link(path) as readable:
        return _read_grid(openvdb, readable, name, most_voxels, by_leaf)


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


def _read_grid(openvdb: Any, path: str, name: str, most_voxels: int, by_leaf: bool) -> tuple[dict, Iterator]:
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
    first = [(a - 1) // LEAF * LEAF for a in low]
    count = [(b + 1) // LEAF - a // LEAF + 1 for a, b in zip(first, high)]
    facts = {
        "grids": headers,
        "background": float(background),
        "low": list(low),
        "shape": shape,
        "first": first,
        "count": count,
        "matrix": _matrix(grid.transform),
    }
    if min(shape) < 1 or shape[0] * shape[1] * shape[2] > most_voxels:
        return facts, iter(())
    if by_leaf:
        # Vectors colour what other grids show.
        box = first, [a + LEAF * n - 1 for a, n in zip(first, count)]
        return facts, _pieces(grid, component, box, facts, _ShownLeaves(grid) if component is None else None)
    return facts, _pieces(grid, component, ([a - 1 for a in low], [b + 1 for b in high]), facts)


def _pieces(
    grid: Any,
    component: int | None,
    box: tuple[Sequence[int], Sequence[int]],
    facts: dict,
    is_shown: "_ShownLeaves | None" = None,
) -> "Iterator[tuple[np.ndarray, np.ndarray]]":
    """The pieces of `read_grid`, one per node.

    component: number of that of a vector grid, None for others. box: its first and last voxels. is_shown: tells whether
    a leaf is shown, by its lower index and voxels; None where all in the box are.
    """
    import numpy

    accessor, (low, high), background = grid.getConstAccessor(), box, numpy.float32(facts["background"])
    spans = [range(a // NODE * NODE, b + 1, NODE) for a, b in zip(low, high)]
    for corner in ((x, y, z) for x in spans[0] for y in spans[1] for z in spans[2]):
        # Without a node, all its voxels have one value.
        if accessor.getValueDepth(corner) < NODE_DEPTH and accessor.getValue(corner) == grid.background:
            continue
        # Ends of the voxels in the box, and of the leaves around them.
        start, end = [max(c, a) for c, a in zip(corner, low)], [min(c + NODE - 1, b) + 1 for c, b in zip(corner, high)]
        outer, last = [a // LEAF * LEAF for a in start], [-(-b // LEAF) * LEAF for b in end]
        inside = numpy.empty([b - a for a, b in zip(start, end)] + [3] * (component is not None), numpy.float32)
        grid.copyToArray(inside, ijk=tuple(start))
        inside = inside if component is None else inside[..., component]
        leaves = numpy.full([b - a for a, b in zip(outer, last)], background, numpy.float32)
        leaves[tuple(slice(a - o, b - o) for a, b, o in zip(start, end, outer))] = inside
        split = leaves.reshape([size for n in leaves.shape for size in (n // LEAF, LEAF)]).transpose(0, 2, 4, 1, 3, 5)
        places = numpy.argwhere((split != background).any(axis=(3, 4, 5)))
        values = split[tuple(places.T)]
        if is_shown is not None:
            held = is_shown(places * LEAF + outer, values)
            places, values = places[held], values[held]
        if len(places):
            places = places + (numpy.array(outer) - facts["first"]) // LEAF
            yield numpy.ravel_multi_index(tuple(places.T), facts["count"]).astype(numpy.int64), values


class _ShownLeaves:
    """Which leaves Cycles shows: those with an active voxel that is not 0, and those across a face of one."""

    def __init__(self, grid: Any) -> None:
        self._grid, self._accessor = grid, grid.getConstAccessor()
        self._pruned: tuple[Any, Any] | None = None

    def __call__(self, corners: "np.ndarray", values: "np.ndarray") -> "np.ndarray":
        """bool (n,) of leaves by their lower indices, int (n, 3), and their voxels, float32 (n, 8, 8, 8)."""
        import numpy

        # The largest voxel of most leaves is active, which is known at once.
        places = numpy.unravel_index(numpy.abs(values).reshape(-1, LEAF**3).argmax(axis=1), values.shape[1:])
        largest = (corners + numpy.stack(places, axis=1)).tolist()
        shown = numpy.array([self._accessor.isValueOn(tuple(index)) for index in largest], bool)
        for number in numpy.flatnonzero(~shown):
            shown[number] = self._is_shown(corners[number].tolist())
        return shown

    def _is_shown(self, corner: Sequence[int]) -> bool:
        if self._has_active(corner, [range(LEAF)] * 3):
            return True
        for axis in range(3):
            for step, plane in ((-LEAF, LEAF - 1), (LEAF, 0)):
                beside = [c + step * (a == axis) for a, c in enumerate(corner)]
                if self._has_active(beside, [[plane] if a == axis else range(LEAF) for a in range(3)]):
                    return True
        return False

    def _has_active(self, corner: Sequence[int], ranges: Sequence[Sequence[int]]) -> bool:
        """Whether some voxels of a leaf hold one that is active and not 0."""
        if self._pruned is None:
            # A copy without the leaves that hold no active voxel.
            pruned = self._grid.deepCopy()
            pruned.pruneInactive()
            self._pruned = pruned, pruned.getConstAccessor()
        if self._pruned[1].getValueDepth(tuple(corner)) < LEAF_DEPTH:
            return False
        for x in ranges[0]:
            for y in ranges[1]:
                for z in ranges[2]:
                    value, active = self._accessor.probeValue((corner[0] + x, corner[1] + y, corner[2] + z))
                    if active and value:
                        return True
        return False


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


def main(path: str, grid_name: str, most_voxels: str, seconds: str, size: str, *folders: str, by_leaf: bool) -> int:
    try:
        import numpy  # noqa: F401, imported before memory is limited

        openvdb = load_module(folders)
    except ImportError:
        return NO_MODULE
    limit(int(seconds), int(size))
    write = sys.stdout.buffer.write
    try:
        facts, pieces = read_grid(openvdb, path, grid_name, int(most_voxels), by_leaf)
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
    by_box = sys.argv[1:2] == ["--by-box"]
    sys.exit(main(*sys.argv[2 if by_box else 1 :], by_leaf=not by_box))
