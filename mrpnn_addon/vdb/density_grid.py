# SPDX-License-Identifier: GPL-3.0-or-later
"""One grid of one .vdb file. Any thread may read it: bpy is only imported."""

import os
import subprocess
import weakref
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from ...inference.scene import SceneError
from ...inference.scene.sparse_grid import SparseGrid
from .openvdb_module import load_openvdb
from .process import BY_LEAF, read_in_process
from .worker import COMPONENTS, LEAF, SCALAR_GRIDS, VECTOR_GRIDS, read_grid

# Limit of voxels in an array, and in leaves that are not empty: 2 GiB as float32.
MAX_VOXELS = 1 << 29
# Limit of voxels in the bounding box, 4096 x 2048 x 2048.
MAX_SPAN = 1 << 34
# Smaller boxes, and those with a larger share of leaves that are not empty, become arrays, which are faster.
DENSE_SPAN, DENSE_SHARE = 1 << 24, 0.5
# Files up to so many bytes are read in this process once another process has read them without crashing.
SMALL = 1 << 20
# Python's types of OpenVDB's exceptions.
READ_ERRORS = (OSError, LookupError, RuntimeError, ValueError, TypeError)
# Index coordinate, on each axis, at which Blender draws the centre of voxel 0. OpenVDB has 0. Blender before 5.0 draws
# voxel i over [i, i + 1], so its centre is at 1/2: measured with Cycles 4.2 and 4.5; Cycles 5.0 has 0.
VOXEL_CENTRE = 0.5 if bpy.app.version < (5, 0, 0) else 0.0


class EmptyGrid(SceneError):
    """A grid whose voxels are all 0."""


class InvalidGrid(EmptyGrid):
    """A grid whose voxels are all 0, NaN or infinite."""


@dataclass
class DensityGrid:
    """A grid in object space.

    density: float32 (nx, ny, nz), the active bounding box or more where inactive voxels are shown, or a SparseGrid, in
        whose blocks that are not stored all is the background; finite and read-only.
    low: int (3,), the file's index of its first voxel.
    object_from_index: float64 (4, 4), from index of `density` to object space.
    background: the value outside.
    warnings: changes made to the data, naming the object.
    """

    density: np.ndarray | SparseGrid
    object_from_index: np.ndarray
    low: np.ndarray
    background: float = 0.0
    warnings: list[str] = field(default_factory=list)

    @property
    def is_negative(self) -> bool:
        """Whether some values are below 0."""
        return min(float(self.density.min()), self.background) < 0.0


# Grids in use, by (path, time, size, grid name): weak reference to the density, matrix, low, background, notes.
_in_use: dict[tuple, tuple] = {}
# Files that another process has read without crashing, and grids whose voxels are all 0, by the same key, with whether
# some were NaN or infinite.
_verified: set[tuple] = set()
_empty: dict[tuple | None, bool] = {}


def read_density_grid(
    path: str, grid_name: str, owner: str, started: Callable[[subprocess.Popen], None] = lambda process: None
) -> DensityGrid:
    """Read grid `grid_name` of the file `path` for the object `owner`; cached while the result is in use.

    Of a grid of vectors one component is read: its name is the grid's and one of `worker.COMPONENTS`.

    Voxels that Cycles shows although they are not active are among its values. Non-finite voxels become 0; a warning
    gives their number and that of negative ones. started: see `read_in_process`. Any thread may call this; other
    threads run meanwhile.

    Raises SceneError, naming the object, for a missing or unreadable file, a missing grid, one that is not a fog volume
    of numbers, or one too large; EmptyGrid for one whose voxels are all 0.
    """
    where = f'volume "{owner}"'
    known = density_grid_in_use(path, grid_name, owner)
    if known is not None:
        return known
    key = _key(path, grid_name)
    if key in _empty:
        raise _nothing(_empty[key], grid_name, where)
    facts, leaves = _read(path, grid_name, where, key, started)
    notes = _require_density(facts["grids"], path, grid_name, where)
    _require_box(facts["shape"], grid_name, where)
    numbers, values = leaves
    background = float(np.float32(facts["background"]))
    if not np.isfinite(background):
        background = 0.0
        notes.append(f'grid "{grid_name}" has a background that is NaN or infinite; it counts as 0')
    values[0] = background
    invalid, found = _clean(values, grid_name)
    notes += found
    # OpenVDB's box is inverted where there are no active voxels.
    if min(facts["shape"]) < 1 or not values.any():
        _empty[key] = invalid
        raise _nothing(invalid, grid_name, where)
    if facts["matrix"] is None:
        raise SceneError(f'{where}: grid "{grid_name}" has a frustum transform; resample it to a box')
    matrix = np.array(facts["matrix"])
    low, shape = _shown_box(facts, numbers, values)
    # Index 0 of the array is the box's lower voxel.
    matrix[:3, 3] += matrix[:3, :3] @ (low + VOXEL_CENTRE)
    density = _arranged(facts, low, shape, numbers, values)
    for old in [old for old, (density, *_) in list(_in_use.items()) if density() is None]:
        _in_use.pop(old, None)
    _in_use[key] = weakref.ref(density), matrix, low, background, notes
    _verified.add(key)
    return DensityGrid(density, matrix.copy(), low, background, [f"{where}: {note}" for note in notes])


