"""Volume objects, and meshes with a volume material, as `Volume` and `Medium`."""

import shutil
import tempfile
import weakref
from dataclasses import dataclass, field
from pathlib import Path
from typing import Dict, List, Optional, Tuple, Union

import bpy
import numpy as np

from ...inference.scene import Medium, SceneError, Volume
from ..nodes.material import EmptyMaterial, VolumeMaterial, first_material, is_animated, shows_volume
from ..objects.mesh_triangles import Mesh, read_mesh, require_finite
from ..objects.placement import scaled_to_nothing, why_unplaced
from ..objects.visibility import Shown, shown_objects, why_unseen
from ..vdb.density_grid import EmptyGrid, unreadable
from ..world.lighting import wanted_world
from .fluid_domain import FluidSource, checksum, gas_domain, holds_nothing, probe_grids, read_grids
from .shaded_grid import ShadedGrid
from .source import FileSource, MeshSource, VolumeSource
from .voxel_points import Probe


class EmptyVolume(Exception):
    """A volume holds nothing now but may in other frames. Its words are ended by the frame's number."""


@dataclass
class VolumeReader:
    """Reads volumes; what instances share is read once.

    known: what sources hold, or why they cannot be read, by their key. meshes: of surfaces, for `read_surface`.
    """

    known: Dict[tuple, Union[SceneError, Tuple[ShadedGrid, np.ndarray, List[str]]]] = field(default_factory=dict)
    meshes: Dict[tuple, Mesh] = field(default_factory=dict)

    def read(self, shown: Shown) -> Tuple[Volume, Medium, List[str]]:
        """The density, placement and shading of one visible volume, and warnings.

        Raises SceneError, naming the object, where its transform, the file, the grid, the mesh or the material cannot
        be used; EmptyVolume where it holds nothing in this frame.
        """
        where, problem, empty = _where(shown), why_unplaced(shown.matrix), why_empty(shown)
        if problem:
            raise SceneError(f"{where}: {problem}")
        if empty:
            raise EmptyVolume(empty)
        if self._known_key(shown) is None:
            for source in self._source(shown):
                self.learn(source)
        key = self._known_key(shown)
        known = self.known[key]
        if isinstance(known, (EmptyGrid, EmptyMaterial)) and _may_fill(shown.object):
            raise EmptyVolume("holds nothing in")
        if isinstance(known, SceneError):
            raise type(known)(*known.args)
        shaded, object_from_index, warnings = known
        # Once, for all instances.
        self.known[key] = shaded, object_from_index, []
        scale = 1.0
        if shown.object.type == 'VOLUME':
            scale = density_scale(shown.object.data.render.space, shown.matrix)
        volume = Volume(shaded.density, shown.matrix @ object_from_index, shown.name, shaded.emission, shaded.emission_power)
        medium = Medium(shaded.sigma_t * scale, shaded.albedo, shaded.anisotropy, scale, shaded.phase)
        return volume, medium, warnings + [f"{where}: {note}" for note in shaded.notes]

    def wanted(self, depsgraph, space=None) -> List[VolumeSource]:
        """What this would have to read for the scene, and the World where Cycles has to show it: for a `VolumeLoading`.

        space: as of `shown_objects`.
        """
        found = {}
        for shown in shown_objects(depsgraph, space):
            if self._is_wanted(shown, depsgraph.view_layer):
                found.update((source.key, source) for source in self._source(shown))
        return [*found.values(), *wanted_world(depsgraph)]

    def learn(self, source: VolumeSource, *arguments) -> None:
        """Read a source, or find out why it cannot be. arguments: of `VolumeSource.read`. Any thread may."""
        try:
            self.known[source.key] = source.read(*arguments)
        except SceneError as problem:
            # Without its traceback, which holds what it was raised in.
            self.known[source.key] = type(problem)(*problem.args)

    def _is_wanted(self, shown: Shown, view_layer) -> bool:
        return shows_volume(shown.object) and not (
            why_unseen(shown, view_layer) or why_unplaced(shown.matrix) or why_empty(shown)) and (
            self._known_key(shown) is None)

    def _source(self, shown: Shown) -> List[VolumeSource]:
        """What a volume is to be read from; nothing where it cannot be, which is known from then on."""
        try:
            return [_volume_source(shown)]
        except SceneError as problem:
            self.known[_key(shown, False)] = type(problem)(*problem.args)
            return []

    def _known_key(self, shown: Shown) -> Optional[tuple]:
        return next((key for key in (_key(shown, False), _key(shown, True)) if key in self.known), None)


