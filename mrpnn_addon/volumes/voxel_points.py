# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids and positions that volume shaders read at voxels."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..nodes.sockets import Unsupported


class Probe:
    """One point where every grid is 0; records what a shader reads.

    names: grids that it read. placed: whether it read positions.
    """

    def __init__(self, available, fills_its_bounds: bool):
        self.available, self.fills_its_bounds = available, fills_its_bounds
        self.names, self.placed = [], False

    def has(self, name: str) -> bool:
        """Whether a grid of this name exists."""
        return name in self.available

    def attribute(self, name: str, node) -> np.ndarray:
        """(n, 1) values of a grid. Raises Unsupported where a mesh has none."""
        if self.fills_its_bounds and not self.has(name):
            raise Unsupported(
                f'node "{node.name}" reads the attribute "{name}", which does not exist inside a mesh; unlink it'
            )
        if name not in self.names:
            self.names.append(name)
        return self._read(name)

    def coordinates(self, kind: str, node) -> np.ndarray:
        """(n, 3) positions; `kind` is "world", "object" or "generated". Raises Unsupported for others."""
        self.placed = True
        return self._place(kind, node)

    def _read(self, name):
        return np.zeros((1, 1))

    def _place(self, kind, node):
        return np.zeros((1, 3))


@dataclass
class VoxelDomain:
    """Voxels at which a shader is evaluated.

    grids: float32 arrays of one shape, by name. frames: (4, 4) matrices from voxel index to position, by kind of
    coordinates. inside: float32, share of each voxel inside a mesh; None for grids. emitting: float32, 1 in voxels that
    emit where all grids are 0; None where none do. index_of: maps positions (n,) in the flattened arrays to voxel
    indices, int (n, 3); None for dense arrays.
    """

    grids: dict[str, np.ndarray]
    frames: dict[str, np.ndarray]
    inside: np.ndarray | None = None
    emitting: np.ndarray | None = None
    index_of: Callable[[np.ndarray], np.ndarray] | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """Of every array."""
        return (next(iter(self.grids.values())) if self.inside is None else self.inside).shape

    def index(self, voxels: np.ndarray) -> np.ndarray:
        """Voxel indices, int (n, 3), of positions (n,) in the flattened arrays."""
        if self.index_of is not None:
            return self.index_of(voxels)
        return np.stack(np.unravel_index(voxels, self.shape), axis=1)


class VoxelPoints(Probe):
    """Some voxels of a domain: int64 (n,) positions in its flattened arrays."""

    def __init__(self, domain: VoxelDomain, voxels: np.ndarray):
        super().__init__(domain.grids, fills_its_bounds=domain.inside is not None)
        self.grids, self.domain, self.voxels = domain.grids, domain, voxels

    def _read(self, name):
        return self.grids[name].reshape(-1)[self.voxels].astype(np.float64)[:, None]

    def _place(self, kind, node):
        if kind not in self.domain.frames:
            raise Unsupported(
                f'node "{node.name}" uses {kind} coordinates, which are not supported in a Volume '
                "object; link Object coordinates"
            )
        frame = self.domain.frames[kind]
        return self.domain.index(self.voxels) @ frame[:3, :3].T + frame[:3, 3]
