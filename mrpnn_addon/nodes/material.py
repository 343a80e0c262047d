# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume materials: scattering, absorption and emission at points, with Cycles' meaning of each shader."""

from dataclasses import dataclass, field
from typing import Any, NoReturn

import bpy
import numpy as np

from ...inference.scene import SceneError
from ...inference.scene.phase_function import PhaseFunction
from .clear_surface import shows_no_surface
from .emission import blackbody, reads_temperature, strength_and_colour
from .evaluation import NodeEvaluator
from .phase_functions import phase_function
from .snapshot import snapshot
from .sockets import Groups, Node, Source, Unsupported, active_output, has_nodes, input_of, source_of

#: Custom property of objects that show baked light.
LIGHT_MARK = "mrpnn_light"
#: Types of objects that Blender converts to meshes, in which Cycles renders volumes.
MESHES = {"MESH", "CURVE", "SURFACE", "META", "FONT"}
SURFACES = MESHES | {"CURVES", "POINTCLOUD"}
#: Of a missing grid of the density, where the material reads others.
BOXES = "there is no fog here, where Cycles fills boxes around the other grids; enter one of them in Density Attribute"


@dataclass
class Closure:
    """One volume shader at n points.

    weight: float64 (n, 1) or (1, 1), scales both coefficients.
    scatter, absorb: (n, 3) or (1, 3), per world unit.
    phase: phase function.
    grid: name of the grid whose values are `weight`, or "".
    emission: (n, 3) or (1, 3), radiance per world unit, not scaled by the weight.
    blackbody: the part of the emission of a blackbody whose temperature a grid drives, or None. phase_varies: whether
    the phase function, here the mean over what the points scatter, varies in space.
    """

    weight: np.ndarray
    scatter: np.ndarray
    absorb: np.ndarray
    phase: PhaseFunction = phase_function("HENYEY_GREENSTEIN", 0.0)
    grid: str = ""
    emission: np.ndarray = field(default_factory=lambda: np.zeros((1, 3)))
    blackbody: np.ndarray | None = None
    phase_varies: bool = False


@dataclass
class Shading:
    """All shaders of a material at n points.

    closures: those that scatter or absorb. emission: (n, 3) or (1, 3), their sum. blackbody: as of Closure. notes:
    deviations from Cycles, and what it reads that is missing, which `missing` holds alone. boxes: missing grids without
    which Cycles fills boxes with fog.
    """

    closures: list[Closure] = field(default_factory=list)
    emission: np.ndarray = field(default_factory=lambda: np.zeros((1, 3)))
    notes: list[str] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)
    boxes: list[str] = field(default_factory=list)
    blackbody: np.ndarray | None = None


class EmptyMaterial(SceneError):
    """A material that neither scatters, absorbs nor emits."""


class MissingGrids(EmptyMaterial):
    """A material that leaves the volume empty because grids that it reads, which the message tells, do not exist."""