def _key(shown: Shown, placed: bool) -> tuple:
    """Instances share their data and materials; where a shader asks for places, they differ.

    The data of an evaluated object is its own, or that of all its instances; a fluid domain's changes from frame to frame.
    """
    data, slots, domain = shown.object.data, shown.object.material_slots, gas_domain(shown.object)
    materials = tuple(slot.material.as_pointer() if slot.material else 0 for slot in slots)
    content = checksum(domain) if domain else None
    return data.name_full, data.as_pointer(), materials, shown.matrix.tobytes() if placed else None, content


def _where(shown: Shown) -> str:
    return f"Volume object \"{shown.name}\"" if shown.object.type == 'VOLUME' else f"object \"{shown.name}\""


def _volume_source(shown: Shown) -> VolumeSource:
    """What a visible volume is to be read from. Raises SceneError, naming the object."""
    if shown.object.type == 'VOLUME':
        return _file_source(shown, _where(shown))
    return (_fluid_source if gas_domain(shown.object) else _mesh_source)(shown, _where(shown))


def why_empty(shown: Shown) -> str:
    """Why an object that shows a volume shows none in this frame, so that it is invisible; "" where it does."""
    data, domain = shown.object.data, gas_domain(shown.object)
    if not why_unplaced(shown.matrix) and scaled_to_nothing(shown.matrix):
        return "has scale 0 in"
    if shown.object.type == 'VOLUME' and data.is_sequence and data.grids.load() and not len(data.grids):
        return "has no file for"
    return "holds no smoke in" if domain and holds_nothing(domain) else ""


def _may_fill(volume_object) -> bool:
    """Whether what an object shows changes in time: its file, what modifiers make of it, or its material."""
    sequence = volume_object.type == 'VOLUME' and volume_object.data.is_sequence
    return sequence or bool(len(volume_object.modifiers)) or is_animated(first_material(volume_object))


def _file_source(shown: Shown, where: str) -> FileSource:
    data = shown.object.data
    if not data.grids.load() or not len(data.grids):
        raise SceneError(f"{where}: {_load_problem(data)}")
    path, folder = _own_file(shown.object), None
    if path is None:
        # Modifiers and geometry nodes make volumes that no file holds.
        folder = tempfile.mkdtemp(prefix="mrpnn-")
        path = str(Path(folder, "evaluated.vdb"))
    material = VolumeMaterial(first_material(shown.object), where)
    # As Blender has read them: files' own descriptions are read by another process alone.
    probe = Probe([grid.name for grid in data.grids], fills_its_bounds=False)
    material.at(probe)
    source = FileSource(_key(shown, probe.placed), where, material, shown.matrix, path, shown.name, probe)
    if folder is not None:
        weakref.finalize(source, shutil.rmtree, folder, ignore_errors=True)
        if not data.grids.save(path):
            raise SceneError(f"{where}: Blender cannot save what its modifiers make")
    return source


def _own_file(volume_object) -> Optional[str]:
    """The file that holds what an object shows, None where there is none or modifiers change it."""
    changed = any(modifier.show_render or modifier.show_viewport for modifier in volume_object.modifiers)
    return None if changed else volume_object.data.grids.frame_filepath or None


def _load_problem(data) -> str:
    if not data.filepath:
        return "it loads no file; choose a .vdb file in its data properties"
    if data.grids.is_loaded:
        return "it holds no grid"
    if data.is_sequence:
        return f"this frame's file of its sequence cannot be read ({data.grids.error_message})"
    return unreadable(bpy.path.abspath(data.filepath, library=data.library), data.grids.error_message)


def _mesh_material(shown: Shown, where: str) -> VolumeMaterial:
    if len({slot.material.name for slot in shown.object.material_slots}) > 1:
        raise SceneError(f"{where}: it has several volume materials; use one")
    return VolumeMaterial(first_material(shown.object), where)


def _fluid_source(shown: Shown, where: str) -> FluidSource:
    material, domain = _mesh_material(shown, where), gas_domain(shown.object)
    # A domain that adapts is a box of its own in each frame.
    generated = _generated(shown.object if domain.use_adaptive_domain else shown.object.original)
    grids = read_grids(domain)
    probe = probe_grids(material, grids)
    read = {name: grids[name] for name in probe.names}
    return FluidSource(_key(shown, probe.placed), where, material, shown.matrix, read, generated)


def _mesh_source(shown: Shown, where: str) -> MeshSource:
    material = _mesh_material(shown, where)
    probe = Probe((), fills_its_bounds=True)
    material.at(probe)
    mesh, generated = read_mesh(shown.object), _generated(shown.object.original)
    require_finite(mesh, where)
    return MeshSource(_key(shown, probe.placed), where, material, shown.matrix, mesh, generated)


def _generated(mesh_object) -> np.ndarray:
    """(4, 4): object space to the mesh's texture space, 0 to 1 over the bounds of the object's own mesh."""
    mesh = mesh_object.data
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
