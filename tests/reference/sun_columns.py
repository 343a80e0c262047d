# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depths towards suns, as the kernels sweep and read them."""

from collections.abc import Iterator

import numpy as np

from inference.grids.bound_medium import BoundMedium
from inference.grids.optical_depth_sweep import Weights, cubic, linear
from inference.grids.sparse_columns import SparseColumns
from inference.grids.sun_optical_depth import MAX_DEPTH, VISIBLE, DenseColumns, SunOpticalDepth
from inference.numerics.interpolation import lerp_into
from inference.numerics.intersection import box_interval
from inference.plan.sun_columns import BEFORE, MORE, Shear, TilePlan
from inference.scene.sparse_grid import EDGE, SparseGrid

# The two Gauss-Legendre nodes in [0, 1]: exact for the cubic that the density is between planes of voxel centres.
GAUSS_NODES = (np.float32(0.5 - 0.5 / np.sqrt(3.0)), np.float32(0.5 + 0.5 / np.sqrt(3.0)))
ZERO = np.float32(0.0)


def shift_up(planes: np.ndarray, f_b: np.float32, f_c: np.float32, weights: Weights) -> np.ndarray:
    """Resample planes (..., b, c), 0 outside, at points a fraction beyond each cell.

    f_b, f_c: fractions along b and c, which grow by MORE, from BEFORE cells before the first. weights: `linear` or
    `cubic`.
    """
    for axis, fraction in ((-2, f_b), (-1, f_c)):
        count = planes.shape[axis] + MORE
        beside = [(0, 0)] * planes.ndim
        beside[axis] = (MORE, MORE)
        padded = np.moveaxis(np.pad(planes, beside), axis, 0)
        taps = [np.float32(weight) * padded[i : i + count] for i, weight in enumerate(weights(fraction)) if weight]
        planes = np.moveaxis(sum(taps[1:], taps[0]), 0, axis)
    return planes


def shift_back(columns: np.ndarray, f_b: np.float32, f_c: np.float32) -> np.ndarray:
    """Depths at the cells, from columns placed as by `shift_up`."""
    first, end = BEFORE, len(columns) - MORE + BEFORE
    b = columns[first:end] * (1 - f_b) + columns[first - 1 : end - 1] * f_b
    end = columns.shape[1] - MORE + BEFORE
    return b[:, first:end] * (1 - f_c) + b[:, first - 1 : end - 1] * f_c


def sweep(
    density: np.ndarray, index_direction: np.ndarray, step_length: float = 1.0, weights: Weights = linear
) -> Iterator[tuple[int, np.ndarray, np.float32, np.float32]]:
    """Yield for each slice across the sun's main axis: its index, optical depths and two fractions.

    Arguments as for `sun_optical_depth`. The depths, float32 (b + MORE, c + MORE), are those from the slice to the sun
    at points that lie by the fractions beyond b - BEFORE and c - BEFORE: every column follows one ray through all
    slices. weights: of `shift_up`; with `cubic`, depths beside sharp edges may fall slightly below 0. The array is
    reused for the next slice.
    """
    shear = Shear(density.shape, index_direction)
    slices = np.moveaxis(density, shear.main, 0)
    nb, nc = slices.shape[1:]
    # Half the length through a slice: each slice adds to the points before and after it.
    half_step = np.float32(shear.half_step * step_length)
    columns = np.zeros(shear.size, np.float32)
    for index in shear.towards_sun(0, len(slices)):
        [(whole_b, whole_c)], [(f_b, f_c)] = shear.shift(np.array([index]))
        # Column p meets the slice at p + slope * k, so cell 0 touches columns from -whole - BEFORE.
        start_b, start_c = -whole_b - BEFORE - shear.first[0], -whole_c - BEFORE - shear.first[1]
        window = columns[start_b : start_b + nb + MORE, start_c : start_c + nc + MORE]
        half_slice = shift_up(slices[index], f_b, f_c, weights)
        half_slice *= half_step
        window += half_slice
        yield index, window, f_b, f_c
        window += half_slice


def cell_depths(density: np.ndarray, direction: np.ndarray, step_length: float = 1.0) -> np.ndarray:
    """As `sun_optical_depth`."""
    depth = np.empty_like(density, dtype=np.float32)
    out = np.moveaxis(depth, int(np.abs(direction).argmax()), 0)
    for index, columns, f_b, f_c in sweep(density, direction, step_length):
        out[index] = shift_back(columns, f_b, f_c)
    return depth


