# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes found in a scene, to be read and shaded on any thread without calling bpy."""

import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

from ...inference.scene import SceneError
from ...inference.scene.sparse_grid import SparseGrid
from ..nodes.material import VolumeMaterial
from ..objects.mesh_triangles import Mesh
from ..vdb.common_blocks import CommonBlocks
from ..vdb.density_grid import MAX_SPAN, MAX_VOXELS, EmptyGrid, read_density_grid
from ..vdb.leaf_boxes import boxes, leaves_around
from .mesh_fill import fill
from .shaded_grid import (
    INTERPOLATES_EMISSION,
    ShadedGrid,
    is_linear,
    refine,
    refuse_nothing,
    require_empty_background,
    shade,
)
from .voxel_points import Probe, VoxelDomain

# Grids up to so many voxels are refined for shaders that are not linear in them.
MAX_REFINED = 1 << 24


@dataclass
class VolumeSource:
    """key: differs where the content may differ. where: prefix of messages. material: its shader. matrix: float64 (4,
    4), object to world.
    """

    key: tuple
    where: str
    material: VolumeMaterial
    matrix: np.ndarray

    message: ClassVar[str] = "reading volumes"

    def read(
        self,
        started: Callable[[subprocess.Popen], None] = lambda process: None,
        check: Callable[[], None] = lambda: None,
    ) -> tuple[ShadedGrid, np.ndarray, list[str]]:
        """Its shaded voxels; the matrix (4, 4) from voxel index to object space; and warnings.

        started: see `vdb.process.read_in_process`. check: called often; an exception that it raises stops the work.

        Raises SceneError, naming the object, where the file, the grid, the mesh or the material cannot be used.
        """
        try:
            return self._read(started, check)
        except MemoryError:
            raise SceneError(f"{self.where}: not enough memory to read it; resample its grids") from None

    def _read(
        self, started: Callable[[subprocess.Popen], None], check: Callable[[], None]
    ) -> tuple[ShadedGrid, np.ndarray, list[str]]:
        raise NotImplementedError


@dataclass
class MeshSource(VolumeSource):
    """mesh: in object space. generated: (4, 4), object to texture space."""

    mesh: Mesh
    generated: np.ndarray

    def _read(
        self, started: Callable[[subprocess.Popen], None], check: Callable[[], None]
    ) -> tuple[ShadedGrid, np.ndarray, list[str]]:
        inside = fill(self.mesh.triangles(), self.matrix, self.where, check)
        frames = {
            "object": inside.object_from_index,
            "world": self.matrix @ inside.object_from_index,
            "generated": self.generated @ inside.object_from_index,
        }
        return shade(self.material, VoxelDomain({}, frames, inside.share), check), inside.object_from_index, []


