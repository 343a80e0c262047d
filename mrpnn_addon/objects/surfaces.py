# SPDX-License-Identifier: GPL-3.0-or-later
"""Opaque surfaces that hide and shade volumes."""

from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...inference.scene import Motion, SceneError, Surface
from ..nodes.material import MESHES, has_volume, materials, only_volume
from ..nodes.sockets import Source, Unsupported, active_output, input_of, source_of
from ..nodes.surface_colour import SurfaceColour, surface_colour
from .ignored_settings import SHINING, ignored_settings
from .mesh_triangles import Mesh, read_mesh, require_finite
from .placement import placement_problem
from .visibility import LEFT_OUT, VisibleObject, is_holdout

#: Of a transparent mesh with a volume, after its name.
VOLUME_INSIDE = (
    "a volume inside a transparent surface is not rendered; unlink its surface, or link a white Transparent BSDF"
)
SOME_FACES = "some of its faces have no volume in their material; assign the material with the volume to all of them"
SEE_THROUGH = {"ShaderNodeBsdfTransparent", "ShaderNodeBsdfGlass", "ShaderNodeBsdfRefraction"}


@dataclass
class OpaqueMesh:
    """A `Surface` whose triangles are not made yet.

    name, covers, shades, stops, receivers: see `Surface`. matrix: (4, 4), object to world. colour: mean of its
    materials. key: as of `VisibleObject`. matrices: (S, 4, 4) of one that moves while the shutter is open, or None.
    vertices: float32 (S, V, 3) of one that also changes its shape then, in object space, or None.
    """

    mesh: Mesh
    matrix: np.ndarray
    name: str
    covers: bool
    shades: bool
    stops: bool
    colour: SurfaceColour
    receivers: frozenset[str] | None = None
    key: tuple = ()
    matrices: np.ndarray | None = None
    vertices: np.ndarray | None = None

    def surface(self) -> Surface:
        """The `Surface`; any thread may call this. Raises SceneError where its vertices are not finite."""
        triangles, colour, motion, deformed = self.mesh.triangles(self.matrix), self.colour, None, None
        if self.matrices is not None and self.vertices is not None:
            deformed = np.stack([self.mesh.triangles(*then) for then in zip(self.matrices, self.vertices)])
        elif self.matrices is not None:
            motion = Motion(self.matrices, self.matrix)
        return Surface(
            triangles,
            self.name,
            self.covers,
            self.shades,
            self.stops,
            colour.reflectance,
            colour.emission,
            self.receivers,
            motion,
            deformed,
        )


# What is said of an object that `hides_own_fog`.
OWN_FOG = "hides the fog of its own material, as in Cycles. Unlink Surface in the material's output to show the fog"


def read_surface(
    shown: VisibleObject, view_layer: "bpy.types.ViewLayer", known: dict[tuple, Mesh]
) -> tuple[OpaqueMesh | None, list[str]]:
    """A visible object's surface if it is opaque and affects volumes, and warnings.

    known: meshes read so far; instances share them.

    Raises SceneError, naming the object, where its transform or its vertices are not finite.
    """
    where = f'{_kind(shown)} object "{shown.name}"'
    if shown.object.type not in MESHES:
        if only_volume(shown.object):
            return None, [
                f"{where} has a volume material, which Cycles renders in meshes only; convert it to a mesh{LEFT_OUT}"
            ]
        return None, [f"{where} is no mesh, so it neither hides nor shades volumes{LEFT_OUT}"]
    covers = shown.visible_to("camera") and not shown.source.indirect_only_get(view_layer=view_layer)
    shades, stops = shown.visible_to("shadow"), shown.visible_to("volume_scatter")
    if not (covers or shades or stops):
        return None, []
    holdout = is_holdout(shown, view_layer)
    if not holdout and is_transparent(shown.object):
        volumes = [material is not None and has_volume(material) for material in materials(shown.object)]
        if any(volumes) and not all(volumes):
            return None, [f"{where}: {SOME_FACES}{LEFT_OUT}"]
        if any(volumes):
            return None, [f"{where}: {VOLUME_INSIDE}{LEFT_OUT}"]
        return None, [f"{where} is transparent; volumes behind it are fully visible{LEFT_OUT}"]
    # Blender's list of instances reuses one object for all of them; its data is each one's own.
    key = (shown.object.data.name_full, shown.object.data.as_pointer())
    if key not in known:
        known[key] = read_mesh(shown.object)
    mesh, problem = known[key], placement_problem(shown.matrix)
    if len(mesh.corners) and problem:
        raise SceneError(f"{where}: {problem}")
    require_finite(mesh, where)
    if not len(mesh.corners):
        return None, []
    # Light that volumes scatter, or that they gather, does not know surfaces that are hidden from volume scattering.
    colour = _mean_colour(shown.object.material_slots, mesh) if stops else SurfaceColour()
    ignored = ignored_settings(shown.object, SHINING, where) if colour.emission.any() else []
    if hides_own_fog(shown.object):
        ignored.append(f"{where} {OWN_FOG}")
    return OpaqueMesh(mesh, shown.matrix, where, covers, shades, stops, colour, key=shown.key), ignored