def dense_depths(padded: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """Depths that DenseColumns stores."""
    main = int(np.abs(direction).argmax())
    shape = [padded.shape[axis] + MORE for axis in range(3) if axis != main]
    depths = np.zeros((padded.shape[main] + 2, *shape), np.float32)
    for number, columns, *_ in sweep(padded, direction, weights=cubic):
        np.maximum(columns, 0.0, out=depths[number + 1])
    return depths


def sparse_tiles(grid: SparseGrid, direction: np.ndarray) -> np.ndarray:
    """Depths that SparseColumns stores, float32 (T, 8, 8)."""
    plan = TilePlan(grid, direction)
    shear, slabs, tiles = plan.shear, plan.slabs, [np.zeros((1, EDGE, EDGE), np.float32)]
    plane = np.zeros([EDGE * n for n in plan.shape], np.float32)
    columns = plane.reshape(plan.shape[0], EDGE, plan.shape[1], EDGE).swapaxes(1, 2)
    for slab, touched, left in plan.rows():
        tiles.append(np.maximum(columns[left], 0.0))
        own, (b, c) = np.zeros((int(touched.sum()), EDGE, EDGE, EDGE), np.float32), np.nonzero(slabs[slab])
        blocks = np.moveaxis(grid.values[slabs[slab][b, c]], shear.main + 1, 1)
        for index in shear.towards_sun(EDGE * slab, EDGE * (slab + 1)):
            (tile_b, in_b, f_b), (tile_c, in_c, f_c) = plan.place(index)
            half_slices = shift_up(blocks[:, index % EDGE], f_b, f_c, cubic) * np.float32(shear.half_step)
            firsts = list(zip(EDGE * (b + tile_b) + in_b, EDGE * (c + tile_c) + in_c))
            _add(plane, half_slices, firsts)
            own[:, index % EDGE] = np.maximum(columns[touched], 0.0)
            _add(plane, half_slices, firsts)
        tiles.append(own.reshape(-1, EDGE, EDGE))
    found = np.concatenate(tiles)
    return np.concatenate([found, np.zeros((plan.tiles() - len(found), EDGE, EDGE), np.float32)])


def _add(columns: np.ndarray, values: np.ndarray, firsts: list[tuple[int, int]]) -> None:
    """Add (n, 8 + MORE, 8 + MORE) to columns from the first ones of each on."""
    for value, (b, c) in zip(values, firsts):
        columns[b : b + EDGE + MORE, c : c + EDGE + MORE] += value


def depth_at(
    sun: SunOpticalDepth, index: np.ndarray, sigma_t: float, camera_depth: np.ndarray | np.float32 = ZERO
) -> np.ndarray:
    """Optical depth float32 (N,) at continuous indices float32 (3, N).

    camera_depth: (N,) optical depth between the point and the camera; the larger it is, the less accurate the
    result needs to be.
    """
    extinction, integration = np.float32(sigma_t), sun.integration(sigma_t)
    slices = integration.slices
    place = index + np.float32(1.0)
    along = place[sun.main]
    slice_below = np.floor(along)
    ahead = slice_below + np.float32(1.0) - along if sun.step > 0 else along - slice_below
    following = slice_below.astype(np.int32) + (1 if sun.step > 0 else 0)
    if not integration.everywhere:
        # Linear between the adjacent slices.
        after = _on_slice(sun, place, ahead, following)
        before = _on_slice(sun, place, ahead - np.float32(1.0), following - sun.step)
        depth = lerp_into(after, before, ahead)
        depth *= extinction
        if not slices:
            return depth
        left = np.flatnonzero((depth > 0.0) & (depth + camera_depth < VISIBLE))
        if not len(left):
            return depth
    else:
        # Points that are dark beyond the slices to integrate are dark.
        ahead_of_last, last = ahead + np.float32(slices - 1), following + sun.step * (slices - 1)
        depth = _on_slice(sun, place, ahead_of_last, last, lowest=True) * extinction
        left = np.flatnonzero(depth < MAX_DEPTH)
    depth[left] = 0.0
    start, way = place[:, left], ahead[left]
    highest = np.array(sun.grid.shape, np.float32)[:, None] + 1
    for _ in range(slices):
        depth[left] += _through(sun, start, way, integration.steep) * extinction
        start = start + way * sun.move[:, None]
        # A ray that starts on a face by which the sun's rays enter has not left the grid.
        past = np.where(sun.move[:, None] > 0.0, start >= highest, start <= 0.0).any(axis=0)
        follow = ~past & (depth[left] < MAX_DEPTH)
        left, start = left[follow], start[:, follow]
        way = np.ones(len(left), np.float32)
    number = following[left] + sun.step * (slices - 1)
    depth[left] += _on_slice(sun, start, np.float32(0.0), number) * extinction
    return depth


def _through(sun: SunOpticalDepth, start: np.ndarray, way: np.ndarray, steep: bool) -> np.ndarray:
    """Integral of the density (N,) along the sun's rays from positions (3, N) to the next slice, `way` slices on.

    steep: whether to split the integral at planes of voxel centres, between which the density is smooth.
    """
    planes = [np.zeros_like(way), way]
    for axis in sun.others if steep else ():
        slope = sun.move[axis]
        if slope != 0.0:
            at = start[axis]
            plane = np.floor(at) + np.float32(1.0) if slope > 0.0 else np.ceil(at) - np.float32(1.0)
            planes.append(np.minimum((plane - at) / slope, way))
    cuts = np.sort(planes, axis=0)
    total = np.zeros_like(way)
    for first, last in zip(cuts[:-1], cuts[1:]):
        part = last - first
        for share in GAUSS_NODES:
            place = start + (first + share * part) * sun.move[:, None]
            total += sun.grid.sample(place - np.float32(1.0)) * part
    return total * (np.float32(0.5) * sun.length)


def _on_slice(
    sun: SunOpticalDepth, place: np.ndarray, ahead: np.ndarray | np.float32, number: np.ndarray, lowest: bool = False
) -> np.ndarray:
    """Depth (N,) where rays from positions (3, N) meet slices number (N,), `ahead` slices on.

    lowest: the smallest depth of the four surrounding columns instead of the interpolated one.
    """
    columns = sun.columns
    number = np.clip(number + columns.first, 0, len(columns.offsets) - 1)
    cells, parts = [], []
    for column, (axis, size) in enumerate(zip(sun.others, sun.columns.size)):
        at = ahead * sun.move[axis] + place[axis]
        at += sun.columns.offsets[:, column].take(number)
        np.clip(at, np.float32(0.0), np.float32(size - 1), out=at)
        cell = np.minimum(at.astype(np.int32), size - 2)
        parts.append(np.subtract(at, cell, out=at))
        cells.append(cell)
    corners, (u, v) = _corners(columns, number, *cells), parts
    if lowest:
        return np.min(corners, axis=0)
    return lerp_into(lerp_into(corners[0], corners[1], v), lerp_into(corners[2], corners[3], v), u)


def _corners(
    columns: DenseColumns | SparseColumns, number: np.ndarray, b: np.ndarray, c: np.ndarray
) -> list[np.ndarray]:
    """Depths (N,) of columns (b, c), (b, c + 1), (b + 1, c) and (b + 1, c + 1) on stored slices."""
    if isinstance(columns, DenseColumns):
        base = (number * np.intp(columns.size[0]) + b) * np.intp(columns.size[1]) + c
        flat, row = columns.depths.reshape(-1), columns.size[1]
        return [flat[offset:].take(base) for offset in (0, 1, row, row + 1)]
    table, tiles = columns.table.reshape(-1), columns.tiles.reshape(-1)
    _, tiles_b, tiles_c = columns.table.shape
    row, inner = (number >> 3) * np.int32(tiles_b), number & 7
    found = []
    for b_end in (b, b + 1):
        line, above = (row + (b_end >> 3)) * np.int32(tiles_c), (b_end & 7) << 3
        for c_end in (c, c + 1):
            tile = table.take(line + (c_end >> 3))
            tile = ((tile >> 1) + (tile & 1) * inner).astype(np.intp)
            tile <<= 6
            tile += above + (c_end & 7)
            found.append(tiles.take(tile))
    return found


def sun_optical_depth(
    medium: BoundMedium, index: np.ndarray, sun: int, may_be_outside: bool, camera_depth: np.ndarray | np.float32 = ZERO
) -> np.ndarray:
    """Optical depth float32 (N,) from continuous indices float32 (3, N) to a sun.

    may_be_outside: whether points may lie outside the support. They are moved towards the sun onto it; where the
    ray misses it the depth is 0. camera_depth: as for SunOpticalDepth.
    """
    depth = medium.sun_depths[sun]
    if not may_be_outside:
        return depth_at(depth, index, medium.sigma_t, camera_depth)
    direction = depth.direction
    near, far = box_interval(index.T, direction[None], *medium.grid.box)
    hits = far > np.maximum(near, 0.0)
    index = index + np.where(hits, np.maximum(near, 0.0), 0.0) * direction[:, None]
    return np.where(hits, depth_at(depth, index.astype(np.float32), medium.sigma_t, camera_depth), np.float32(0.0))