@dataclass
class FileSource(VolumeSource):
    """path: of the .vdb file. owner: the object's name. probe: has evaluated the shader where all grids are 0.
    is_sequence: whether the file is one of a numbered sequence.
    """

    path: str
    owner: str
    probe: Probe
    is_sequence: bool = False

    def _read(
        self, started: Callable[[subprocess.Popen], None], check: Callable[[], None]
    ) -> tuple[ShadedGrid, np.ndarray, list[str]]:
        material, probe, at_zero = self.material, self.probe, self.material.at(self.probe)
        if not probe.names:
            if not at_zero.closures and not at_zero.emission.any():
                refuse_nothing(material)
            material.refuse(
                "the material reads no grid, so no grid shapes the volume; enter a grid's name in Density "
                f"Attribute or link an Attribute node (grids in this file: {', '.join(probe.available)})"
            )
        if not probe.placed:
            require_empty_background(material, at_zero)
        read, offsets, shape, object_from_index, low, warnings = self._aligned(started)
        check()
        emits = bool(at_zero.emission.any())
        many = np.prod(shape.astype(float)) > MAX_VOXELS
        if not emits and (many or any(isinstance(grid, SparseGrid) for grid in read.values())):
            shaded = self._shade_blocks(read, offsets, shape, self._frames(object_from_index), check)
            return shaded, object_from_index, warnings
        if many:
            material.refuse(
                f"it emits light where its grids are 0, and the box around them has more than {MAX_VOXELS} voxels"
            )
        grids = {name: _placed(grid, offsets[name], shape) for name, grid in read.items()}
        grids.update({name: np.zeros(shape, np.float32) for name in probe.names if name not in read})
        filled = None
        # A shader that emits where the grids are 0 fills Cycles' boxes.
        if emits:
            grids, first = leaves_around(grids, low)
            object_from_index[:3, 3] += object_from_index[:3, :3] @ (first - low)
            filled = boxes(grids)
        # Cycles interpolates the grids before it evaluates the nodes; finer voxels approximate that.
        notes = []
        if next(iter(grids.values())).size < MAX_REFINED and (probe.placed or not is_linear(material, probe)):
            grids = {name: refine(values) for name, values in grids.items()}
            filled = None if filled is None else refine(filled)
            object_from_index[:3, 3] -= 0.5 * object_from_index[:3, :3].sum(axis=1)
            object_from_index[:3, :3] *= 0.5
            if at_zero.blackbody is not None and INTERPOLATES_EMISSION:
                notes = [
                    "with nodes that change its density, its blackbody is rendered as before Blender 5.0, which "
                    "is darker"
                ]
        domain = VoxelDomain(grids, self._frames(object_from_index), emitting=filled, vectors=probe.vectors)
        shaded = shade(material, domain, check)
        shaded.notes = shaded.notes + notes
        return shaded, object_from_index, warnings

    def _frames(self, object_from_index: np.ndarray) -> dict[str, np.ndarray]:
        # Generated coordinates of a Volume object are those of the object.
        return {
            "object": object_from_index,
            "generated": object_from_index,
            "world": self.matrix @ object_from_index,
        }

    def _shade_blocks(
        self,
        read: dict[str, np.ndarray | SparseGrid],
        offsets: dict[str, np.ndarray],
        shape: np.ndarray,
        frames: dict[str, np.ndarray],
        check: Callable[[], None],
    ) -> ShadedGrid:
        """As `shade`, for grids by name in a mostly empty box."""
        try:
            blocks = CommonBlocks(read, offsets, shape)
        except ValueError:
            self.material.refuse(f"grids {', '.join(read)} are offset by part of a leaf; save them with one transform")
        probe, names = self.probe, self.probe.names
        nothing = np.zeros_like(next(iter(blocks.arrays.values()))) if len(read) < len(names) else None
        grids = {name: blocks.arrays.get(name, nothing) for name in names}
        domain = VoxelDomain(grids, frames, index_of=blocks.index, vectors=probe.vectors)
        shaded = shade(self.material, domain, check)
        rows: Any = shaded
        density = blocks.grid(rows.density)
        shaded.density = density
        if shaded.extinction is not None:
            shaded.extinction = tuple(density.with_rows(channel) for channel in rows.extinction)
        if isinstance(shaded.albedo, tuple):
            shaded.albedo = tuple(density.with_rows(channel) for channel in rows.albedo)
        for name in ("emission", "blackbody"):
            emission = getattr(shaded, name)
            if emission is not None:
                channels = tuple(density.with_rows(emission[..., channel]) for channel in range(3))
                setattr(shaded, name, channels)
        return shaded

    def _aligned(self, started: Callable[[subprocess.Popen], None]) -> tuple:
        """Grids by name; the offset of each in their common box; the box's shape and its index to object space; the
        file's index of its first voxel; and warnings.

        Grids without a positive voxel are left out. Raises EmptyGrid where all are.
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
                self.material.refuse(
                    f'grids "{next(iter(read))}" and "{name}" have different voxels, which cannot be combined'
                )
            offsets[name] = offset.astype(int)
        warnings = [warning for grid in read.values() for warning in grid.warnings]
        low = np.min(list(offsets.values()), axis=0)
        high = np.max([offsets[name] + grid.density.shape for name, grid in read.items()], axis=0)
        if np.prod((high - low).astype(float)) > MAX_SPAN:
            self.material.refuse(f"its grids are so far apart that the box around them has more than {MAX_SPAN} voxels")
        object_from_index = first.copy()
        object_from_index[:3, 3] += first[:3, :3] @ low
        grids = {name: grid.density for name, grid in read.items()}
        offsets = {name: offset - low for name, offset in offsets.items()}
        return grids, offsets, high - low, object_from_index, reference.low + low, warnings


def _placed(values: np.ndarray | SparseGrid, offset: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """A grid as an array of its box's shape."""
    values = values.dense() if isinstance(values, SparseGrid) else values
    if tuple(shape) == values.shape:
        return values
    placed = np.zeros(shape, np.float32)
    placed[tuple(slice(o, o + n) for o, n in zip(offset, values.shape))] = values
    return placed
