# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume objects, and meshes with a volume material, as `Volume` and `Medium`."""

import shutil
import tempfile
import weakref
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...inference.numerics.small_matmul import affine_inverse
from ...inference.scene import Medium, SceneError, Velocity, Volume
from ..nodes.material import (
    EmptyMaterial,
    MissingGrids,
    VolumeMaterial,
    first_material,
    is_animated,
    materials,
    shows_volume,
)
from ..nodes.object_attributes import object_values
from ..objects.mesh_triangles import Mesh, read_mesh, require_finite
from ..objects.motion import motion_steps, until_next_frame, uses_motion_blur, velocity_times
from ..objects.placement import has_zero_scale, placement_problem
from ..objects.visibility import VisibleObject, hidden_from_camera, visible_objects
from ..runtime.text import text_of
from ..vdb.density_grid import EmptyGrid, unreadable
from ..world.lighting import wanted_world
from ..world.picture import WorldSource
from .fluid_domain import FluidSource, checksum, gas_domain, is_empty, probe_grids, read_grids, velocities
from .source import FileSource, MeshSource, VolumeSource
from .velocity import FileVelocity, FluidVelocity, VelocitySource, velocity_names
from .voxel_points import Probe

# Types of grids that Cycles reads as 0.
NOT_NUMBERS = {"MASK", "POINTS", "STRING", "UNKNOWN"}


class EmptyVolume(Exception):
    """A volume that is empty in this frame but may not be in others. The frame's number completes its message."""


