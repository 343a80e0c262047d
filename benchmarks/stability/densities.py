# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical thickness, and densities that change abruptly."""

import numpy as np

from inference import Volume
from inference.scene.sparse_grid import SparseGrid

from .renders import RenderSpec, render_case
from .scenes import blob, camera, placed


def one_dense_voxel():
    """A voxel a million times denser than those around it."""
    density = blob() * np.float32(1e-6)
    density[8, 7, 9] = 1.0
    return density


def sheets(axis: int):
    """Every fourth slice filled: sheets one voxel thin."""
    density = np.zeros((16, 16, 16), np.float32)
    np.moveaxis(density, axis, 0)[::4] = 1.0
    return density


def far_corners(cells: int):
    """Blobs at two opposite corners of a grid of cells³ voxels that stores nothing else; the first is `blob()`."""
    count, part = np.full(3, cells // 8), blob()
    corners = np.indices((2, 2, 2)).reshape(3, -1)
    blocks = part.reshape(2, 8, 2, 8, 2, 8).transpose(0, 2, 4, 1, 3, 5).reshape(8, 8, 8, 8)
    numbers = np.concatenate([np.ravel_multi_index(corners + last, count) for last in (0, cells // 8 - 2)])
    values = np.concatenate([np.zeros((1, 8, 8, 8), np.float32), blocks, blocks])
    grid = SparseGrid.of_blocks((cells,) * 3, (0, 0, 0), count, numbers, values)
    return Volume(grid, placed(part).world_from_index, "two corners")


CHECKERS = (np.indices((12, 12, 12)).sum(axis=0) % 2).astype(np.float32)
QUICK = (1e-6, 1.0, 1e2, 1e7)

CASES = [
    *(
        render_case("optical density", f"σ̂ = {s:g}", RenderSpec(blob(), s), quick=s in QUICK)
        for s in 10.0 ** np.arange(-6, 8)
    ),
    *(
        render_case(
            "sudden density",
            f"one voxel a million times denser, σ̂ = {s:g}",
            RenderSpec(one_dense_voxel(), s),
            quick=s == 1e7,
        )
        for s in (1e3, 1e5, 1e7)
    ),
    *(
        render_case(
            "sudden density",
            f"sheets one voxel thin across {'xyz'[axis]}, σ̂ = {s:g}",
            RenderSpec(sheets(axis), s),
            alpha=6e-3,
            single=0.1,
            bias=0.04,
            quick=s == 1e3 and axis == 0,
        )
        for axis in range(3)
        for s in (10.0, 1e3, 1e5)
    ),
    render_case("sudden density", "checkerboard of 0 and 1e5", RenderSpec(CHECKERS * np.float32(1e5), 1.0), quick=True),
    render_case("sudden density", "checkerboard of 0 and 1e5, thin", RenderSpec(CHECKERS * np.float32(1e5), 1e-4)),
    render_case(
        "sudden density", "densities of 1e-40 (denormal), σ̂ = 1e-40", RenderSpec(blob() * np.float32(1e-40), 1.0)
    ),
    render_case(
        "sudden density",
        "densities of 1e-40 (denormal), σ̂ = 100",
        RenderSpec(blob() * np.float32(1e-40), 1e42),
        quick=True,
    ),
    render_case(
        "sudden density", "densities of 3e38, σ̂ = 30", RenderSpec(blob() * np.float32(3e38), 1e-37), quick=True
    ),
    # Light penetrates less deep than double precision resolves.
    render_case(
        "sudden density",
        "densities of 3e38, σ̂ = 3e38",
        RenderSpec(blob() * np.float32(3e38), 1.0),
        single=None,
        bias=None,
    ),
    render_case(
        "grid", "2048³ voxels, two corners of 16³ filled", RenderSpec(far_corners(2048), visible=placed(blob()))
    ),
    render_case("grid", "one voxel", RenderSpec(np.ones((1, 1, 1)), 5.0), alpha=5e-3, quick=True),
    *(
        render_case(
            "grid",
            f"{' × '.join(map(str, shape))} voxels",
            RenderSpec(np.ones(shape), s, camera(3.0 * np.array((0.6, 0.5, 0.4)), fov=fov)),
            alpha=2e-2,
            quick=shape == (1, 1, 64),
        )
        for shape, s, fov in (
            ((1, 1, 64), 50.0, 0.02),
            ((64, 1, 1), 50.0, 0.02),
            ((1, 1, 2048), 2e3, 6e-4),
            ((64, 64, 1), 500.0, 0.4),
        )
    ),
]
