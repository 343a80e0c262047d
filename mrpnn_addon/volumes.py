"""Volume objects, and meshes with a volume material, as `Volume` and `Medium`."""

import os
import tempfile
from dataclasses import dataclass, field
from typing import Dict, List, Optional, Tuple

import bpy
import numpy as np

from ..inference.scene import Medium, SceneError, Volume
from ..inference.sparse_grid import SparseGrid
from .common_blocks import CommonBlocks
from .density_grid import MAX_SPAN, MAX_VOXELS, EmptyGrid, needs_reading, read_density_grid, unreadable
from .grid_loading import Wanted
from .leaf_boxes import boxes, leaves_around
from .material import VolumeMaterial, first_material
from .mesh_volume import fill
from .shaded_grid import VOXELS_ARE_HOT, ShadedGrid, is_linear, refine, require_empty_background, shade
from .visibility import Shown, shown_objects, why_unseen
from .voxel_points import Probe

# Voxels of a grid up to which it is made finer for shaders that are not linear in it.
MAX_REFINED = 1 << 24


@dataclass
class VolumeReader:
    """Reads volumes; what instances share is read once. meshes: triangles of surfaces, for `read_surface`."""

    known: Dict[tuple, Tuple[ShadedGrid, np.ndarray, List[str]]] = field(default_factory=dict)
    meshes: Dict[tuple, np.ndarray] = field(default_factory=dict)

    def read(self, shown: Shown) -> Tuple[Volume, Medium, List[str]]:
        """The density, placement and shading of one visible volume, and warnings.

        Raises SceneError, naming the object, where the file, the grid, the mesh or the material cannot
        be used.
        """
        if shown.object.type == 'VOLUME':
            where, scale = f"Volume object \"{shown.name}\"", density_scale(shown.object.data.render.space, shown.matrix)
        else:
            where, scale = f"object \"{shown.name}\"", 1.0
        key = _key(shown)
        if key in self.known:
            shaded, object_from_index, warnings = self.known[key]
        else:
            read = _read_volume_object if shown.object.type == 'VOLUME' else _read_mesh
            try:
                shaded, object_from_index, warnings = read(shown, where)
            except MemoryError:
                raise SceneError(f"{where}: the machine has not enough memory to read it; resample its grids") from None
            if not shaded.placed:
                self.known[key] = shaded, object_from_index, []
        volume = Volume(shaded.density, shown.matrix @ object_from_index, shown.name, shaded.emission, shaded.emission_power)
        medium = Medium(shaded.sigma_t * scale, shaded.albedo, shaded.anisotropy, scale, shaded.phase)
        return volume, medium, warnings + [f"{where}: {note}" for note in shaded.notes]

    def wanted(self, depsgraph) -> List[Wanted]:
        """Grids of files that this would have to read for the scene and that are not in use: for a `GridLoading`.

        Nothing where something keeps the scene from being read; reading it says what.
        """
        found = {}
        try:
            for shown in shown_objects(depsgraph):
                if shown.object.type == 'VOLUME' and _key(shown) not in self.known:
                    path = None if why_unseen(shown, depsgraph.view_layer) else _own_file(shown.object)
                    for name in _material_and_grids(shown)[1].names if path else ():
                        found[path, name] = Wanted(path, name, shown.name)
        except SceneError:
            return []
        return [one for one in found.values() if needs_reading(one.path, one.grid)]


def _key(shown: Shown) -> tuple:
    """The data of an evaluated object is its own, or that of all its instances."""
    return shown.object.data.name_full, shown.object.as_pointer()


def outside_sequence(volume_object) -> bool:
    """Whether the object's file sequence has no file for this frame, so that it is invisible."""
    data = volume_object.data
    return data.is_sequence and data.grids.load() and not len(data.grids)


def _read_volume_object(shown: Shown, where: str):
    data = shown.object.data
    if not data.grids.load() or not len(data.grids):
        raise SceneError(f"{where}: {_load_problem(data)}")
    path = _own_file(shown.object)
    if path:
        return _read_file(path, shown)
    # Modifiers and geometry nodes make volumes that no file holds.
    with tempfile.TemporaryDirectory(prefix="mrpnn-") as folder:
        path = os.path.join(folder, "evaluated.vdb")
        if not data.grids.save(path):
            raise SceneError(f"{where}: Blender cannot save what its modifiers make")
        return _read_file(path, shown)


def _own_file(volume_object) -> Optional[str]:
    """The file that holds what an object shows, None where there is none or modifiers change it."""
    changed = any(modifier.show_render or modifier.show_viewport for modifier in volume_object.modifiers)
    grids = volume_object.data.grids
    return None if changed or not grids.load() or not len(grids) else grids.frame_filepath or None


def _load_problem(data) -> str:
    if not data.filepath:
        return "it loads no file; choose a .vdb file in its data properties"
    if data.grids.is_loaded:
        return "it holds no grid"
    if data.is_sequence:
        return f"this frame's file of its sequence cannot be read ({data.grids.error_message})"
    return unreadable(bpy.path.abspath(data.filepath, library=data.library), data.grids.error_message)