class VolumeMaterial:
    """The volume shader of one object, evaluated at points.

    Copies Blender's nodes when made, on the main thread; any thread may evaluate it.

    Raises SceneError, naming object, material and node, for anything that cannot be rendered, when made or evaluated.
    """

    def __init__(
        self, material: "bpy.types.Material | None", where: str, shown: "bpy.types.Object | None" = None
    ) -> None:
        """shown: the evaluated object that has the material, of which Attribute nodes may read properties."""
        self.where = where if material is None else f'{where}, material "{material.name}"'
        self.output, self._notes = None, []
        if material is None:
            return
        self.output = active_output(material)
        if self.output is None:
            lacks = "Material Output with the target All or Cycles" if has_nodes(material) else "nodes"
            self.refuse(f"it has no {lacks}, so the volume is invisible; add a Principled Volume node and its output")
        if not self.output.inputs["Volume"].is_linked:
            self.refuse("nothing is linked to the Volume socket of its output; add a Principled Volume node")
        if not shows_no_surface(self.output):
            self._notes.append("its surface shader is not rendered; unlink it")
        self.output = snapshot(material.node_tree, self.output, shown)

    def refuse(self, problem: Exception | str, kind: type[SceneError] = SceneError) -> NoReturn:
        """Raise SceneError, or a subclass, naming object and material."""
        raise kind(f"{self.where}: {problem}") from None

    def at(self, points: Any) -> Shading:
        """The shading at `points`, an instance of one of the classes of `volumes.voxel_points`."""
        shading = Shading(notes=list(self._notes))
        try:
            if self.output is None:
                # Cycles' default material: Principled Volume with its default values.
                white = principled_coefficients(np.full((1, 3), 0.5), np.zeros((1, 3)))
                shading.closures.append(Closure(points.attribute("density", None), *white, grid="density"))
            else:
                _add(shading, NodeEvaluator(points), source_of(input_of(self.output, "Volume")), np.ones((1, 1)))
        except Unsupported as problem:
            self.refuse(problem)
        for name, node in points.missing.items():
            reads = "the default material" if node is None else f'node "{node.name}"'
            shading.missing.append(f"{reads} reads {points.absent(name)}")
            # Cycles has no boxes without voxels of other grids.
            differs = name in shading.boxes and points.names
            ends = BOXES if differs else "it counts as 0, as in Cycles"
            shading.notes.append(f"{shading.missing[-1]}; {ends}")
        return shading


def materials(shown: "bpy.types.Object") -> list["bpy.types.Material | None"]:
    """An object's materials, without those of slots that no face of its mesh uses; None for an empty slot.

    Geometry nodes put an empty slot before the material that they set.
    """
    data: Any = shown.data
    found = [slot.material for slot in shown.material_slots] or list(data.materials)
    if len(found) < 2 or shown.type != "MESH":
        return found
    of_faces = data.attributes.get("material_index")
    if of_faces is None:
        return found[:1]
    numbers = np.empty(len(of_faces.data), np.int32)
    of_faces.data.foreach_get("value", numbers)
    used = np.bincount(np.clip(numbers, 0, len(found) - 1), minlength=len(found))
    # In Edit Mode there are no faces to ask.
    return [material for material, faces in zip(found, used) if faces] or found


def first_material(shown: "bpy.types.Object") -> "bpy.types.Material | None":
    """The material that Cycles uses for a Volume object or for a mesh with one material; None without one."""
    return next(iter(materials(shown)), None)


def is_animated(material: "bpy.types.Material | None") -> bool:
    """Whether keyframes or drivers change the nodes of a material or of its groups."""
    trees: list[Any] = [material and material.node_tree]
    for tree in filter(None, trees):
        found = tree.animation_data
        if found is not None and (found.action is not None or len(found.drivers) or len(found.nla_tracks)):
            return True
        trees += [node.node_tree for node in tree.nodes if node.type == "GROUP" and node.node_tree not in trees]
    return False


def shows_volume(shown: "bpy.types.Object") -> bool:
    """Whether Cycles renders an object as a volume: a Volume object, or a mesh whose materials all have a volume and no
    surface, or one that lets all light pass. Baked light is none: it belongs to a volume.
    """
    if shown.type == "VOLUME":
        return shown.get(LIGHT_MARK) is None
    return shown.type in MESHES and only_volume(shown)


def only_volume(shown: "bpy.types.Object") -> bool:
    """Whether an object has materials and all of them have a volume and no visible surface."""
    outputs: list[Node | None] = [material and active_output(material) for material in materials(shown)]
    return bool(outputs) and all(
        output is not None and output.inputs["Volume"].is_linked and shows_no_surface(output) for output in outputs
    )


def has_volume(material: "bpy.types.Material") -> bool:
    """Whether anything is linked to a material's volume."""
    output = active_output(material)
    return output is not None and output.inputs["Volume"].is_linked


