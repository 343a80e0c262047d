# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light as .vdb files: sparse grids of half floats in the world's frame."""

import os
import secrets
from collections.abc import Sequence
from typing import Any

import numpy as np

from ...inference import LitVolume
from ...inference.baking.directional_factor import MAX_LOGARITHM, SMOOTH, DirectionalFactor, NodeGrid
from .density_grid import VOXEL_CENTRE
from .openvdb_module import load_openvdb
from .worker import utf8_link

#: Grids of a file: density, the light that it scatters, and the coefficients of other directions, three in each grid.
DENSITY, LIGHT, COLOURS = "light_density", "light", ("light_red", "light_green", "light_blue")
# Largest value of a half float, and of what is written.
MAX_HALF = 65504.0


def smooth_grids() -> list[str]:
    """Names of the grids with the smooth coefficients of a DirectionalFactor."""
    return [f"light_smooth{n}" for n in range(-(-SMOOTH // 3))]


def anchor_grids(factor: DirectionalFactor) -> list[str]:
    """Names of the grids with what a DirectionalFactor knows of its anchors."""
    return [f"light_anchors{n}" for n in range(-(-factor.anchors.values.shape[3] // 3))]


def brightness(lit: LitVolume) -> float:
    """A value by which a light is divided such that half floats hold it: its largest, or 1 where it is dark."""
    return float(lit.density.max()) * float(lit.scattered.max()) or 1.0


def write_light(path: str, lit: LitVolume, scale: float) -> None:
    """Write the light, divided by `scale`, and its other directions. The file is complete or absent.

    Raises OSError, naming the file, where it cannot be written, and SceneError without an OpenVDB module.
    """
    openvdb = load_openvdb()
    # Density up to 1; the light that it scatters, with it, up to about 1.
    most = float(lit.density.max()) or 1.0
    light = np.minimum(lit.scattered * np.float32(most / scale), np.float32(MAX_HALF))
    grids = [_grid(openvdb, DENSITY, lit.density / np.float32(most), lit.world_from_index)]
    grids.append(_grid(openvdb, LIGHT, light, lit.world_from_index))
    factor = lit.directional
    if factor is not None:
        # The logarithms of the light as it is written.
        shift = np.float32(np.log(most / scale))
        grids += _coefficients(openvdb, smooth_grids(), factor.smooth, shift)
        grids += _coefficients(openvdb, anchor_grids(factor), factor.anchors, shift)
        if factor.colours is not None:
            grids += _coefficients(openvdb, COLOURS, factor.colours, np.float32(0.0))
    unfinished = os.path.join(os.path.dirname(path), f".mrpnn-{secrets.token_hex(8)}.vdb")
    try:
        with utf8_link(os.path.dirname(unfinished)) as folder:
            openvdb.write(os.path.join(folder, os.path.basename(unfinished)), grids=grids)
        os.replace(unfinished, path)
    except Exception as error:
        raise OSError(f"cannot write {path}: {error}") from error
    finally:
        if os.path.exists(unfinished):
            os.unlink(unfinished)


def _coefficients(openvdb: Any, names: Sequence[str], nodes: NodeGrid, shift: np.float32) -> list:
    """Grids of three coefficients each, the last filled up with zeros; the first coefficient is shifted."""
    values = nodes.values.copy()
    values[..., 0] += shift
    # Any larger coefficient only meets the limit of the factor.
    values = np.clip(np.nan_to_num(values), -64.0 * MAX_LOGARITHM, 64.0 * MAX_LOGARITHM)
    # One more node beyond each face, so that interpolation does not meet the 0 outside.
    values = np.pad(values, [(1, 1)] * 3 + [(0, 0)], mode="edge")
    values = np.pad(values, [(0, 0)] * 3 + [(0, -values.shape[3] % 3)])
    parts = np.split(values, len(names), axis=3)
    return [_grid(openvdb, name, part, nodes.world_from_index, (-1, -1, -1)) for name, part in zip(names, parts)]


def _grid(
    openvdb: Any, name: str, values: np.ndarray, world_from_index: np.ndarray, low: Sequence[int] = (0, 0, 0)
) -> Any:
    """A grid of numbers (nx, ny, nz) or vectors (nx, ny, nz, 3); voxels that are 0 are not stored."""
    grid = openvdb.FloatGrid() if values.ndim == 3 else openvdb.Vec3SGrid()
    grid.copyFromArray(np.array(values, np.float32), ijk=low)
    grid.name = name
    grid.gridClass = "fog volume"
    grid.saveFloatAsHalf = True
    frame = world_from_index.copy()
    frame[:3, 3] -= VOXEL_CENTRE * frame[:3, :3].sum(axis=1)
    # OpenVDB's matrices act on rows.
    grid.transform = openvdb.createLinearTransform(frame.T.tolist())
    return grid