def density_grid_in_use(path: str, grid_name: str, owner: str) -> DensityGrid | None:
    """As `read_density_grid` where the grid is in use, else None."""
    density, matrix, low, background, notes = _in_use.get(_key(path, grid_name), (lambda: None, None, None, 0.0, ()))
    values = density()
    if values is None:
        return None
    return DensityGrid(values, matrix.copy(), low, background, [f'volume "{owner}": {note}' for note in notes])


def _nothing(invalid: bool, grid_name: str, where: str) -> EmptyGrid:
    if invalid:
        return InvalidGrid(f'{where}: grid "{grid_name}" is empty (all its voxels are 0, NaN or infinite)')
    return EmptyGrid(f'{where}: grid "{grid_name}" is empty (all its voxels are 0)')


def _key(path: str, grid_name: str) -> tuple | None:
    """Differs when the file has changed."""
    try:
        facts = os.stat(path)
    except OSError:
        return None
    return path, facts.st_mtime_ns, facts.st_size, grid_name


def unreadable(path: str, reason: str) -> str:
    """The reason why a volume file cannot be read, for a message."""
    if not os.path.isfile(path):
        return f"file not found: {path}"
    with open(path, "rb") as file:
        if file.read(40).startswith(b"version https://git-lfs"):
            return f"{path} is a Git LFS pointer; fetch the real file with 'git lfs pull'"
    return f"cannot read {path} as OpenVDB ({reason})"


def _require_density(grids: list, path: str, grid_name: str, where: str) -> list[str]:
    """Notes on a grid's metadata. Raises SceneError unless it is a density. grids: as `read_grid` returns them."""
    found = [(kind, use) for name, kind, use in grids if name == grid_name]
    wanted: tuple[str, ...] = SCALAR_GRIDS
    if not found and grid_name.endswith(COMPONENTS):
        grid_name, wanted = grid_name[: -len(COMPONENTS[0])], VECTOR_GRIDS
        found = [(kind, use) for name, kind, use in grids if name == grid_name]
    if not found:
        names = ", ".join(f'"{name}"' for name, *_ in grids) or "none"
        raise SceneError(
            f'{where}: {os.path.basename(path)} has no grid "{grid_name}" (grids: {names}); '
            "set the density attribute in the volume's material to one of them"
        )
    kind, use = found[0]
    if kind not in wanted:
        raise SceneError(f'{where}: grid "{grid_name}" is a {kind}, which this Blender cannot read as numbers')
    if use == "level set":
        raise SceneError(
            f'{where}: grid "{grid_name}" is a level set, a distance and not a density; convert it to a fog volume'
        )
    several = f'{len(found)} grids are named "{grid_name}"; the first is rendered, as in Cycles'
    return [several] if len(found) > 1 else []


def _read(
    path: str, grid_name: str, where: str, key: tuple | None, started: Callable[[subprocess.Popen], None]
) -> tuple[dict, Any]:
    """(facts, leaves) of `read_grid` and `_collect`: from another process, or from this one where no process can be
    started or the file is small and verified.
    """

    def collect(pieces: Iterator[tuple[np.ndarray, np.ndarray]]) -> Any:
        return _collect(pieces, grid_name, where)

    found = None
    if key not in _verified or key[2] > SMALL:
        found = read_in_process(path, grid_name, MAX_SPAN, where, collect, started)
    if found is None:
        try:
            facts, pieces = read_grid(load_openvdb(), path, grid_name, MAX_SPAN, BY_LEAF)
            found = facts, collect(pieces)
        except SceneError:
            raise
        except READ_ERRORS as error:
            found = {"error": error}, None
    if "error" in found[0]:
        raise SceneError(f"{where}: {unreadable(path, found[0]['error'])}")
    return found


