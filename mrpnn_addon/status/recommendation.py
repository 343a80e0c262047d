# SPDX-License-Identifier: GPL-3.0-or-later
"""Which way of showing volumes suits a scene: the layer, a composite over Cycles, baked light, or Cycles alone."""

from dataclasses import dataclass
from typing import Any

import bpy

from ..nodes.material import SURFACES, materials, shows_volume
from ..nodes.sockets import has_nodes
from ..objects.visibility import VisibleObject, visible_objects
from ..scene.unrendered import in_composite
from ..volumes.bounding_boxes import box_around
from ..volumes.fluid_domain import gas_domain

LAYER, COMPOSITE, BAKED_LIGHT, CYCLES = "layer", "composite", "baked light", "Cycles"
# Mean optical thickness of volumes through which light scatters so seldom that a few bounces of Cycles show it all.
THIN = 3.0
# Mean density of a file's volume along a ray, as a share of the peak.
FILLED = 0.1

# Shaders that show what lies around a surface, and the socket that says how much, with its least value for that.
_CLEAR = {
    "ShaderNodeBsdfGlass": "glass",
    "ShaderNodeBsdfRefraction": "glass",
    "ShaderNodeBsdfTransparent": "transparent surfaces",
    "ShaderNodeBsdfGlossy": "mirrors",
    "ShaderNodeBsdfAnisotropic": "mirrors",
    "ShaderNodeBsdfMetallic": "mirrors",
}
_ROUGH = 0.5


@dataclass(frozen=True)
class Recommendation:
    """way: LAYER, COMPOSITE, BAKED_LIGHT or CYCLES. reason: a sentence for the panel."""

    way: str
    reason: str


def recommend(depsgraph: "bpy.types.Depsgraph") -> Recommendation:
    """What suits what renders show, without reading volumes."""
    scene = depsgraph.scene
    needs, surfaces = [], False
    for shown in visible_objects(depsgraph):
        if is_surface(shown):
            surfaces = True
            needs += surroundings(shown)
    if needs:
        found = list(dict.fromkeys(needs))
        listed = found[0] if len(found) == 1 else f"{', '.join(found[:-1])} and {found[-1]}"
        if scatters_seldom(depsgraph):
            return Recommendation(
                CYCLES,
                f"This scene has {listed}, which MRPNN Volumes does not render. Its volumes are thin: a few volume "
                "bounces of Cycles show them in less time than a bake takes",
            )
        return Recommendation(
            BAKED_LIGHT,
            f"This scene has {listed}, which MRPNN Volumes does not render. Bake the light to render all of it with "
            "Cycles",
        )
    if surfaces and in_composite(scene):
        return Recommendation(
            COMPOSITE,
            "Composite over Cycles renders all of this scene. Bake the light only where Cycles or EEVEE has to render "
            "the volumes",
        )
    if surfaces:
        return Recommendation(
            COMPOSITE,
            "This scene has surfaces, which MRPNN Volumes does not render. Composite over Cycles adds them. Bake the "
            "light only where Cycles or EEVEE has to render the volumes",
        )
    return Recommendation(
        LAYER,
        "MRPNN Volumes renders all of this scene. Bake the light only where Cycles or EEVEE has to render the volumes",
    )


def scatters_seldom(depsgraph: "bpy.types.Depsgraph") -> bool:
    """Whether a few bounces of Cycles show all light that the volumes scatter, in less time than a bake takes."""
    return all(_thickness(shown) < THIN for shown in visible_objects(depsgraph) if shows_volume(shown.object))


def _thickness(shown: VisibleObject) -> float:
    """Mean optical thickness along a volume's longest edge, estimated without reading it."""
    box, _ = box_around(shown)
    # Without a simulation, a mesh is filled evenly.
    even = shown.object.type != "VOLUME" and gas_domain(shown.object) is None
    return box.thickness * box.cells * (1.0 if even else FILLED)


def is_surface(shown: VisibleObject) -> bool:
    """Whether an object shows a surface."""
    return shown.object.type in SURFACES and not shows_volume(shown.object)


def surroundings(shown: VisibleObject) -> list[str]:
    """Which mirrors and glasses a surface has, in words."""
    return [found for material in materials(shown.object) for found in _shows_surroundings(material)]


def _shows_surroundings(material: "bpy.types.Material") -> list[str]:
    """Which mirrors and glasses a material has."""
    if material is None or not has_nodes(material):
        return []
    found: list[str] = []
    trees: list[Any] = [material.node_tree]
    for tree in trees:
        for node in tree.nodes:
            if node.type == "GROUP" and node.node_tree is not None and node.node_tree not in trees:
                trees.append(node.node_tree)
            elif node.mute:
                continue
            elif node.bl_idname in _CLEAR and _value(node, "Roughness") < _ROUGH:
                found.append(_CLEAR[node.bl_idname])
            elif node.bl_idname == "ShaderNodeBsdfPrincipled" and _value(node, "Roughness") < _ROUGH:
                found += ["glass"] if _value(node, "Transmission Weight") > 0.0 else []
                found += ["mirrors"] if _value(node, "Metallic") > _ROUGH else []
    return found


def _value(node: Any, name: str) -> float:
    """A socket's own value; 0 without such a socket."""
    socket = node.inputs.get(name)
    return float(socket.default_value) if socket is not None else 0.0
