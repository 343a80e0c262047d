"""One density grid of one .vdb file; no bpy, once imported."""

import os
import weakref
from dataclasses import dataclass, field
from typing import List, Optional, Union

import bpy
import numpy as np

from ...inference.scene import SceneError
from ...inference.scene.sparse_grid import SparseGrid
from .openvdb_module import load_openvdb
from .process import read_alone
from .worker import LEAF, SCALAR_GRIDS, read_grid

# Of an array of all voxels, and of leaves that hold something: 2 GiB as float32.
MAX_VOXELS = 1 << 29
# Of the box around all of them, 4096 x 2048 x 2048.
MAX_SPAN = 1 << 34
# Smaller boxes, and those of which a larger share of leaves holds something, become an array: that is faster.
DENSE_SPAN, DENSE_SHARE = 1 << 24, 0.5
# Bytes of a file that is read here rather than by another process, once that process has read it.
SMALL = 1 << 20
# What OpenVDB's exceptions become in Python.
READ_ERRORS = (OSError, LookupError, RuntimeError, ValueError, TypeError)
# Index coordinate at which Blender draws the centre of voxel 0, on each axis. OpenVDB puts it at 0. Blender before 5.0
# draws voxel i over [i, i + 1], so its centre lies at 1/2: measured with Cycles 4.2 and 4.5; Cycles 5.0 gives 0.
VOXEL_CENTRE = 0.5 if bpy.app.version < (5, 0, 0) else 0.0


class EmptyGrid(SceneError):
    """A grid without a voxel above 0."""


@dataclass
class DensityGrid:
    """density: float32 (nx, ny, nz), the active bounding box, finite and >= 0; not to be written to. Or a SparseGrid.
    low: int (3,), the file's index of its first voxel.
    object_from_index: float64 (4, 4), index of `density` to the object's own space.
    warnings: what was changed in the data, naming the object.
    """

    density: Union[np.ndarray, SparseGrid]
    object_from_index: np.ndarray
    low: np.ndarray
    warnings: List[str] = field(default_factory=list)


# What was read and is in use, by file, its time and size, and grid: (weak reference to the density, matrix, low, notes).
_in_use = {}
# Files that another process has read to an end, and grids that hold nothing, by the same.
_harmless, _empty = set(), set()


def read_density_grid(path: str, grid_name: str, owner: str, started=lambda process: None) -> DensityGrid:
    """Read grid `grid_name` of the file `path` for the object named `owner`; once while the result is in use.

    Negative and non-finite voxels become 0, as Cycles clamps them when shading; the warning says
    how many there were. started: see `read_alone`. Any thread may call; other threads run meanwhile.

    Raises SceneError, naming the object, for a missing or unreadable file, a missing grid, a grid
    that holds no scalar fog, or one too large; EmptyGrid for one that holds nothing.
    """
    where = f"Volume object \"{owner}\""
    known = density_grid_in_use(path, grid_name, owner)
    if known is not None:
        return known
    key = _key(path, grid_name)
    if key in _empty:
        raise _nothing(key, grid_name, where)
    facts, leaves = _read(path, grid_name, where, key, started)
    notes = _require_density(facts["grids"], path, grid_name, where)
    # The background is only known once the tree is read.
    if facts["background"] != 0.0:
        raise SceneError(
            f"{where}: grid \"{grid_name}\" has background {facts['background']:g}, fog without end "
            "outside its voxels; save it with background 0"
        )
    _require_box(facts["shape"], grid_name, where)
    numbers, values = leaves
    notes += _clean(values, grid_name)
    if not values.any():
        raise _nothing(key, grid_name, where)
    if facts["matrix"] is None:
        raise SceneError(f"{where}: grid \"{grid_name}\" has a frustum transform; resample it to a box")
    matrix = np.array(facts["matrix"])
    # Index 0 of the array is the box's lower voxel.
    matrix[:3, 3] += matrix[:3, :3] @ (np.array(facts["low"]) + VOXEL_CENTRE)
    density = _arranged(facts, numbers, values)
    for old in [old for old, (density, *_) in list(_in_use.items()) if density() is None]:
        _in_use.pop(old, None)
    low = np.array(facts["low"])
    _in_use[key] = weakref.ref(density), matrix, low, notes
    _harmless.add(key)
    return DensityGrid(density, matrix.copy(), low, [f"{where}: {note}" for note in notes])


def density_grid_in_use(path: str, grid_name: str, owner: str) -> Optional[DensityGrid]:
    """As `read_density_grid` where the grid is read already and in use, else None."""
    density, matrix, low, notes = _in_use.get(_key(path, grid_name), (lambda: None, None, None, ()))
    values = density()
    if values is None:
        return None
    return DensityGrid(values, matrix.copy(), low, [f"Volume object \"{owner}\": {note}" for note in notes])


def _nothing(key, grid_name, where) -> EmptyGrid:
    _empty.add(key)
    return EmptyGrid(f"{where}: grid \"{grid_name}\" is empty (no voxel above 0)")


