"""Reads one grid of a .vdb file: as a module, or as a program of its own without Blender, for `vdb_process`.

    python -I read_vdb_alone.py FILE.vdb GRID MOST_VOXELS CPU_SECONDS BYTES [FOLDER ...]

FOLDER: where to look for the OpenVDB module. Writes a line of JSON, what `read_grid` tells or {"error": OpenVDB's words},
and then the voxels. Exit status NO_MODULE where there is no module; NO_MEMORY where reading takes more than BYTES. A
crash, or no end, speaks for itself.
"""

import json
import sys

NO_MODULE, NO_MEMORY = 77, 78
SCALAR_GRIDS = ("FloatGrid", "DoubleGrid", "HalfGrid")


def read_grid(openvdb, path: str, name: str, most_voxels: int):
    """(facts, values) of a grid.

    facts: "grids": [name, type, class] of each in the file. Where the first one of that name is fog besides,
    "background"; "low", "shape": lower index and size of the box of active voxels, inverted where there are
    none; "matrix": 4 lists of 4, index to object space, None for a frustum.
    values: float32 array of that shape, None where the box is inverted or holds more than `most_voxels`.

    Raises what OpenVDB raises.
    """
    import numpy
    # Never readAll: it can end the whole process on unusual files.
    headers = [(grid.name, type(grid).__name__, grid.gridClass) for grid in openvdb.readAllGridMetadata(path)]
    if not is_fog(next((header for header in headers if header[0] == name), None)):
        return {"grids": headers}, None
    grid = openvdb.read(path, name)
    low, high = grid.evalActiveVoxelBoundingBox()
    shape = [b - a + 1 for a, b in zip(low, high)]
    facts = {"grids": headers, "background": float(grid.background), "low": list(low), "shape": shape,
             "matrix": _matrix(grid.transform)}
    if min(shape) < 1 or shape[0] * shape[1] * shape[2] > most_voxels:
        return facts, None
    values = numpy.empty(shape, numpy.float32)
    grid.copyToArray(values, ijk=tuple(low))
    return facts, values


def is_fog(header) -> bool:
    """Whether a grid, as "grids" tells it, can be a density."""
    return header is not None and header[1] in SCALAR_GRIDS and header[2] != "level set"


def _matrix(transform):
    if not transform.isLinear:
        return None
    origin = transform.indexToWorld((0.0, 0.0, 0.0))
    ends = [transform.indexToWorld(tuple(float(a == b) for b in range(3))) for a in range(3)]
    return [[*(end[row] - origin[row] for end in ends), origin[row]] for row in range(3)] + [[0.0, 0.0, 0.0, 1.0]]


def limit(seconds: int, size: int) -> None:
    """Let the system end this process rather than all others wait for it."""
    try:
        import resource
    except ImportError:  # Windows
        return
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    if sys.platform.startswith("linux"):
        resource.setrlimit(resource.RLIMIT_AS, (size, size))
        # Where the machine's memory ends before, this process is the one to go.
        with open("/proc/self/oom_score_adj", "w") as file:
            file.write("1000")


def main(path, grid_name, most_voxels, seconds, size, *folders) -> int:
    sys.path += folders
    try:
        import numpy  # noqa: F401, before its memory is limited
        try:
            import openvdb
        except ImportError:
            import pyopenvdb as openvdb
    except ImportError:
        return NO_MODULE
    limit(int(seconds), int(size))
    try:
        facts, values = read_grid(openvdb, path, grid_name, int(most_voxels))
    except MemoryError:
        return NO_MEMORY
    except Exception as error:
        facts, values = {"error": str(error)}, None
    sys.stdout.buffer.write(json.dumps(facts).encode() + b"\n")
    if values is not None:
        sys.stdout.buffer.write(memoryview(values).cast("B"))
    sys.stdout.buffer.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
