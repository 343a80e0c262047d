"""A volume as it was found in the scene, to be read and shaded on any thread: nothing here asks Blender."""

from dataclasses import dataclass
from typing import ClassVar, List, Tuple

import numpy as np

from ...inference.scene import SceneError
from ...inference.scene.sparse_grid import SparseGrid
from ..nodes.material import VolumeMaterial
from ..objects.mesh_triangles import Mesh
from ..vdb.common_blocks import CommonBlocks
from ..vdb.density_grid import MAX_SPAN, MAX_VOXELS, EmptyGrid, read_density_grid
from ..vdb.leaf_boxes import boxes, leaves_around
from .mesh_fill import fill
from .shaded_grid import VOXELS_ARE_HOT, ShadedGrid, is_linear, refine, refuse_nothing, require_empty_background, shade
from .voxel_points import Probe

# Voxels of a grid up to which it is made finer for shaders that are not linear in it.
MAX_REFINED = 1 << 24


@dataclass
class VolumeSource:
    """key: what differs for volumes that differ. where: for messages. material: its shader. matrix: float64 (4, 4), object
    to world.
    """

    key: tuple
    where: str
    material: VolumeMaterial
    matrix: np.ndarray

    message: ClassVar[str] = "reading volumes"

    def read(self, started=lambda process: None, check=lambda: None) -> Tuple[ShadedGrid, np.ndarray, List[str]]:
        """Its voxels, shaded; the matrix (4, 4) from their index to object space; and warnings.

        started: see `read_alone`. check: called often; what it raises ends the work.

        Raises SceneError, naming the object, where the file, the grid, the mesh or the material cannot be used.
        """
        try:
            return self._read(started, check)
        except MemoryError:
            raise SceneError(f"{self.where}: the machine has not enough memory to read it; resample its grids") from None


@dataclass
class MeshSource(VolumeSource):
    """mesh: in object space. generated: (4, 4), object to texture space."""

    mesh: Mesh
    generated: np.ndarray

    def _read(self, started, check):
        inside = fill(self.mesh.triangles(), self.matrix, self.where, check)
        frames = {"object": inside.object_from_index, "world": self.matrix @ inside.object_from_index,
                  "generated": self.generated @ inside.object_from_index}
        return shade(self.material, {}, frames, inside.share, check=check), inside.object_from_index, []