@dataclass
class VolumeReader:
    """Reads volumes; instances share one reading.

    known: contents of sources, as these read them, or why they cannot be read, by their key. meshes: of surfaces, for
    `read_surface`.
    """

    known: dict[tuple, SceneError | Any] = field(default_factory=dict)
    meshes: dict[tuple, Mesh] = field(default_factory=dict)

    def read(self, shown: VisibleObject) -> tuple[list[tuple[Volume, Medium]], list[str]]:
        """The density, placement and medium of one visible volume, and warnings.

        Several pairs, one for each colour channel that attenuates or emits light, where the colour of its extinction
        varies.

        Raises SceneError, naming the object, where its transform, file, grid, mesh or material cannot be used;
        EmptyVolume where it is empty in this frame.
        """
        where, problem, empty = _where(shown), placement_problem(shown.matrix), why_empty(shown)
        if problem:
            raise SceneError(f"{where}: {problem}")
        if empty:
            raise EmptyVolume(empty)
        if self._known_key(shown) is None:
            for source in self._source(shown):
                self.load(source)
        key = self._known_key(shown)
        known = self.known[key]
        if isinstance(known, MissingGrids):
            raise EmptyVolume(f"is empty, since {known}, in")
        if isinstance(known, (EmptyGrid, EmptyMaterial)) and _varies(shown.object):
            raise EmptyVolume("is empty in")
        if isinstance(known, SceneError):
            raise type(known)(*known.args)
        shaded, object_from_index, warnings = known
        # Warn once for all instances.
        self.known[key] = shaded, object_from_index, []
        scale = 1.0
        if shown.object.type == "VOLUME":
            scale = density_scale(shown.data.render.space, shown.matrix)
        pairs = [
            (
                part.at(shown.matrix @ object_from_index, shown.name),
                Medium(part.sigma_t * scale, part.albedo, part.anisotropy, scale, part.phase),
            )
            for part in shaded.parts
        ]
        return pairs, warnings + [f"{where}: {note}" for note in shaded.notes]

    def velocity(self, shown: VisibleObject, scene: "bpy.types.Scene", blurred: bool = True) -> Velocity | None:
        """The velocities that carry what a visible volume holds; None without any.

        blurred: whether while the shutter is open, as in motion blur; otherwise until the next frame. Raises
        SceneError, naming the object, where its file cannot be used.
        """
        scale, per_second = _velocity_scale(shown)
        if not scale:
            return None
        for source in self._source_of_velocity(shown):
            self.load(source)
        known = self.known[_velocity_key(shown)]
        if isinstance(known, SceneError):
            raise type(known)(*known.args)
        if known is None:
            return None
        components, object_from_index = known
        times = (velocity_times if blurred else until_next_frame)(scene, scale, per_second)
        return Velocity(components, shown.matrix @ object_from_index, shown.matrix[:3, :3], times)

    def wanted(
        self, depsgraph: "bpy.types.Depsgraph", space: "bpy.types.SpaceView3D | None" = None, flows: bool = False
    ) -> list[VolumeSource | VelocitySource | WorldSource]:
        """Sources of the scene that are not read yet, including a World that Cycles has to render: for a
        `VolumeLoading`.

        space: as of `visible_objects`. flows: whether velocities are wanted without motion blur, too.
        """
        found: dict[tuple, VolumeSource | VelocitySource] = {}
        blurred = flows or (space is None and uses_motion_blur(depsgraph))
        for shown in visible_objects(depsgraph, space):
            if self._is_wanted(shown, depsgraph.view_layer):
                found.update((source.key, source) for source in self._source(shown))
                if blurred and carries(shown):
                    found.update((source.key, source) for source in self._source_of_velocity(shown))
        return [*found.values(), *wanted_world(depsgraph)]

    def load(self, source: VolumeSource | VelocitySource | WorldSource, *arguments: Any) -> None:
        """Read a source, or record why it cannot be read; on any thread. arguments: of `VolumeSource.read`."""
        try:
            if isinstance(source, WorldSource):
                # Its picture is remembered by `world.picture`.
                source.read(*arguments)
            else:
                self.known[source.key] = source.read(*arguments)
        except SceneError as problem:
            # Drop the traceback, which holds references to the frames of its origin.
            self.known[source.key] = type(problem)(*problem.args)

    def _is_wanted(self, shown: VisibleObject, view_layer: "bpy.types.ViewLayer") -> bool:
        return (
            shows_volume(shown.object)
            and not (hidden_from_camera(shown, view_layer) or placement_problem(shown.matrix) or why_empty(shown))
            and (self._known_key(shown) is None)
        )

    def _source(self, shown: VisibleObject) -> list[VolumeSource]:
        """A volume's source; nothing where it has none, which is recorded."""
        try:
            return [_volume_source(shown)]
        except SceneError as problem:
            self.known[_key(shown, False)] = type(problem)(*problem.args)
            return []

    def _source_of_velocity(self, shown: VisibleObject) -> list[VelocitySource]:
        """The source of a volume's velocities, unless it is read; nothing where it has none, which is recorded."""
        key, source = _velocity_key(shown), None
        if key in self.known:
            return []
        try:
            source = _velocity_source(shown, key)
        except SceneError as problem:
            self.known[key] = type(problem)(*problem.args)
            return []
        if source is None:
            self.known[key] = None
            return []
        return [source]

    def _known_key(self, shown: VisibleObject) -> tuple | None:
        return next((key for key in (_key(shown, False), _key(shown, True)) if key in self.known), None)


def _key(shown: VisibleObject, placed: bool) -> tuple:
    """Identifies a volume's content. Instances share their data and materials, but differ where a shader reads
    positions or properties of the object.

    Evaluated data belongs to its object or to all its instances; a fluid domain's changes with the frame.
    """
    data, domain = shown.data, gas_domain(shown.object)
    shaders = tuple(material.as_pointer() if material else 0 for material in materials(shown.object))
    content = checksum(domain) if domain else None
    read = object_values(first_material(shown.object), shown.object)
    return data.name_full, data.as_pointer(), shaders, read, shown.matrix.tobytes() if placed else None, content


def carries(shown: VisibleObject) -> bool:
    """Whether motion blur is to show a volume's velocities, if its file or domain has any."""
    moves = shows_volume(shown.object) and bool(motion_steps(shown.object) and motion_steps(shown.host))
    return moves and _velocity_scale(shown)[0] != 0.0


