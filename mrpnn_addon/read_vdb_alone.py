"""Reads one grid of a .vdb file and ends: a program of its own, for `vdb_trial`, without Blender.

    python -I read_vdb_alone.py FILE.vdb GRID MOST_VOXELS CPU_SECONDS BYTES [FOLDER ...]

FOLDER: where to look for the OpenVDB module. Exit status 0 where the grid can be read, or OpenVDB says in Python why
not; NO_MODULE where there is no module; NO_MEMORY where reading it takes more than BYTES. A crash, or no end, speaks for
itself.
"""

import sys

NO_MODULE, NO_MEMORY = 77, 78


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


def main(path, grid_name, most_voxels, seconds, size, *folders) -> int:
    sys.path += folders
    try:
        import numpy
        try:
            import openvdb
        except ImportError:
            import pyopenvdb as openvdb
    except ImportError:
        return NO_MODULE
    limit(int(seconds), int(size))
    try:
        grid = openvdb.read(path, grid_name)
        low, high = grid.evalActiveVoxelBoundingBox()
        shape = [b - a + 1 for a, b in zip(low, high)]
        if min(shape) > 0 and shape[0] * shape[1] * shape[2] <= int(most_voxels):
            grid.copyToArray(numpy.empty(shape, numpy.float32), ijk=low)
    except MemoryError:
        return NO_MEMORY
    except Exception as error:  # Blender's process will meet the same, and name it.
        print(error, file=sys.stderr)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
