"""One density grid of one .vdb file as a dense array."""

import os
from dataclasses import dataclass, field
from typing import List

import bpy
import numpy as np

from ..inference.scene import SceneError
from .openvdb_module import load_openvdb
from .vdb_trial import require_readable

# 2 GiB as float32; the render needs several times its input.
MAX_VOXELS = 1 << 29
# What OpenVDB's exceptions become in Python.
READ_ERRORS = (OSError, LookupError, RuntimeError, ValueError, TypeError)
SCALAR_GRIDS = ("FloatGrid", "DoubleGrid", "HalfGrid")


@dataclass
class DensityGrid:
    """density: float32 (nx, ny, nz), the active bounding box, finite and >= 0.
    object_from_index: float64 (4, 4), index of `density` to the object's own space.
    warnings: what was changed in the data, naming the object.
    """

    density: np.ndarray
    object_from_index: np.ndarray
    warnings: List[str] = field(default_factory=list)


def read_density_grid(path: str, grid_name: str, owner: str) -> DensityGrid:
    """Read grid `grid_name` of the file `path` for the object named `owner`.

    Negative and non-finite voxels become 0, as Cycles clamps them when shading; the warning says
    how many there were.

    Raises SceneError, naming the object, for a missing or unreadable file, a missing grid, a grid
    that holds no scalar fog, an empty grid, or one too large to hold densely.
    """
    where = f"Volume object \"{owner}\""
    grid, warnings = _open_grid(path, grid_name, where)
    low, shape = _active_box(grid, grid_name, where)
    values = np.empty(shape, dtype=np.float32)
    grid.copyToArray(values, ijk=low)

    invalid = ~np.isfinite(values)
    negative = values < 0.0
    invalid_count, negative_count = int(invalid.sum()), int(negative.sum())
    if invalid_count or negative_count:
        values[invalid | negative] = 0.0
        warnings.append(
            f"{where}: {negative_count} negative and {invalid_count} NaN or infinite voxels "
            f"of grid \"{grid_name}\" were taken as 0"
        )
    if not values.any():
        raise SceneError(f"{where}: grid \"{grid_name}\" is empty (no voxel above 0)")
    return DensityGrid(values, _object_from_index(grid, low, grid_name, where), warnings)


def grid_names(path: str, owner: str) -> List[str]:
    """Names of all grids in the file, in its order. Raises SceneError as read_density_grid."""
    return [grid.name for grid in _metadata(path, f"Volume object \"{owner}\"")]


def unreadable(path: str, reason: str) -> str:
    """Why a volume file cannot be read, for a message."""
    if not os.path.isfile(path):
        return f"file not found: {path}"
    with open(path, "rb") as file:
        if file.read(40).startswith(b"version https://git-lfs"):
            return f"{path} is a Git LFS pointer; fetch the real file with 'git lfs pull'"
    return f"cannot read {path} as OpenVDB ({reason})"


def _metadata(path, where):
    openvdb = load_openvdb()
    try:
        # Never readAll: it can end the whole process on unusual files.
        return openvdb.readAllGridMetadata(path)
    except READ_ERRORS as error:
        raise SceneError(f"{where}: {unreadable(path, error)}") from error


def _open_grid(path, grid_name, where):
    headers = _metadata(path, where)
    found = [header for header in headers if header.name == grid_name]
    if not found:
        names = ", ".join(f"\"{header.name}\"" for header in headers) or "none"
        raise SceneError(
            f"{where}: {os.path.basename(path)} has no grid \"{grid_name}\" (grids: {names}); "
            "set the density attribute in the volume's material to one of them"
        )
    header, warnings = found[0], []
    if len(found) > 1:
        warnings.append(
            f"{where}: {len(found)} grids are named \"{grid_name}\"; the first is rendered, as in Cycles"
        )
    kind = type(header).__name__
    if kind not in SCALAR_GRIDS:
        raise SceneError(f"{where}: grid \"{grid_name}\" is a {kind}, not a grid of float density")
    if header.gridClass == "level set":
        raise SceneError(
            f"{where}: grid \"{grid_name}\" is a level set, a distance and not a density; "
            "convert it to a fog volume"
        )
    require_readable(path, grid_name, MAX_VOXELS, where)
    try:
        grid = load_openvdb().read(path, grid_name)
    except READ_ERRORS as error:
        raise SceneError(f"{where}: cannot read grid \"{grid_name}\" of {path} ({error})") from error
    # The background is only known once the tree is read.
    if grid.background != 0.0:
        raise SceneError(
            f"{where}: grid \"{grid_name}\" has background {grid.background:g}, fog without end "
            "outside its voxels; save it with background 0"
        )
    return grid, warnings


def _active_box(grid, grid_name, where):
    """Lower index and shape of the active voxels, measured on the tree and never on metadata."""
    low, high = grid.evalActiveVoxelBoundingBox()
    # OpenVDB gives an inverted box for a grid without active voxels.
    if any(a > b for a, b in zip(low, high)):
        raise SceneError(f"{where}: grid \"{grid_name}\" is empty (no active voxel)")
    shape = tuple(b - a + 1 for a, b in zip(low, high))
    count = shape[0] * shape[1] * shape[2]
    if count > MAX_VOXELS:
        raise SceneError(
            f"{where}: grid \"{grid_name}\" spans {shape[0]} x {shape[1]} x {shape[2]} = {count} voxels, "
            f"more than the {MAX_VOXELS} that can be rendered; crop or resample it"
        )
    return tuple(low), shape


def _object_from_index(grid, low, grid_name, where) -> np.ndarray:
    transform = grid.transform
    if not transform.isLinear:
        raise SceneError(f"{where}: grid \"{grid_name}\" has a frustum transform; resample it to a box")
    origin = np.array(transform.indexToWorld((0.0, 0.0, 0.0)))
    matrix = np.eye(4)
    matrix[:3, 3] = origin
    for axis in range(3):
        unit = [0.0, 0.0, 0.0]
        unit[axis] = 1.0
        matrix[:3, axis] = np.array(transform.indexToWorld(tuple(unit))) - origin
    # Index 0 of the array is the box's lower voxel.
    matrix[:3, 3] += matrix[:3, :3] @ (np.array(low) + voxel_centre())
    return matrix


def voxel_centre() -> float:
    """Index coordinate at which Blender draws the centre of voxel 0, on each axis.

    OpenVDB puts it at 0. Blender before 5.0 draws voxel i over [i, i + 1], so its centre lies at
    1/2: measured with Cycles 4.2 and 4.5; Cycles 5.0 gives 0.
    """
    return 0.5 if bpy.app.version < (5, 0, 0) else 0.0