def _velocity_scale(shown: VisibleObject) -> tuple[float, bool]:
    """The factor of a volume's velocities, and whether these are per second."""
    if shown.object.type == "VOLUME":
        return shown.data.velocity_scale, shown.data.velocity_unit == "SECOND"
    domain = gas_domain(shown.object)
    return (domain.velocity_scale, True) if domain else (0.0, True)


def _velocity_key(shown: VisibleObject) -> tuple:
    """Identifies a volume's velocities; instances share them."""
    domain = gas_domain(shown.object)
    content = checksum(domain) if domain else shown.data.velocity_grid
    return "velocity", shown.data.name_full, shown.data.as_pointer(), content


def _velocity_source(shown: VisibleObject, key: tuple) -> VelocitySource | None:
    """The source of a volume's velocities, if it has any. Raises SceneError, naming the object."""
    domain, where = gas_domain(shown.object), _where(shown)
    if domain:
        components = velocities(domain)
        space = affine_inverse(_generated(shown.object if domain.use_adaptive_domain else shown.object.original))
        return FluidVelocity(key, components, space) if components else None
    if shown.object.type != "VOLUME" or not load_grids(shown.data):
        return None
    names = velocity_names(shown.data, _grids_of_numbers(shown.data.grids))
    if not names:
        return None
    path, folder = _file(shown, where)
    source = FileVelocity(key, where, path, shown.name, names, shown.data.is_sequence and folder is None)
    _keep(folder, source)
    return source


def _where(shown: VisibleObject) -> str:
    return f'volume "{shown.name}"'


def _volume_source(shown: VisibleObject) -> VolumeSource:
    """The source of a visible volume. Raises SceneError, naming the object."""
    if shown.object.type == "VOLUME":
        return _file_source(shown, _where(shown))
    return (_fluid_source if gas_domain(shown.object) else _mesh_source)(shown, _where(shown))


def why_empty(shown: VisibleObject) -> str:
    """Why an object that shows a volume is invisible in this frame; "" where it is not."""
    data, domain = shown.data, gas_domain(shown.object)
    if not placement_problem(shown.matrix) and has_zero_scale(shown.matrix):
        return "has scale 0 in"
    if shown.object.type == "VOLUME" and data.is_sequence and load_grids(data) and not len(data.grids):
        return "has no file for"
    return "has no smoke in" if domain and is_empty(domain) else ""


def load_grids(data: "bpy.types.Volume") -> bool:
    """Read which grids a volume's file has; returns whether it could be read."""
    if data.grids.load():
        return True
    # In frames after one whose file is missing, Blender tells of that one until the grids are unloaded.
    data.grids.unload()
    return data.grids.load()


def _varies(volume_object: "bpy.types.Object") -> bool:
    """Whether a volume changes in time: its file, its modifiers or its material."""
    data: Any = volume_object.data
    sequence = volume_object.type == "VOLUME" and data.is_sequence
    return sequence or bool(len(volume_object.modifiers)) or is_animated(first_material(volume_object))


def _file_source(shown: VisibleObject, where: str) -> FileSource:
    data = shown.data
    if not load_grids(data) or not len(data.grids):
        raise SceneError(f"{where}: {_load_problem(data)}")
    path, folder = _file(shown, where)
    is_sequence = data.is_sequence and folder is None
    material = VolumeMaterial(first_material(shown.object), where, shown.object)
    # Names from Blender: only the other process parses files.
    names, vectors = _grids_of_numbers(data.grids)
    probe = Probe(names, fills_its_bounds=False, vectors=vectors)
    material.at(probe)
    key = _key(shown, probe.placed)
    source = FileSource(key, where, material, shown.matrix, path, shown.name, probe, is_sequence)
    _keep(folder, source)
    return source


def _file(shown: VisibleObject, where: str) -> tuple[str, str | None]:
    """The file of a volume. Blender writes that of modifiers and geometry nodes, into a folder that is
    the second result. Raises SceneError, naming the object, where it cannot.
    """
    path = _own_file(shown.object)
    if path is not None:
        return path, None
    folder = tempfile.mkdtemp(prefix="mrpnn-")
    path = str(Path(folder, "evaluated.vdb"))
    if not shown.data.grids.save(path):
        shutil.rmtree(folder, ignore_errors=True)
        raise SceneError(f"{where}: Blender cannot save the result of its modifiers")
    return path, folder


