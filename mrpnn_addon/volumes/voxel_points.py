"""What volume shaders read at voxels: grids by name, and places."""

from typing import Dict

import numpy as np

from ..nodes.sockets import Unsupported


class Probe:
    """One point where every grid is 0, which notes what a shader asks for.

    names: grids that it read. placed: whether it asked for a place.
    """

    def __init__(self, available, fills_its_bounds: bool):
        self.available, self.fills_its_bounds = available, fills_its_bounds
        self.names, self.placed = [], False

    def has(self, name: str) -> bool:
        """Whether there is a grid of this name."""
        return name in self.available

    def attribute(self, name: str, node) -> np.ndarray:
        """(n, 1) values of a grid. Raises Unsupported where a mesh has none."""
        if self.fills_its_bounds and not self.has(name):
            raise Unsupported(f"node \"{node.name}\" reads the attribute \"{name}\", which does not exist "
                              "inside a mesh; unlink it")
        if name not in self.names:
            self.names.append(name)
        return self._read(name)

    def coordinates(self, kind: str, node) -> np.ndarray:
        """(n, 3) places, `kind` "world", "object" or "generated". Raises Unsupported where unknown."""
        self.placed = True
        return self._place(kind, node)

    def _read(self, name):
        return np.zeros((1, 1))

    def _place(self, kind, node):
        return np.zeros((1, 3))


class VoxelPoints(Probe):
    """Some voxels of aligned grids.

    grids: float32 arrays of one shape by name. voxels: int64 (n,), places in the flattened arrays. index: of such
    places (n,), gives int (n, 3). frames: (4, 4) matrices by kind of coordinates, voxel index to place.
    """

    def __init__(self, grids: Dict[str, np.ndarray], index, voxels: np.ndarray, frames, fills_its_bounds: bool):
        super().__init__(grids, fills_its_bounds)
        self.grids, self.index, self.voxels, self.frames = grids, index, voxels, frames

    def _read(self, name):
        return self.grids[name].reshape(-1)[self.voxels].astype(np.float64)[:, None]

    def _place(self, kind, node):
        if kind not in self.frames:
            raise Unsupported(f"node \"{node.name}\" uses {kind} coordinates, which are not supported in a Volume "
                              "object; link Object coordinates")
        frame = self.frames[kind]
        return self.index(self.voxels) @ frame[:3, :3].T + frame[:3, 3]