def _add(shading: Shading, values: NodeEvaluator, source: Source, weight: np.ndarray) -> None:
    node, groups = source.node, source.groups
    if node is None:
        return
    if node.bl_idname == "ShaderNodeAddShader":
        for socket in node.inputs:
            _add(shading, values, source_of(socket, groups), weight)
    elif node.bl_idname == "ShaderNodeMixShader":
        factor = np.clip(values.number(node, "Fac", groups), 0.0, 1.0)
        for identifier, share in (("Shader", 1.0 - factor), ("Shader_001", factor)):
            _add(shading, values, source_of(input_of(node, identifier), groups), weight * share)
    elif node.bl_idname in CLOSURES:
        closure = CLOSURES[node.bl_idname](shading, values, node, groups)
        shading.emission = shading.emission + weight * closure.emission
        if closure.blackbody is not None:
            before = 0.0 if shading.blackbody is None else shading.blackbody
            shading.blackbody = before + weight * closure.blackbody
        # Skip closures that are 0 everywhere, not only at these points.
        if len(closure.scatter) + len(closure.absorb) > 2 or closure.scatter.any() or closure.absorb.any():
            closure.grid = closure.grid if np.all(weight == 1.0) else ""
            closure.weight = closure.weight * weight
            shading.closures.append(closure)
    else:
        raise Unsupported(
            f'node "{node.name}" ({node.bl_label}) is not supported; use Principled Volume, '
            "Volume Scatter, Volume Absorption, Add Shader or Mix Shader"
        )


def _principled(shading: Shading, values: NodeEvaluator, node: Node, groups: Groups) -> Closure:
    density = np.maximum(values.number(node, "Density", groups), 0.0)
    names = {name: _text(node, f"{name} Attribute", groups) for name in ("Density", "Color", "Temperature")}
    emission = strength_and_colour(values, node, "Emission Strength", "Emission Color", groups)
    glow = blackbody(values, node, groups, names["Temperature"])
    emission = emission + glow
    hot = glow if reads_temperature(values, node, groups, names["Temperature"]) else None
    points: Any = values.points
    if glow.any() and names["Temperature"] and hot is None and not points.fills_its_bounds:
        _leaves_unchanged(shading, points, node, "Temperature", names["Temperature"])
    shaped = density.shape[0] > 1 or values.is_linked(node, "Density", groups)
    if not shaped and not density.max() > 0.0:
        return Closure(np.ones((1, 1)), np.zeros((1, 3)), np.zeros((1, 3)), emission=emission, blackbody=hot)
    colour = np.maximum(values.colour(node, "Color", groups), 0.0)
    if names["Color"] and points.has(names["Color"]):
        colour = colour * np.maximum(points.attribute(names["Color"], node), 0.0)
    elif names["Color"]:
        _leaves_unchanged(shading, points, node, "Color", names["Color"])
    # A missing attribute leaves Density unchanged in meshes. In a Volume object Cycles fills boxes around the voxels of
    # other grids: here it counts as 0.
    weight, grid = np.ones((1, 1)), ""
    if names["Density"] and not (points.has(names["Density"]) or shaped or points.fills_its_bounds):
        weight = points.attribute(names["Density"], node)
        shading.boxes.append(names["Density"])
    elif names["Density"] and points.has(names["Density"]):
        found = points.attribute(names["Density"], node)
        # Of a grid of vectors, the mean of the components.
        weight, grid = (found, names["Density"]) if found.shape[1] == 1 else (found.mean(axis=1, keepdims=True), "")
    absorption = np.maximum(values.colour(node, "Absorption Color", groups), 0.0)
    scatter, absorb = principled_coefficients(colour, absorption)
    # A uniform density scales the coefficients, so that voxels keep the file's values.
    if len(density) > 1:
        weight, grid = weight * density, ""
    else:
        scatter, absorb = scatter * density, absorb * density
    phase, varies = _phase(shading, values, node, groups, weight * scatter)
    return Closure(weight, scatter, absorb, phase, grid, emission, hot, varies)


def _leaves_unchanged(shading: Shading, points: Any, node: Node, socket: str, name: str) -> None:
    shading.notes.append(
        f'node "{node.name}" reads {points.absent(name)}; its {socket} is the same everywhere, as in Cycles'
    )


