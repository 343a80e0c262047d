"""Volume objects, and meshes with a volume material, as `Volume` and `Medium`."""

import shutil
import tempfile
import weakref
from dataclasses import dataclass, field
from pathlib import Path
from typing import Dict, List, Optional, Tuple

import bpy
import numpy as np

from ..inference.scene import Medium, SceneError, Volume
from .density_grid import unreadable
from .fluid_domain import FluidSource, checksum, gas_domain, holds_nothing, probe_grids, read_grids
from .material import VolumeMaterial, first_material, shows_volume
from .mesh_triangles import Mesh, read_mesh
from .shaded_grid import ShadedGrid
from .visibility import Shown, shown_objects, why_unseen
from .volume_source import FileSource, MeshSource, VolumeSource
from .voxel_points import Probe
from .world import wanted_world


@dataclass
class VolumeReader:
    """Reads volumes; what instances share is read once. known: what sources have read, by their key. meshes: of
    surfaces, for `read_surface`.
    """

    known: Dict[tuple, Tuple[ShadedGrid, np.ndarray, List[str]]] = field(default_factory=dict)
    meshes: Dict[tuple, Mesh] = field(default_factory=dict)

    def read(self, shown: Shown) -> Tuple[Volume, Medium, List[str]]:
        """The density, placement and shading of one visible volume, and warnings.

        Raises SceneError, naming the object, where the file, the grid, the mesh or the material cannot
        be used.
        """
        key = self._known_key(shown)
        if key is None:
            source = volume_source(shown)
            key, self.known[source.key] = source.key, source.read()
        shaded, object_from_index, warnings = self.known[key]
        # Once, for all instances.
        self.known[key] = shaded, object_from_index, []
        where, scale = _where(shown), 1.0
        if shown.object.type == 'VOLUME':
            scale = density_scale(shown.object.data.render.space, shown.matrix)
        volume = Volume(shaded.density, shown.matrix @ object_from_index, shown.name, shaded.emission, shaded.emission_power)
        medium = Medium(shaded.sigma_t * scale, shaded.albedo, shaded.anisotropy, scale, shaded.phase)
        return volume, medium, warnings + [f"{where}: {note}" for note in shaded.notes]

    def wanted(self, depsgraph) -> List[VolumeSource]:
        """What this would have to read for the scene, and the World where Cycles has to show it: for a `VolumeLoading`.

        Up to where something keeps the scene from being read; reading it says what.
        """
        found = {}
        try:
            for shown in shown_objects(depsgraph):
                unseen = not shows_volume(shown.object) or why_unseen(shown, depsgraph.view_layer)
                if not unseen and not why_empty(shown.object) and self._known_key(shown) is None:
                    source = volume_source(shown)
                    found[source.key] = source
        except SceneError:
            pass
        return [*found.values(), *wanted_world(depsgraph)]

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


def volume_source(shown: Shown) -> VolumeSource:
    """What a visible volume is to be read from. Raises SceneError, naming the object."""
    if shown.object.type == 'VOLUME':
        return _file_source(shown, _where(shown))
    return (_fluid_source if gas_domain(shown.object) else _mesh_source)(shown, _where(shown))


def why_empty(shown_object) -> str:
    """Why an object that shows a volume shows none in this frame, so that it is invisible; "" where it does."""
    data, domain = shown_object.data, gas_domain(shown_object)
    if shown_object.type == 'VOLUME' and data.is_sequence and data.grids.load() and not len(data.grids):
        return "has no file for"
    return "holds no smoke in" if domain and holds_nothing(domain) else ""


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
