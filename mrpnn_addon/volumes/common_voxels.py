# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids of one file on common voxels, where Cycles samples each grid at points."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ...inference.numerics.small_matmul import affine_inverse
from ...inference.scene import SceneError
from ...inference.scene.sparse_grid import EDGE, SparseGrid
from ..vdb.density_grid import DENSE_SPAN, MAX_SPAN, MAX_VOXELS, DensityGrid
from .shaded_grid import refine

# Blocks that are resampled together.
BLOCKS_PER_BATCH = 1 << 10
# The voxels of a grid that has so many times as many per volume are taken for all.
FINER = 2.0


@dataclass
class CommonVoxels:
    """Grids by name and the offset int (3,) of each in their common box.

    shape: int (3,), voxels of the box. object_from_index: float64 (4, 4). low: int (3,), the file's index of the box's
    first voxel. backgrounds: values outside, by name. is_negative: whether some values are below 0. warnings: about the
    file and what was done, naming the object. is_refined: whether the voxels are half as wide as the grids'.
    """

    grids: dict[str, np.ndarray | SparseGrid]
    offsets: dict[str, np.ndarray]
    shape: np.ndarray
    object_from_index: np.ndarray
    low: np.ndarray
    backgrounds: dict[str, float]
    is_negative: bool
    warnings: list[str]
    is_refined: bool = False


def common_voxels(
    read: dict[str, DensityGrid],
    shaping: list[str],
    where: str,
    check: Callable[[], None],
    refines: Callable[[int, bool], bool] = lambda voxels, is_negative: False,
) -> CommonVoxels:
    """Place grids in one box, resampled trilinearly where their voxels differ.

    The voxels are those of the finest of the grids `shaping`, which shape the density, or of a much finer one unless
    they would be too many, which a warning tells. check: called often; an exception that it raises stops the work.
    refines: whether so many voxels, some of them negative or none, will be refined. Grids between whose voxels those
    of another lie are then sampled on voxels half as wide, which miss fewer of their extremes.

    Raises SceneError, prefixed with `where`, where the box would be too large.
    """
    warnings = [warning for grid in read.values() for warning in grid.warnings]
    sizes = {name: abs(float(np.linalg.det(grid.object_from_index[:3, :3]))) for name, grid in read.items()}
    finest, chosen = (min(names, key=lambda name: sizes[name]) for names in (read, shaping))
    if FINER * sizes[finest] < sizes[chosen]:
        most = max(_box(grid, read[finest])[1].astype(float).prod() for grid in read.values())
        if most <= DENSE_SPAN:
            chosen = finest
        else:
            warnings.append(
                f'{where}: grid "{finest}" has smaller voxels than grid "{chosen}" and loses detail; resample it to '
                "the same voxels"
            )
    reference, is_negative = read[chosen], any(grid.is_negative for grid in read.values())
    is_refined = (
        isinstance(reference.density, np.ndarray)
        and 8 * reference.density.size <= DENSE_SPAN
        and not all(_is_on(grid, reference) for grid in read.values())
        and refines(reference.density.size, is_negative)
    )
    if is_refined:
        reference = _refined(reference)
    placed = {name: _on(grid, reference, name, where, check) for name, grid in read.items()}
    offsets = {name: offset for name, (_, offset) in placed.items()}
    low = np.min(list(offsets.values()), axis=0)
    high = np.max([offset + grid.shape for grid, offset in placed.values()], axis=0)
    if np.prod((high - low).astype(float)) > MAX_SPAN:
        raise SceneError(
            f"{where}: its grids are so far apart that the box around them has more than {MAX_SPAN} voxels"
        )
    object_from_index = reference.object_from_index.copy()
    object_from_index[:3, 3] += object_from_index[:3, :3] @ low
    return CommonVoxels(
        {name: grid for name, (grid, _) in placed.items()},
        {name: offset - low for name, offset in offsets.items()},
        high - low,
        object_from_index,
        reference.low + low,
        {name: grid.background for name, grid in read.items()},
        is_negative,
        warnings,
        is_refined,
    )


def _refined(grid: DensityGrid) -> DensityGrid:
    """A grid whose density is an array on voxels half as wide, as `refine` makes them."""
    matrix = grid.object_from_index.copy()
    matrix[:3, 3] -= 0.5 * matrix[:3, :3].sum(axis=1)
    matrix[:3, :3] *= 0.5
    density = refine(np.asarray(grid.density), grid.background)
    return replace(grid, density=density, object_from_index=matrix, low=2 * grid.low - 1)


def _is_on(grid: DensityGrid, reference: DensityGrid) -> bool:
    """Whether the voxels of a grid are some of another's, or would be in a larger box."""
    relative = affine_inverse(reference.object_from_index) @ grid.object_from_index
    apart = relative - np.eye(4)
    apart[:3, 3] -= np.round(apart[:3, 3])
    return bool(np.abs(apart[:3, :3]).max() <= 1e-4 and np.abs(apart[:3, 3]).max() <= 1e-2)