@dataclass
class FileSource(VolumeSource):
    """path: of the .vdb file. owner: the object's name. probe: that has met the shader where all grids are 0."""

    path: str
    owner: str
    probe: Probe

    def _read(self, started, check):
        material, probe, at_zero = self.material, self.probe, self.material.at(self.probe)
        if not probe.names:
            if not at_zero.closures and not at_zero.emission.any():
                refuse_nothing(material)
            material.refuse("the material reads no grid, so no grid shapes the volume; enter a grid's name in Density "
                            f"Attribute or link an Attribute node (grids in this file: {', '.join(probe.available)})")
        if not probe.placed:
            require_empty_background(material, at_zero)
        read, offsets, shape, object_from_index, low, warnings = self._aligned(started)
        check()
        shines = bool(at_zero.emission.any())
        many = np.prod(shape.astype(float)) > MAX_VOXELS
        if not shines and (many or any(isinstance(grid, SparseGrid) for grid in read.values())):
            shaded = self._shade_blocks(read, offsets, shape, self._frames(object_from_index), check)
            return shaded, object_from_index, warnings
        if many:
            material.refuse(f"it shines where its grids are 0, and the box around them has more than {MAX_VOXELS} voxels")
        grids = {name: _placed(grid, offsets[name], shape) for name, grid in read.items()}
        grids.update({name: np.zeros(shape, np.float32) for name in probe.names if name not in read})
        filled = None
        # What shines where the grids are 0 fills Cycles' boxes.
        if shines:
            grids, first = leaves_around(grids, low)
            object_from_index[:3, 3] += object_from_index[:3, :3] @ (first - low)
            filled = boxes(grids)
        # Cycles interpolates the grids and then evaluates the nodes; finer voxels come close to that.
        notes = []
        if next(iter(grids.values())).size < MAX_REFINED and (probe.placed or not is_linear(material, probe.names)):
            grids = {name: refine(values) for name, values in grids.items()}
            filled = None if filled is None else refine(filled)
            object_from_index[:3, 3] -= 0.5 * object_from_index[:3, :3].sum(axis=1)
            object_from_index[:3, :3] *= 0.5
            if at_zero.hot and VOXELS_ARE_HOT:
                notes = ["beside nodes that bend the density its blackbody is rendered as before Blender 5.0, which is "
                         "darker"]
        shaded = shade(material, grids, self._frames(object_from_index), boxes=filled, check=check)
        shaded.notes = shaded.notes + notes
        return shaded, object_from_index, warnings

    def _frames(self, object_from_index):
        return {"object": object_from_index, "world": self.matrix @ object_from_index}

    def _shade_blocks(self, read, offsets, shape, frames, check) -> ShadedGrid:
        """As `shade`, of grids by name in a box that is empty for the most part."""
        try:
            blocks = CommonBlocks(read, offsets, shape)
        except ValueError:
            self.material.refuse(f"grids {', '.join(read)} are shifted against each other by a part of a leaf; save them "
                                 "with one transform")
        names = self.probe.names
        nothing = np.zeros_like(next(iter(blocks.arrays.values()))) if len(read) < len(names) else None
        grids = {name: blocks.arrays.get(name, nothing) for name in names}
        shaded = shade(self.material, grids, frames, index=blocks.index, check=check)
        shaded.density = blocks.grid(shaded.density)
        if shaded.emission is not None:
            shaded.emission = tuple(shaded.density.with_rows(shaded.emission[..., channel]) for channel in range(3))
        return shaded

    def _aligned(self, started):
        """Grids by name, where each lies in the box that holds them all, the box's shape and its index to object space,
        and the file's index of its first voxel.

        A grid without a voxel above 0 is left out. Raises EmptyGrid where all are.
        """
        read, empty = {}, None
        for name in self.probe.names:
            try:
                read[name] = read_density_grid(self.path, name, self.owner, started)
            except EmptyGrid as problem:
                empty = problem
        if not read:
            raise empty
        reference = next(iter(read.values()))
        first = reference.object_from_index
        offsets = {}
        for name, grid in read.items():
            relative = np.linalg.inv(first) @ grid.object_from_index
            offset = np.round(relative[:3, 3])
            if np.abs(relative[:3, :3] - np.eye(3)).max() > 1e-4 or np.abs(relative[:3, 3] - offset).max() > 1e-2:
                self.material.refuse(f"grids \"{next(iter(read))}\" and \"{name}\" have different voxels, which cannot be "
                                     "combined")
            offsets[name] = offset.astype(int)
        warnings = [warning for grid in read.values() for warning in grid.warnings]
        low = np.min(list(offsets.values()), axis=0)
        high = np.max([offsets[name] + grid.density.shape for name, grid in read.items()], axis=0)
        if np.prod((high - low).astype(float)) > MAX_SPAN:
            self.material.refuse(f"its grids lie so far apart that the box around them has more than {MAX_SPAN} voxels")
        object_from_index = first.copy()
        object_from_index[:3, 3] += first[:3, :3] @ low
        grids = {name: grid.density for name, grid in read.items()}
        offsets = {name: offset - low for name, offset in offsets.items()}
        return grids, offsets, high - low, object_from_index, reference.low + low, warnings


def _placed(values, offset, shape):
    """An array of a box's shape that holds a grid."""
    values = values.dense() if isinstance(values, SparseGrid) else values
    if tuple(shape) == values.shape:
        return values
    placed = np.zeros(shape, np.float32)
    placed[tuple(slice(o, o + n) for o, n in zip(offset, values.shape))] = values
    return placed
