"""Volume objects of the evaluated scene as `Volume` and `Medium`."""

import os
import tempfile
from typing import List, Tuple

import bpy
import numpy as np

from ..inference.scene import Medium, SceneError, Volume
from .density_grid import DensityGrid, grid_names, read_density_grid, unreadable
from .material import read_shading
from .visibility import Shown


def outside_sequence(volume_object) -> bool:
    """Whether the object's file sequence has no file for this frame, so that it is invisible."""
    data = volume_object.data
    return data.is_sequence and data.grids.load() and not len(data.grids)


def read_volume(shown: Shown) -> Tuple[Volume, Medium, List[str]]:
    """The density, placement and shading of one visible Volume object, and warnings.

    Raises SceneError, naming the object, where the file, the grid or the material cannot be used.
    """
    where = f"Volume object \"{shown.name}\""
    data = shown.object.data
    if not data.grids.load() or not len(data.grids):
        raise SceneError(f"{where}: {_load_problem(data)}")
    if _lives_in_a_file(shown.object):
        return _read(data.grids.frame_filepath, shown)
    # Modifiers and geometry nodes make volumes that no file holds.
    with tempfile.TemporaryDirectory(prefix="mrpnn-") as folder:
        path = os.path.join(folder, "evaluated.vdb")
        if not data.grids.save(path):
            raise SceneError(f"{where}: Blender cannot save what its modifiers make")
        return _read(path, shown)


def _lives_in_a_file(volume_object) -> bool:
    changed = any(modifier.show_render or modifier.show_viewport for modifier in volume_object.modifiers)
    return bool(volume_object.data.grids.frame_filepath) and not changed


def _load_problem(data) -> str:
    if not data.filepath:
        return "it loads no file; choose a .vdb file in its data properties"
    if data.grids.is_loaded:
        return "it holds no grid"
    return unreadable(bpy.path.abspath(data.filepath, library=data.library), data.grids.error_message)


def _read(path: str, shown: Shown) -> Tuple[Volume, Medium, List[str]]:
    shading = read_shading(shown.object, grid_names(path, shown.name), shown.name)
    grid: DensityGrid = read_density_grid(path, shading.density_grid, shown.name)
    volume = Volume(grid.density, shown.matrix @ grid.object_from_index, name=shown.name)
    scale = density_scale(shown.object.data.render.space, shown.matrix)
    medium = Medium(shading.sigma_t * scale, shading.albedo, shading.anisotropy)
    return volume, medium, grid.warnings


def density_scale(space: str, matrix: np.ndarray) -> float:
    """Extinction per world unit over extinction per material unit.

    In WORLD space densities are per world unit: 1. In OBJECT space Cycles keeps the opacity
    whatever the object's scale, by 1 / |M u| with M the object's matrix and u the unit vector
    along (1, 1, 1); measured with Cycles 4.5 and 5.0, uniform, non-uniform and rotated.
    """
    if space == 'WORLD':
        return 1.0
    return float(1.0 / np.linalg.norm(matrix[:3, :3] @ np.full(3, 3.0 ** -0.5)))
