# SPDX-License-Identifier: GPL-3.0-or-later
"""Velocities of volumes: grids of OpenVDB files and of fluid domains, by which motion blur carries what they hold."""

import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ...inference.scene import SceneError
from ...inference.scene.sparse_grid import SparseGrid
from ..vdb.common_blocks import CommonBlocks
from ..vdb.density_grid import DensityGrid, EmptyGrid, read_density_grid
from ..vdb.worker import COMPONENTS
from .common_voxels import CommonVoxels, common_voxels
from .source import placed

# A grid of this name is one wherever no other is chosen.
STANDARD = "velocity"

#: Components of a velocity, on voxels of their own, and the matrix (4, 4) from their index to object space.
Components = tuple[tuple[np.ndarray | SparseGrid, ...], np.ndarray]


@dataclass
class FileVelocity:
    """Velocities in an OpenVDB file.

    key: differs where the content may differ. where: prefix of messages. path: of the file. owner: the object's name.
    names: of the grids of the three components, as of `read_density_grid`. is_sequence: as of FileSource.
    """

    key: tuple
    where: str
    path: str
    owner: str
    names: Sequence[str]
    is_sequence: bool = False

    message: ClassVar[str] = "reading volumes"

    def read(
        self,
        started: Callable[[subprocess.Popen], None] = lambda process: None,
        check: Callable[[], None] = lambda: None,
    ) -> Components | None:
        """The components; None where all are 0. Arguments as of `VolumeSource.read`.

        Raises SceneError, naming the object, for a file that cannot be read and for grids that are too large.
        """
        read: dict[str, DensityGrid] = {}
        for name in self.names:
            try:
                read[name] = read_density_grid(self.path, name, self.owner, started)
            except EmptyGrid:
                continue
        if not read:
            return None
        try:
            common = common_voxels(read, list(read), self.where, check)
            return self._components(common), common.object_from_index
        except MemoryError:
            raise SceneError(f"{self.where}: not enough memory to read its velocity; resample its grids") from None

    def _components(self, common: CommonVoxels) -> tuple[np.ndarray | SparseGrid, ...]:
        if any(isinstance(grid, SparseGrid) for grid in common.grids.values()):
            blocks = CommonBlocks(common.grids, common.offsets, common.shape, common.backgrounds)
            rows = {name: blocks.grid(values) for name, values in blocks.arrays.items()}
            first = next(iter(rows.values()))
            return tuple(rows.get(name) or first.with_values(0.0 * first.values) for name in self.names)
        nothing = np.zeros(common.shape, np.float32)
        return tuple(placed(common.grids[n], n, common) if n in common.grids else nothing for n in self.names)


@dataclass
class FluidVelocity:
    """Velocities of a fluid domain in one frame.

    key: differs where the content may differ. components: three arrays (nx, ny, nz). object_from_texture: (4, 4), from
    the texture space that the domain fills.
    """

    key: tuple
    components: tuple[np.ndarray, ...]
    object_from_texture: np.ndarray

    message: ClassVar[str] = "reading volumes"

    def read(self, *_: Any) -> Components | None:
        """As of FileVelocity."""
        if not any(values.any() for values in self.components):
            return None
        shape = np.array(self.components[0].shape)
        texture_from_index = np.diag([*(1.0 / shape), 1.0])
        texture_from_index[:3, 3] = 0.5 / shape
        return self.components, self.object_from_texture @ texture_from_index


VelocitySource = FileVelocity | FluidVelocity


def velocity_names(data: Any, grids: Sequence[Any]) -> tuple[str, ...]:
    """Names of the grids of a Volume's velocity, as of FileVelocity; () where it has none.

    grids: names of its grids, and of those of them that hold vectors.
    """
    names, vectors = grids
    for name in (data.velocity_grid, STANDARD):
        if name in vectors:
            return tuple(name + component for component in COMPONENTS)
    parts = data.velocity_x_grid, data.velocity_y_grid, data.velocity_z_grid
    return parts if all(name in names for name in parts) else ()