def _collect(
    pieces: Iterator[tuple[np.ndarray, np.ndarray]], grid_name: str, where: str
) -> tuple[np.ndarray, np.ndarray]:
    """(numbers, values) of all pieces; `values` has an extra first row.

    Raises SceneError where there are too many.
    """
    parts, count = [], 0
    for part in pieces:
        parts.append(part)
        count += len(part[0])
        if count * LEAF**3 > MAX_VOXELS:
            raise SceneError(
                f'{where}: grid "{grid_name}" holds more than the {MAX_VOXELS} voxels that can be '
                "rendered; crop or resample it"
            )
    numbers = np.concatenate([np.zeros(0, np.int64), *(part[0] for part in parts)])
    values = np.zeros((1 + count, LEAF, LEAF, LEAF), np.float32)
    # Pieces are freed once they are copied, so that memory holds the values once.
    while parts:
        last = parts.pop()[1]
        values[1 + count - len(last) : 1 + count] = last
        count -= len(last)
    return numbers, values


def _shown_box(facts: dict, numbers: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lower index and size, int (3,) each, of the box of active voxels, with those around it that are shown."""
    low, high = np.array(facts["low"]), np.add(facts["low"], facts["shape"])
    corners = LEAF * np.stack(np.unravel_index(numbers, facts["count"]), axis=1) + facts["first"]
    grown_low, grown_high = low.copy(), high.copy()
    for axis in range(3):
        for beyond in (corners[:, axis] < low[axis], corners[:, axis] + LEAF > high[axis]):
            rows = np.flatnonzero(beyond)
            planes = (values[1 + rows] != values[0, 0, 0, 0]).any(axis=tuple(1 + a for a in range(3) if a != axis))
            if len(places := corners[rows, axis][:, None] + np.arange(LEAF)) and planes.any():
                grown_low[axis] = min(grown_low[axis], places[planes].min())
                grown_high[axis] = max(grown_high[axis], places[planes].max() + 1)
    return grown_low, grown_high - grown_low


def _arranged(
    facts: dict, low: np.ndarray, shape: np.ndarray, numbers: np.ndarray, values: np.ndarray
) -> np.ndarray | SparseGrid:
    """The grid as a SparseGrid or, where that is faster, an array. low, shape: of `_shown_box`."""
    sparse = SparseGrid.of_blocks(shape, low - facts["first"], facts["count"], numbers, values)
    span = np.prod(np.array(shape, float))
    if span <= DENSE_SPAN or (len(numbers) > DENSE_SHARE * np.prod(facts["count"]) and span <= MAX_VOXELS):
        background = values[0, 0, 0, 0]
        dense = sparse.with_values(values - background).dense() + background if background else sparse.dense()
        dense.flags.writeable = False
        return dense
    values.flags.writeable = False
    return sparse


def _require_box(shape: Sequence[int], grid_name: str, where: str) -> None:
    """Raise SceneError for a box that is too large; measured on the tree, not on metadata."""
    # OpenVDB's box is inverted where there are no active voxels.
    if min(shape) < 1:
        return
    count = shape[0] * shape[1] * shape[2]
    if count > MAX_SPAN:
        raise SceneError(
            f'{where}: grid "{grid_name}" spans {shape[0]} x {shape[1]} x {shape[2]} = {count} voxels, '
            f"more than the {MAX_SPAN} that can be rendered; crop or resample it"
        )


def _clean(values: np.ndarray, grid_name: str) -> tuple[bool, list[str]]:
    """Set non-finite voxels to 0; whether there were any, and notes of their number and that of negative ones."""
    # NaN fails both comparisons.
    if values.min() >= 0.0 and values.max() < np.inf:
        return False, []
    invalid, negative = ~np.isfinite(values), np.count_nonzero(values[1:] < 0.0)
    values[invalid] = 0.0
    found = []
    if negative:
        found.append(f"{negative} negative voxels, whose density is 0 as in Cycles")
    if invalid.any():
        found.append(f"{np.count_nonzero(invalid)} NaN or infinite voxels, which were set to 0")
    return bool(invalid.any()), [f'grid "{grid_name}" has {" and ".join(found)}'] if found else []