def _key(path: str, grid_name: str):
    """Differs when a file has changed."""
    try:
        facts = os.stat(path)
    except OSError:
        return None
    return path, facts.st_mtime_ns, facts.st_size, grid_name


def unreadable(path: str, reason: str) -> str:
    """Why a volume file cannot be read, for a message."""
    if not os.path.isfile(path):
        return f"file not found: {path}"
    with open(path, "rb") as file:
        if file.read(40).startswith(b"version https://git-lfs"):
            return f"{path} is a Git LFS pointer; fetch the real file with 'git lfs pull'"
    return f"cannot read {path} as OpenVDB ({reason})"


def _require_density(grids, path, grid_name, where) -> List[str]:
    """Raise SceneError unless a file promises a grid of density; notes. grids: as `read_grid` tells them."""
    found = [(kind, use) for name, kind, use in grids if name == grid_name]
    if not found:
        names = ", ".join(f"\"{name}\"" for name, *_ in grids) or "none"
        raise SceneError(
            f"{where}: {os.path.basename(path)} has no grid \"{grid_name}\" (grids: {names}); "
            "set the density attribute in the volume's material to one of them"
        )
    kind, use = found[0]
    if kind not in SCALAR_GRIDS:
        raise SceneError(f"{where}: grid \"{grid_name}\" is a {kind}, not a grid of float density")
    if use == "level set":
        raise SceneError(
            f"{where}: grid \"{grid_name}\" is a level set, a distance and not a density; "
            "convert it to a fog volume"
        )
    several = f"{len(found)} grids are named \"{grid_name}\"; the first is rendered, as in Cycles"
    return [several] if len(found) > 1 else []


def _read(path, grid_name, where, key, started):
    """(facts, leaves) as `read_grid` and `_collect` have them: by another process, or here where that is not to be had
    or a small file harmless."""
    def collect(pieces):
        return _collect(pieces, grid_name, where)

    found = None
    if key not in _harmless or key[2] > SMALL:
        found = read_alone(path, grid_name, MAX_SPAN, where, collect, started)
    if found is None:
        try:
            facts, pieces = read_grid(load_openvdb(), path, grid_name, MAX_SPAN)
            found = facts, collect(pieces)
        except SceneError:
            raise
        except READ_ERRORS as error:
            found = {"error": error}, None
    if "error" in found[0]:
        raise SceneError(f"{where}: {unreadable(path, found[0]['error'])}")
    return found


def _collect(pieces, grid_name, where):
    """(numbers, values) of all pieces; a row of values more, the first, which is 0.

    Raises SceneError where they are too many.
    """
    parts, count = [], 0
    for part in pieces:
        parts.append(part)
        count += len(part[0])
        if count * LEAF**3 > MAX_VOXELS:
            raise SceneError(f"{where}: grid \"{grid_name}\" holds more than the {MAX_VOXELS} voxels that can be "
                             "rendered; crop or resample it")
    numbers = np.concatenate([np.zeros(0, np.int64), *(part[0] for part in parts)])
    values = np.zeros((1 + count, LEAF, LEAF, LEAF), np.float32)
    # Each piece is dropped once it is copied, so that memory holds them once.
    while parts:
        part = parts.pop()[1]
        values[1 + count - len(part):1 + count] = part
        count -= len(part)
    return numbers, values


def _arranged(facts, numbers, values):
    """The grid as a SparseGrid or, where that is better, an array."""
    first = np.subtract(facts["low"], facts["first"])
    sparse = SparseGrid.of_blocks(facts["shape"], first, facts["count"], numbers, values)
    span = np.prod(np.array(facts["shape"], float))
    if span <= DENSE_SPAN or (len(numbers) > DENSE_SHARE * np.prod(facts["count"]) and span <= MAX_VOXELS):
        dense = sparse.dense()
        dense.flags.writeable = False
        return dense
    values.flags.writeable = False
    return sparse


def _require_box(shape, grid_name, where) -> None:
    """Measured on the tree and never on metadata."""
    # OpenVDB gives an inverted box for a grid without active voxels.
    if min(shape) < 1:
        return
    count = shape[0] * shape[1] * shape[2]
    if count > MAX_SPAN:
        raise SceneError(
            f"{where}: grid \"{grid_name}\" spans {shape[0]} x {shape[1]} x {shape[2]} = {count} voxels, "
            f"more than the {MAX_SPAN} that can be rendered; crop or resample it"
        )


def _clean(values, grid_name) -> List[str]:
    """Make negative and non-finite voxels 0, and say so."""
    # NaN goes through both. The values are those of `_collect`.
    if values.min() >= 0.0 and values.max() < np.inf:
        return []
    invalid, negative = ~np.isfinite(values), values < 0.0
    values[invalid | negative] = 0.0
    return [f"{int(negative.sum())} negative and {int(invalid.sum())} NaN or infinite voxels "
            f"of grid \"{grid_name}\" were taken as 0"]