def principled_coefficients(colour: np.ndarray, absorption: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(scatter, absorb) (n, 3) of Principled Volume at density 1, as Cycles 4.5 and 5.0 render it:

    scatter = colour
    absorb = max(1 - colour, 0) max(1 - sqrt(absorption), 0)
    """
    return colour, np.maximum(1.0 - colour, 0.0) * np.maximum(1.0 - np.sqrt(absorption), 0.0)


def _text(node: Node, identifier: str, groups: Groups) -> str:
    source = source_of(input_of(node, identifier), groups)
    if source.node is not None:
        raise Unsupported(f'node "{source.node.name}" linked to {identifier} of "{node.name}" is not supported')
    return source.socket.default_value if source.socket is not None else ""


def _density(values: NodeEvaluator, node: Node, groups: Groups) -> np.ndarray:
    return np.maximum(values.number(node, "Density", groups), 0.0)


def _scatter(shading: Shading, values: NodeEvaluator, node: Node, groups: Groups) -> Closure:
    # Volume Scatter does not absorb.
    colour, density = np.maximum(values.colour(node, "Color", groups), 0.0), _density(values, node, groups)
    phase, varies = _phase(shading, values, node, groups, density * colour)
    return Closure(density, colour, np.zeros((1, 3)), phase, phase_varies=varies)


def _absorption(shading: Shading, values: NodeEvaluator, node: Node, groups: Groups) -> Closure:
    colour = values.colour(node, "Color", groups)
    return Closure(_density(values, node, groups), np.zeros((1, 3)), np.maximum(1.0 - colour, 0.0))


def _coefficients(shading: Shading, values: NodeEvaluator, node: Node, groups: Groups) -> Closure:
    scatter, absorb, emission = (
        np.maximum(values.colour(node, f"{kind} Coefficients", groups), 0.0)
        for kind in ("Scatter", "Absorption", "Emission")
    )
    phase, varies = _phase(shading, values, node, groups, scatter)
    return Closure(np.ones((1, 1)), scatter, absorb, phase, emission=emission, phase_varies=varies)


def _emission(shading: Shading, values: NodeEvaluator, node: Node, groups: Groups) -> Closure:
    emission = strength_and_colour(values, node, "Strength", "Color", groups)
    return Closure(np.ones((1, 1)), np.zeros((1, 3)), np.zeros((1, 3)), emission=emission)


CLOSURES = {
    "ShaderNodeVolumePrincipled": _principled,
    "ShaderNodeVolumeScatter": _scatter,
    "ShaderNodeVolumeAbsorption": _absorption,
    "ShaderNodeVolumeCoefficients": _coefficients,
    "ShaderNodeEmission": _emission,
}


def _phase(
    shading: Shading, values: NodeEvaluator, node: Node, groups: Groups, scattered: np.ndarray
) -> tuple[PhaseFunction, bool]:
    """The node's phase function, and whether it varies in space: then that of the mean over what points scatter, (n, 3)
    or (1, 3). Adds a note where it does, or is not Henyey-Greenstein.
    """
    kind = getattr(node, "phase", "HENYEY_GREENSTEIN")
    sockets = {
        "HENYEY_GREENSTEIN": ("Anisotropy",),
        "DRAINE": ("Anisotropy", "Alpha"),
        "RAYLEIGH": (),
        "MIE": ("Diameter",),
        "FOURNIER_FORAND": ("IOR", "Backscatter"),
    }[kind]
    found = [values.number(node, name, groups) for name in sockets]
    varies = any(len(value) > 1 for value in found)
    if varies:
        amount = np.maximum(scattered, 0.0).mean(axis=1)
        amount = np.broadcast_to(amount if amount.any() else 1.0, max(map(len, found)))
        found = [np.average(np.broadcast_to(value[:, 0], len(amount)), weights=amount).reshape(1, 1) for value in found]
        shading.notes.append(f'the phase function of node "{node.name}" varies in space; its mean is used')
    phase = phase_function(kind, *(float(value[0, 0]) for value in found))
    if kind != "HENYEY_GREENSTEIN":
        shading.notes.append(
            f'node "{node.name}" has phase function {kind.replace("_", "-").title()}; multiple scattering uses '
            f"Henyey-Greenstein with an Anisotropy of {phase.mean_cosine():.3f}"
        )
    return phase, varies
