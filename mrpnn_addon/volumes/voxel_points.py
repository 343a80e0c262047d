# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids and positions that volume shaders read at voxels."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..vdb.worker import COMPONENTS


def components(name: str) -> list[str]:
    """Names of the components of a grid of vectors."""
    return [name + component for component in COMPONENTS]


class Probe:
    """One point where every grid is 0; records what a shader reads.

    names: grids that it read; of grids of vectors the components, each by a name of its own. missing: names of grids
    that it read and that do not exist, with the node that reads each, or None. placed: whether it read positions.
    """

    def __init__(self, available: Sequence[str], fills_its_bounds: bool, vectors: tuple[str, ...] = ()) -> None:
        """available: names of grids. vectors: names of those of them that hold vectors."""
        self.available, self.fills_its_bounds, self.vectors = available, fills_its_bounds, vectors
        self.names: list[str] = []
        self.missing: dict[str, Any] = {}
        self.placed = False

    def has(self, name: str) -> bool:
        """Whether a grid of this name exists."""
        return name in self.available

    def attribute(self, name: str, node: Any) -> np.ndarray:
        """(n, 1) values of a grid, (n, 3) of one of vectors; 0 for one that does not exist, as in Cycles."""
        if not self.has(name):
            self.missing.setdefault(name, node)
            return np.zeros((1, 1))
        parts = components(name) if name in self.vectors else [name]
        self.names += [part for part in parts if part not in self.names]
        return np.concatenate([self._read(part) for part in parts], axis=1)

    def absent(self, name: str) -> str:
        """A grid that does not exist and, to choose from, those that do, for a message."""
        if self.fills_its_bounds:
            return f'"{name}", which does not exist inside a mesh'
        known = ", ".join(f'"{grid}"' for grid in self.available if not grid.endswith(COMPONENTS))
        return f'"{name}", which is not among its grids of numbers ({known or "none"})'

    def coordinates(self, kind: str, node: Any) -> np.ndarray:
        """(n, 3) positions; `kind` is "world", "object" or "generated"."""
        self.placed = True
        return self._place(kind, node)

    def _read(self, name: str) -> np.ndarray:
        return np.zeros((1, 1))

    def _place(self, kind: str, node: Any) -> np.ndarray:
        return np.zeros((1, 3))


@dataclass
class VoxelDomain:
    """Voxels at which a shader is evaluated.

    grids: float32 arrays of one shape, by name. frames: (4, 4) matrices from voxel index to position, by kind of
    coordinates. inside: float32, share of each voxel inside a mesh; None for grids. emitting: float32, 1 in voxels that
    emit where all grids are 0; None where none do. index_of: maps positions (n,) in the flattened arrays to voxel
    indices, int (n, 3); None for dense arrays. vectors: names of grids of vectors, whose components are among the
    grids.
    """

    grids: dict[str, np.ndarray]
    frames: dict[str, np.ndarray]
    inside: np.ndarray | None = None
    emitting: np.ndarray | None = None
    index_of: Callable[[np.ndarray], np.ndarray] | None = None
    vectors: tuple[str, ...] = ()

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

    def __init__(self, domain: VoxelDomain, voxels: np.ndarray) -> None:
        available = (*domain.grids, *domain.vectors)
        super().__init__(available, fills_its_bounds=domain.inside is not None, vectors=domain.vectors)
        self.grids, self.domain, self.voxels = domain.grids, domain, voxels

    def _read(self, name: str) -> np.ndarray:
        return self.grids[name].reshape(-1)[self.voxels].astype(np.float64)[:, None]

    def _place(self, kind: str, node: Any) -> np.ndarray:
        frame = self.domain.frames[kind]
        return self.domain.index(self.voxels) @ frame[:3, :3].T + frame[:3, 3]
