# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light as .vdb files: sparse grids of half floats in the world's frame."""

import json
import os
import secrets
import subprocess
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...inference import LitVolume
from ...inference.baking.directional_factor import MAX_LOGARITHM, SMOOTH, DirectionalFactor, NodeGrid
from ...inference.scene import SceneError
from .density_grid import VOXEL_CENTRE
from .openvdb_module import FOLDERS, load_openvdb
from .process import INTERPRETER
from .worker import utf8_link
from .writer import LightGrid, write_grids

#: Grids of a file: density, the light that it scatters, and the coefficients of other directions, three in each grid.
DENSITY, LIGHT, COLOURS = "light_density", "light", ("light_red", "light_green", "light_blue")
# Largest value of a half float, and of what is written.
MAX_HALF = 65504.0
# Bytes of grids from which on another process writes them: no other Python thread, and so not Blender's interface,
# goes on while OpenVDB writes.
LARGE = 4 << 20
# OpenVDB refuses transforms whose determinant is smaller: voxels of about a hundredth of a millimetre.
LEAST_DETERMINANT = 3e-15
PROGRAM = Path(__file__).with_name("writer.py")


class TooSmall(Exception):
    """Voxels that OpenVDB refuses."""


def smooth_grids() -> list[str]:
    """Names of the grids with the smooth coefficients of a DirectionalFactor."""
    return [f"light_smooth{n}" for n in range(-(-SMOOTH // 3))]


def anchor_grids(factor: DirectionalFactor) -> list[str]:
    """Names of the grids with what a DirectionalFactor knows of its anchors."""
    return [f"light_anchors{n}" for n in range(-(-factor.anchors.values.shape[3] // 3))]


def brightness(lit: LitVolume) -> float:
    """A value by which a light is divided such that half floats hold it: its largest, or 1 where it is dark."""
    return float((lit.fine or lit).density.max()) * float(lit.scattered.max()) or 1.0


def write_light(path: str, lit: LitVolume, scale: float) -> None:
    """Write the light, divided by `scale`, and its other directions. The file is complete or absent.

    Raises TooSmall for voxels that OpenVDB refuses, OSError, naming the file, where it cannot be written, and
    SceneError without an OpenVDB module.
    """
    # Density up to 1; the light that it scatters, with it, up to about 1.
    shown = lit.fine or lit
    most = float(shown.density.max()) or 1.0
    light = np.minimum(lit.scattered * np.float32(most / scale), np.float32(MAX_HALF))
    grids = [_grid(DENSITY, shown.density / np.float32(most), shown.world_from_index)]
    grids.append(_grid(LIGHT, light, lit.world_from_index))
    factor = lit.directional
    if factor is not None:
        # The logarithms of the light as it is written.
        shift = np.float32(np.log(most / scale))
        grids += _coefficients(smooth_grids(), factor.smooth, shift)
        grids += _coefficients(anchor_grids(factor), factor.anchors, shift)
        if factor.colours is not None:
            grids += _coefficients(COLOURS, factor.colours, np.float32(0.0))
    if any(abs(np.linalg.det(np.array(grid.matrix)[:3, :3])) < LEAST_DETERMINANT for grid in grids):
        raise TooSmall()
    unfinished = os.path.join(os.path.dirname(path), f".mrpnn-{secrets.token_hex(8)}.vdb")
    try:
        large = sum(grid.values.nbytes for grid in grids) > LARGE
        with utf8_link(os.path.dirname(unfinished)) as folder:
            written = os.path.join(folder, os.path.basename(unfinished))
            if not (large and _written_in_process(written, grids)):
                write_grids(load_openvdb(), written, grids)
        os.replace(unfinished, path)
    except SceneError:
        raise
    except Exception as error:
        raise OSError(f"cannot write {path}: {error}") from error
    finally:
        if os.path.exists(unfinished):
            os.unlink(unfinished)


def _written_in_process(path: str, grids: Sequence[LightGrid]) -> bool:
    """Whether another process has written a file; False where none can, or where it fails."""
    if not INTERPRETER:
        return False
    try:
        process = subprocess.Popen(
            [INTERPRETER, "-I", str(PROGRAM), path, *FOLDERS],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            creationflags=getattr(subprocess, "CREATE_NO_WINDOW", 0),
        )
    except OSError:
        return False
    with process:
        try:
            assert process.stdin is not None
            header = [(grid.name, grid.values.shape, list(grid.low), grid.matrix) for grid in grids]
            process.stdin.write(json.dumps(header).encode() + b"\n")
            for grid in grids:
                process.stdin.write(grid.values.data.cast("B"))
            process.stdin.close()
        except OSError:  # It has ended.
            process.kill()
        return process.wait() == 0


def _coefficients(names: Sequence[str], nodes: NodeGrid, shift: np.float32) -> list[LightGrid]:
    """Grids of three coefficients each, the last filled up with zeros; the first coefficient is shifted."""
    values = nodes.values.copy()
    values[..., 0] += shift
    # Any larger coefficient only meets the limit of the factor.
    values = np.clip(np.nan_to_num(values), -64.0 * MAX_LOGARITHM, 64.0 * MAX_LOGARITHM)
    # One more node beyond each face, so that interpolation does not meet the 0 outside.
    values = np.pad(values, [(1, 1)] * 3 + [(0, 0)], mode="edge")
    values = np.pad(values, [(0, 0)] * 3 + [(0, -values.shape[3] % 3)])
    parts = np.split(values, len(names), axis=3)
    return [_grid(name, part, nodes.world_from_index, (-1, -1, -1)) for name, part in zip(names, parts)]


def _grid(name: str, values: np.ndarray, world_from_index: np.ndarray, low: Sequence[int] = (0, 0, 0)) -> LightGrid:
    """A grid of numbers (nx, ny, nz) or vectors (nx, ny, nz, 3) in the world's frame."""
    frame = world_from_index.copy()
    frame[:3, 3] -= VOXEL_CENTRE * frame[:3, :3].sum(axis=1)
    return LightGrid(name=name, values=np.ascontiguousarray(values, np.float32), low=low, matrix=frame.T.tolist())