def hides_own_fog(shown: "bpy.types.Object") -> bool:
    """Whether a mesh has fog, and a surface that light does not pass."""
    used = [material for material in materials(shown) if material is not None]
    return any(map(has_volume, used)) and not is_transparent(shown)


def is_transparent(shown: "bpy.types.Object") -> bool:
    """Whether light passes the surface of a mesh, where any of its materials lets it."""
    return any(_is_transparent(material) for material in materials(shown))


def _kind(shown: VisibleObject) -> str:
    """The type of an object as Blender's interface names it, such as "text"."""
    original = shown.object.original
    kinds: Any = original.bl_rna.properties["type"]
    return kinds.enum_items[original.type].name.lower()


def _mean_colour(slots: "bpy.types.bpy_prop_collection", mesh: Mesh) -> SurfaceColour:
    """Mean of the materials of a mesh over its area."""
    if len(slots) < 2:
        return surface_colour(slots[0].material if slots else None)
    found = SurfaceColour()
    for number, share in enumerate(mesh.areas / max(mesh.areas.sum(), 1e-300)):
        if share > 0.0:
            part = surface_colour(slots[min(number, len(slots) - 1)].material)
            found.reflectance = found.reflectance + share * part.reflectance
            found.emission = found.emission + share * part.emission
            found.notes |= part.notes
    return found


def surface_warnings(surfaces: list[OpaqueMesh], panorama: bool, composited: bool) -> list[str]:
    """Warnings of what surfaces do and do not do.

    composited: whether Cycles renders them, and the compositor lets them cover volumes in panoramas.
    """
    found, covering = [], [surface for surface in surfaces if surface.covers]
    if covering and panorama and not composited:
        found.append(f"{_names(covering)}: surfaces do not cover volumes in panoramas")
    notes = sorted(set().union(*(surface.colour.notes for surface in surfaces)))
    without = f", without {_and(notes)}" if notes else ""
    if surfaces:
        does, ends = ("hides, shades and lights", "as a matte surface of its mean color"), "renders it, too"
        if len(surfaces) > 1:
            does, ends = ("hide, shade and light", "as matte surfaces of their mean colors"), "renders them, too"
        if not composited:
            found.append(f"{_names(surfaces)} only {does[0]} volumes, {does[1]}{without}; Composite over Cycles {ends}")
        elif notes:
            found.append(f"{_names(surfaces)} {does[0]} volumes {does[1]}{without}")
    return found


def _and(names: list[str]) -> str:
    return ", ".join(names[:-1]) + " and " + names[-1] if len(names) > 1 else names[0]


def _names(surfaces: list[OpaqueMesh]) -> str:
    more = f" and {len(surfaces) - 1} more" if len(surfaces) > 1 else ""
    return surfaces[0].name + more


def _is_transparent(material: "bpy.types.Material") -> bool:
    output = active_output(material) if material else None
    if output is None:
        return False
    try:
        return _transmits(source_of(output.inputs["Surface"]))
    except Unsupported:
        return False


def _transmits(source: Source) -> bool:
    """Whether a shader, or any that it mixes, transmits light. No shader does."""
    node, groups = source.node, source.groups
    if node is None or node.bl_idname in SEE_THROUGH:
        return True
    if node.bl_idname in ("ShaderNodeMixShader", "ShaderNodeAddShader"):
        return any(_transmits(source_of(socket, groups)) for socket in node.inputs if socket.type == "SHADER")
    if node.bl_idname == "ShaderNodeBsdfPrincipled":
        alpha, through = (input_of(node, name) for name in ("Alpha", "Transmission Weight"))
        return (
            any(socket.is_linked for socket in (alpha, through))
            or alpha.default_value < 1.0
            or through.default_value > 0.0
        )
    return False
