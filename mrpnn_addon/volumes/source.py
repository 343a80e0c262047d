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
from ..vdb.density_grid import MAX_VOXELS, DensityGrid, EmptyGrid, InvalidGrid, read_density_grid
from ..vdb.leaf_boxes import boxes, leaves_around
from ..vdb.process import BY_LEAF
from .common_voxels import CommonVoxels, common_voxels
from .mesh_fill import fill
from .shaded_grid import (
    INTERPOLATES_EMISSION,
    ShadedGrid,
    is_linear,
    refine,
    require_a_grid,
    require_empty_background,
    shade,
    shading_at,
    shaping_grids,
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
        told = []
        if inside.inverted:
            told.append(
                f"{self.where}: its normals point inwards, so Cycles shows no fog in it; recalculate them in Edit Mode "
                "(Mesh > Normals > Recalculate Outside)"
            )
        return shade(self.material, VoxelDomain({}, frames, inside.share), check), inside.object_from_index, told


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
        material, probe = self.material, self.probe
        require_a_grid(material, probe)
        read, invalid = self._grids(started)
        outside = shading_at(
            material, probe, {name: read[name].background if name in read else 0.0 for name in probe.names}
        )
        emits = bool(outside.emission.any())

        def refines(voxels: int, is_negative: bool) -> bool:
            # Cycles' boxes are those of the file's own voxels.
            return not emits and is_refined(material, probe, voxels, is_negative)

        common = common_voxels(read, shaping_grids(material, probe, list(read)), self.where, check, refines)
        common.warnings += invalid
        check()
        if not probe.placed or any(common.backgrounds.values()):
            require_empty_background(material, outside, common.backgrounds)
        object_from_index, shape = common.object_from_index, common.shape
        many = np.prod(shape.astype(float)) > MAX_VOXELS
        if not emits and (many or any(isinstance(grid, SparseGrid) for grid in common.grids.values())):
            return self._shade_blocks(common, check), object_from_index, common.warnings
        if many:
            material.refuse(
                f"it emits light where its grids are 0, and the box around them has more than {MAX_VOXELS} voxels"
            )
        grids = {name: _placed(grid, name, common) for name, grid in common.grids.items()}
        grids.update({name: np.zeros(shape, np.float32) for name in probe.names if name not in grids})
        filled = None
        # A shader that emits where the grids are 0 fills Cycles' boxes.
        if emits:
            grids, first = leaves_around(grids, common.low, common.backgrounds)
            object_from_index[:3, 3] += object_from_index[:3, :3] @ (first - common.low)
            filled = boxes(grids, common.backgrounds)
        notes = []
        is_fine = common.is_refined
        if not is_fine and is_refined(material, probe, next(iter(grids.values())).size, common.is_negative):
            is_fine = True
            grids = {name: refine(values, common.backgrounds.get(name, 0.0)) for name, values in grids.items()}
            filled = None if filled is None else refine(filled)
            object_from_index[:3, 3] -= 0.5 * object_from_index[:3, :3].sum(axis=1)
            object_from_index[:3, :3] *= 0.5
        if is_fine and outside.blackbody is not None and INTERPOLATES_EMISSION:
            notes = [
                "with nodes that change its density, its blackbody is rendered as before Blender 5.0, which is darker"
            ]
        domain = VoxelDomain(grids, self._frames(object_from_index), emitting=filled, vectors=probe.vectors)
        shaded = shade(material, domain, check)
        shaded.notes = shaded.notes + notes
        return shaded, object_from_index, common.warnings

    def _frames(self, object_from_index: np.ndarray) -> dict[str, np.ndarray]:
        # Generated coordinates of a Volume object are those of the object.
        return {
            "object": object_from_index,
            "generated": object_from_index,
            "world": self.matrix @ object_from_index,
        }

    def _shade_blocks(self, common: CommonVoxels, check: Callable[[], None]) -> ShadedGrid:
        """As `shade`, for grids in a mostly empty box."""
        blocks = CommonBlocks(common.grids, common.offsets, common.shape, common.backgrounds)
        probe, names = self.probe, self.probe.names
        nothing = np.zeros_like(next(iter(blocks.arrays.values()))) if len(blocks.arrays) < len(names) else None
        grids = {name: blocks.arrays.get(name, nothing) for name in names}
        frames = self._frames(common.object_from_index)
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

    def _grids(self, started: Callable[[subprocess.Popen], None]) -> tuple[dict[str, DensityGrid], list[str]]:
        """The grids that the shader reads, by name, without those whose voxels are all 0; and warnings of those which
        are because their voxels are no numbers.

        Raises EmptyGrid where all are.
        """
        read, empty, invalid = {}, None, []
        for name in self.probe.names:
            try:
                read[name] = read_density_grid(self.path, name, self.owner, started)
            except EmptyGrid as problem:
                empty = problem
                invalid += [str(problem)] if isinstance(problem, InvalidGrid) else []
        if not read:
            raise empty
        return read, invalid


def is_refined(material: VolumeMaterial, probe: Probe, voxels: int, is_negative: bool) -> bool:
    """Whether finer voxels approximate that Cycles interpolates the grids before it evaluates the nodes.

    In a shader that is linear in the grids Cycles clamps negative densities between voxels before 5.0, at them since.
    """
    if voxels >= MAX_REFINED:
        return False
    return probe.placed or not is_linear(material, probe) or (is_negative and BY_LEAF)


def _placed(values: np.ndarray | SparseGrid, name: str, common: CommonVoxels) -> np.ndarray:
    """A grid as an array of its box's shape."""
    background, offset = common.backgrounds[name], common.offsets[name]
    if isinstance(values, SparseGrid):
        values = values.with_values(values.values - np.float32(background)).dense() + np.float32(background)
    if tuple(common.shape) == values.shape:
        return values
    placed = np.full(common.shape, background, np.float32)
    placed[tuple(slice(o, o + n) for o, n in zip(offset, values.shape))] = values
    return placed