def _material_and_grids(shown: Shown):
    """The material, the Probe that knows which of its grids it reads, and the Shading where they are 0."""
    material = VolumeMaterial(first_material(shown.object), f"Volume object \"{shown.name}\"")
    # As Blender has read them: files' own descriptions are read by another process alone.
    probe = Probe([grid.name for grid in shown.object.data.grids], fills_its_bounds=False)
    return material, probe, material.at(probe)


def _read_file(path: str, shown: Shown):
    material, probe, at_zero = _material_and_grids(shown)
    if not probe.names:
        material.refuse("the material reads no grid, so no grid shapes the volume; enter a grid's name in Density "
                        f"Attribute or link an Attribute node (grids in this file: {', '.join(probe.available)})")
    if not probe.placed:
        require_empty_background(material, at_zero)
    read, offsets, shape, object_from_index, low, warnings = _aligned(path, probe.names, shown, material)
    shines = bool(at_zero.emission.any())
    if not shines and (np.prod(shape.astype(float)) > MAX_VOXELS or any(isinstance(g, SparseGrid) for g in read.values())):
        frames = {"object": object_from_index, "world": shown.matrix @ object_from_index}
        return _shade_blocks(material, read, probe.names, offsets, shape, frames), object_from_index, warnings
    if np.prod(shape.astype(float)) > MAX_VOXELS:
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
            notes = ["beside nodes that bend the density its blackbody is rendered as before Blender 5.0, which is darker"]
    frames = {"object": object_from_index, "world": shown.matrix @ object_from_index}
    shaded = shade(material, grids, frames, boxes=filled)
    shaded.notes = shaded.notes + notes
    return shaded, object_from_index, warnings


def _shade_blocks(material, read, names, offsets, shape, frames) -> ShadedGrid:
    """As `shade`, of grids by name in a box that is empty for the most part."""
    try:
        blocks = CommonBlocks(read, offsets, shape)
    except ValueError:
        material.refuse(f"grids {', '.join(read)} are shifted against each other by a part of a leaf; save them with one "
                        "transform")
    nothing = np.zeros_like(next(iter(blocks.arrays.values()))) if len(read) < len(names) else None
    grids = {name: blocks.arrays.get(name, nothing) for name in names}
    shaded = shade(material, grids, frames, index=blocks.index)
    shaded.density = blocks.grid(shaded.density)
    if shaded.emission is not None:
        shaded.emission = tuple(shaded.density.with_rows(shaded.emission[..., channel]) for channel in range(3))
    return shaded


def _aligned(path, names, shown, material):
    """Grids by name, where each lies in the box that holds them all, the box's shape and its index to object space, and
    the file's index of its first voxel.

    A grid without a voxel above 0 is left out. Raises EmptyGrid where all are.
    """
    read, empty = {}, None
    for name in names:
        try:
            read[name] = read_density_grid(path, name, shown.name)
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
            material.refuse(f"grids \"{next(iter(read))}\" and \"{name}\" have different voxels, which cannot be combined")
        offsets[name] = offset.astype(int)
    warnings = [warning for grid in read.values() for warning in grid.warnings]
    low = np.min(list(offsets.values()), axis=0)
    high = np.max([offsets[name] + grid.density.shape for name, grid in read.items()], axis=0)
    if np.prod((high - low).astype(float)) > MAX_SPAN:
        material.refuse(f"its grids lie so far apart that the box around them has more than {MAX_SPAN} voxels")
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


def _read_mesh(shown: Shown, where: str):
    if len({slot.material.name for slot in shown.object.material_slots}) > 1:
        raise SceneError(f"{where}: it has several volume materials; use one")
    material = VolumeMaterial(first_material(shown.object), where)
    material.at(Probe((), fills_its_bounds=True))
    inside = fill(shown.object, shown.matrix, where)
    frames = {"object": inside.object_from_index, "world": shown.matrix @ inside.object_from_index,
              "generated": _generated(shown.object) @ inside.object_from_index}
    return shade(material, {}, frames, inside.share), inside.object_from_index, []


def _generated(mesh_object) -> np.ndarray:
    """(4, 4): object space to the mesh's texture space, 0 to 1 over its bounds before modifiers."""
    mesh = mesh_object.original.data
    location, size = np.array(mesh.texspace_location), np.array(mesh.texspace_size)
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(0.5 / size)
    matrix[:3, 3] = 0.5 - 0.5 * location / size
    return matrix


def density_scale(space: str, matrix: np.ndarray) -> float:
    """Extinction per world unit over extinction per material unit.

    In WORLD space densities are per world unit: 1. In OBJECT space Cycles keeps the opacity
    whatever the object's scale, by 1 / |M u| with M the object's matrix and u the unit vector
    along (1, 1, 1); measured with Cycles 4.5 and 5.0, uniform, non-uniform and rotated.
    """
    if space == 'WORLD':
        return 1.0
    return float(1.0 / np.linalg.norm(matrix[:3, :3] @ np.full(3, 3.0 ** -0.5)))
