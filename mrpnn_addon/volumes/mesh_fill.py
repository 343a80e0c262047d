# SPDX-License-Identifier: GPL-3.0-or-later
"""Closed meshes as grids of the share of each voxel that lies inside."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from ...inference.scene import SceneError

# Voxels along the longest side.
CELLS = 128
# Voxels along any side: thinner fog would blur, which changes how much it hides.
LEAST = 16
# A box along the principal axes is used where its volume is less than this share of the one along the object's axes.
TURNED_SHARE = 0.25
# Columns per voxel and axis, along which the inside is exact.
COLUMNS = 2
# Columns avoid voxel centres, so that none meets the edges of regular meshes.
OFFSET = 0.5137, 0.4931
# Share of columns, or of the surface, that may be a gap.
MAX_GAP = 0.005
PAIRS_PER_BATCH = 1 << 21


@dataclass
class Inside:
    """share: float32 (nx, ny, nz) in [0, 1]. object_from_index: float64 (4, 4), voxel centres to object. inverted:
    whether the normals point inwards.
    """

    share: np.ndarray
    object_from_index: np.ndarray
    inverted: bool = False


def fill(corners: np.ndarray, matrix: np.ndarray, where: str, check: Callable[[], None] = lambda: None) -> Inside:
    """The inside of a mesh, in voxels that are about cubic in the world.

    corners: float64 (T, 3, 3), its triangles in object space. matrix: float64 (4, 4), object to world. check: called
    often; an exception that it raises stops the work.

    Raises SceneError, prefixed with `where`, for a mesh that is flat or not closed.
    """
    if not len(corners):
        raise SceneError(f"{where}: the mesh has no faces, so it encloses no volume; add faces")
    axes = _axes(corners, matrix)
    corners, matrix = corners @ axes, matrix @ _frame(axes)
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    if np.any(high - low <= 1e-9 * (high - low).max()):
        raise SceneError(f"{where}: the mesh is flat and encloses no volume; give it thickness, as by Solidify")
    extent = (high - low) * np.linalg.norm(matrix[:3, :3], axis=0)
    cells = np.maximum(np.ceil(extent / extent.max() * CELLS - 1e-6), LEAST).astype(int)
    size = (high - low) / cells
    corners = (corners - low) / size
    share, gaps = _share(corners, cells, check)
    # The area vectors of a closed surface sum to 0.
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    if max(gaps, np.linalg.norm(areas.sum(axis=0)) / np.linalg.norm(areas, axis=1).sum()) > MAX_GAP:
        raise SceneError(
            f"{where}: the mesh is not closed, so it has no inside; close its holes, of a curve with Bevel > Fill Caps"
        )
    index = np.eye(4)
    index[:3, :3] = np.diag(size)
    index[:3, 3] = low + size / 2.0
    signed_volume = np.einsum("ti,ti->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    return Inside(share=share, object_from_index=_frame(axes) @ index, inverted=bool(signed_volume < 0.0))


def _axes(corners: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """(3, 3), orthonormal columns: the axes of the voxels in object space, which follow thin meshes."""
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    middle = corners.mean(axis=1)
    apart = (corners - np.average(middle, axis=0, weights=areas)) if areas.any() else corners - middle.mean(axis=0)
    moments = np.einsum("t,tci,tcj->ij", areas, apart, apart)
    if not np.isfinite(moments).all():
        return np.eye(3)
    turned = np.linalg.eigh(moments)[1]
    turned[:, 0] *= np.sign(np.linalg.det(turned))

    def volume(axes: np.ndarray) -> float:
        extent = np.ptp((corners @ axes).reshape(-1, 3), axis=0)
        return float(np.prod(extent * np.linalg.norm(matrix[:3, :3] @ axes, axis=0)))

    return turned if volume(turned) < TURNED_SHARE * volume(np.eye(3)) else np.eye(3)


def _frame(axes: np.ndarray) -> np.ndarray:
    frame = np.eye(4)
    frame[:3, :3] = axes
    return frame


def _share(corners: np.ndarray, cells: np.ndarray, check: Callable[[], None]) -> tuple:
    """Inside share of each voxel, and the share of columns whose entries and exits do not balance.

    corners: (T, 3, 3) in voxels.
    """
    steps = np.zeros((cells[0] * cells[1], cells[2] + 2))
    crossings = np.zeros((cells[0] * COLUMNS) * (cells[1] * COLUMNS))
    met = np.zeros(len(crossings), bool)
    for column, height, sign in _crossings(corners, cells):
        check()
        x, y = np.divmod(column, cells[1] * COLUMNS)
        voxel = (x // COLUMNS) * cells[1] + y // COLUMNS
        level = np.clip(np.floor(height).astype(int), 0, cells[2])
        into = height - level
        flat = voxel * steps.shape[1] + level
        # Everything above a crossing is inside, and part of its voxel.
        steps += np.bincount(flat, sign * (1.0 - into), steps.size).reshape(steps.shape)
        steps += np.bincount(flat + 1, sign * into, steps.size).reshape(steps.shape)
        crossings += np.bincount(column, sign, len(crossings))
        met[column] = True
    inside = np.cumsum(steps, axis=1)[:, :-2] / COLUMNS**2
    # Inward normals are accepted, too.
    inside = np.clip(inside if inside.sum() > 0.0 else -inside, 0.0, 1.0)
    gaps = np.count_nonzero(crossings[met]) / max(np.count_nonzero(met), 1)
    return inside.reshape(cells).astype(np.float32), gaps


def _crossings(corners: np.ndarray, cells: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Yield (column, height, sign) where columns along z meet triangles; sign 1 where they enter."""
    flat = corners[:, :, :2] * COLUMNS - OFFSET
    first = np.maximum(np.ceil(flat.min(axis=1)), 0).astype(int)
    last = np.minimum(np.floor(flat.max(axis=1)), np.array(cells[:2]) * COLUMNS - 1).astype(int)
    spans = np.maximum(last - first + 1, 0)
    counts = spans.prod(axis=1)
    start = 0
    while start < len(corners):
        end = start + max(int(np.searchsorted(np.cumsum(counts[start:]), PAIRS_PER_BATCH, side="right")), 1)
        triangle = np.repeat(np.arange(start, end), counts[start:end])
        number = np.arange(len(triangle)) - np.repeat(
            np.cumsum(counts[start:end]) - counts[start:end], counts[start:end]
        )
        x, y = np.divmod(number, np.maximum(spans[triangle, 1], 1))
        x, y = x + first[triangle, 0], y + first[triangle, 1]
        yield _meet(flat[triangle], corners[triangle, :, 2], x, y, cells)
        start = end


def _meet(
    flat: np.ndarray, heights: np.ndarray, x: np.ndarray, y: np.ndarray, cells: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    point = np.stack([x, y], axis=1)
    edges = []
    for one, two in ((1, 2), (2, 0), (0, 1)):
        along, off = flat[:, two] - flat[:, one], point - flat[:, one]
        edges.append(along[:, 0] * off[:, 1] - along[:, 1] * off[:, 0])
    across = np.stack(edges, axis=1)
    area = across.sum(axis=1)
    hit = (area != 0.0) & (np.all(across >= 0.0, axis=1) | np.all(across <= 0.0, axis=1))
    height = (across[hit] * heights[hit]).sum(axis=1) / area[hit]
    # A triangle whose normal points down is entered from below.
    return x[hit] * cells[1] * COLUMNS + y[hit], height, -np.sign(area[hit])