def _keep(folder: str | None, source: Any) -> None:
    """Keep a folder, if any, as long as a source is in use."""
    if folder is not None:
        weakref.finalize(source, shutil.rmtree, folder, ignore_errors=True)


def _grids_of_numbers(grids: Any) -> tuple[list[str], tuple[str, ...]]:
    """Names of the grids that shaders can read, and of those of them that hold vectors; of several of one name the
    first counts.
    """
    kinds: dict[str, str] = {}
    for grid in grids:
        kinds.setdefault(text_of(grid, "name"), grid.data_type)
    names = [name for name, kind in kinds.items() if name and kind not in NOT_NUMBERS]
    return names, tuple(name for name in names if kinds[name].startswith("VECTOR"))


def _own_file(volume_object: "bpy.types.Object") -> str | None:
    """The file of an object's volume; None without one or where modifiers change the volume."""
    changed = any(modifier.show_render or modifier.show_viewport for modifier in volume_object.modifiers)
    data: Any = volume_object.data
    return None if changed else data.grids.frame_filepath or None


def _load_problem(data: "bpy.types.Volume") -> str:
    if not data.filepath:
        return "it loads no file; choose a .vdb file in its data properties"
    if data.grids.is_loaded:
        return "it has no grid"
    if data.is_sequence:
        return f"this frame's file of its sequence cannot be read ({text_of(data.grids, 'error_message')})"
    return unreadable(bpy.path.abspath(data.filepath, library=data.library), text_of(data.grids, "error_message"))


def _mesh_material(shown: VisibleObject, where: str) -> VolumeMaterial:
    if len({material.name for material in materials(shown.object) if material}) > 1:
        raise SceneError(f"{where}: it has several volume materials; use one")
    return VolumeMaterial(first_material(shown.object), where, shown.object)


def _fluid_source(shown: VisibleObject, where: str) -> FluidSource:
    material, domain = _mesh_material(shown, where), gas_domain(shown.object)
    # An adaptive domain has another box in each frame.
    generated = _generated(shown.object if domain.use_adaptive_domain else shown.object.original)
    grids = read_grids(domain)
    probe = probe_grids(material, grids)
    read = {name: grids[name] for name in probe.names}
    return FluidSource(_key(shown, probe.placed), where, material, shown.matrix, read, generated, probe)


def _mesh_source(shown: VisibleObject, where: str) -> MeshSource:
    material = _mesh_material(shown, where)
    probe = Probe((), fills_its_bounds=True)
    material.at(probe)
    mesh, generated = read_mesh(shown.object), _generated(shown.object)
    require_finite(mesh, where)
    return MeshSource(_key(shown, probe.placed), where, material, shown.matrix, mesh, generated)


def _generated(mesh_object: "bpy.types.Object") -> np.ndarray:
    """(4, 4): object space to the mesh's texture space, 0 to 1 over its bounds.

    Of an evaluated object as in Cycles: modifiers keep the texture space, geometry nodes that make a mesh give its own.
    """
    mesh: Any = mesh_object.data
    location, size = np.array(mesh.texspace_location), np.array(mesh.texspace_size)
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag(0.5 / size)
    matrix[:3, 3] = 0.5 - 0.5 * location / size
    return matrix


def density_scale(space: str, matrix: np.ndarray) -> float:
    """Extinction per world unit over extinction per material unit.

    In WORLD space densities are per world unit: 1. In OBJECT space Cycles makes opacity independent of the object's
    scale: 1 / |M u| with M the object's matrix and u the unit vector along (1, 1, 1). Measured in Cycles 4.5 and 5.0
    for uniform, non-uniform and rotated scales.
    """
    if space == "WORLD":
        return 1.0
    return float(1.0 / np.linalg.norm(matrix[:3, :3] @ np.full(3, 3.0**-0.5)))