def _on(
    grid: DensityGrid, reference: DensityGrid, name: str, where: str, check: Callable[[], None]
) -> tuple[np.ndarray | SparseGrid, np.ndarray]:
    """A grid on the voxels of another, and the offset int (3,) of its box from the other's."""
    relative = affine_inverse(reference.object_from_index) @ grid.object_from_index
    offset = np.round(relative[:3, 3]).astype(int)
    both_sparse = isinstance(grid.density, SparseGrid) and isinstance(reference.density, SparseGrid)
    apart = (_blocks_start(grid) - _blocks_start(reference) - offset) % EDGE
    if _is_on(grid, reference) and not (both_sparse and apart.any()):
        return grid.density, offset
    return _resampled(grid, reference, name, where, check)


def _blocks_start(grid: DensityGrid) -> np.ndarray:
    """int (3,), position of voxel 0 in the blocks of a SparseGrid; 0 for arrays."""
    return grid.density.first if isinstance(grid.density, SparseGrid) else np.zeros(3, int)


def _box(grid: DensityGrid, reference: DensityGrid) -> tuple[np.ndarray, np.ndarray]:
    """Lowest index and size, int (3,), in the voxels of another grid, of where a grid's interpolant is not its
    background.
    """
    relative = affine_inverse(reference.object_from_index) @ grid.object_from_index
    ends = np.stack(np.meshgrid(*((-1.0, n) for n in grid.density.shape), indexing="ij"), axis=-1).reshape(-1, 3)
    corners = ends @ relative[:3, :3].T + relative[:3, 3]
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int)
    return low, high - low + 1


def _resampled(
    grid: DensityGrid, reference: DensityGrid, name: str, where: str, check: Callable[[], None]
) -> tuple[np.ndarray | SparseGrid, np.ndarray]:
    low, size = _box(grid, reference)
    # Blocks of both lie in one lattice.
    shift = (low + _blocks_start(reference)) % EDGE
    low, size = low - shift, size + shift
    if np.prod(size.astype(float)) > MAX_SPAN:
        raise SceneError(
            f"{where}: its grids are so far apart that the box around them has more than {MAX_SPAN} voxels"
        )
    background = np.float32(grid.background)
    if isinstance(grid.density, SparseGrid):
        source = grid.density.with_values(grid.density.values - background)
    else:
        source = SparseGrid.of_dense(grid.density - background)
    to_reference = affine_inverse(reference.object_from_index) @ grid.object_from_index
    count = -(-size // EDGE)
    blocks = _covered(source, to_reference, low, count)
    from_reference = affine_inverse(to_reference)
    inner = np.stack(np.unravel_index(np.arange(EDGE**3), (EDGE,) * 3), axis=1)
    numbers, values, kept = [], [np.zeros((1, EDGE, EDGE, EDGE), np.float32)], 0
    for start in range(0, len(blocks), BLOCKS_PER_BATCH):
        check()
        batch = blocks[start : start + BLOCKS_PER_BATCH]
        corners = EDGE * np.stack(np.unravel_index(batch, count), axis=1) + low
        index = (corners[:, None] + inner).reshape(-1, 3) @ from_reference[:3, :3].T + from_reference[:3, 3]
        found = source.sample(np.ascontiguousarray(index.T, np.float32)).reshape(-1, EDGE, EDGE, EDGE)
        held = found.any(axis=(1, 2, 3))
        numbers.append(batch[held])
        values.append(found[held])
        kept += np.count_nonzero(held)
        if kept * EDGE**3 > MAX_VOXELS:
            raise SceneError(
                f'{where}: grid "{name}" would hold more than the {MAX_VOXELS} voxels that can be rendered on the '
                "voxels of the others; resample it to larger voxels"
            )
    rows = np.concatenate(values)
    numbers = np.concatenate([np.zeros(0, np.int64), *numbers])
    # Only the last blocks reach beyond the box, where all is 0.
    size = count * EDGE
    sparse = SparseGrid.of_blocks(size, (0, 0, 0), count, numbers, rows)
    if np.prod(size.astype(float)) <= DENSE_SPAN:
        return sparse.dense() + background, low
    return sparse.with_values(sparse.values + background), low


def _covered(source: SparseGrid, to_reference: np.ndarray, low: np.ndarray, count: np.ndarray) -> np.ndarray:
    """int64 (n,), positions in a box of `count` blocks from voxel `low` on, of those that the stored blocks reach."""
    places = np.argwhere(source.table)
    start = EDGE * places - source.first - 1.0
    linear = to_reference[:3, :3]
    reach = (EDGE + 1.0) * np.minimum(linear, 0.0).sum(axis=1), (EDGE + 1.0) * np.maximum(linear, 0.0).sum(axis=1)
    origin = start @ linear.T + to_reference[:3, 3] - low
    first = np.floor((origin + reach[0]) / EDGE).astype(int)
    steps = np.floor((origin + reach[1]) / EDGE).astype(int) - first
    found = np.zeros(0, np.int64)
    for step in np.ndindex(*(steps.max(axis=0, initial=0) + 1)):
        inside = np.all((step <= steps) & (first + step >= 0) & (first + step < count), axis=1)
        found = np.union1d(found, np.ravel_multi_index(tuple((first + step)[inside].T), tuple(count)))
    return found
