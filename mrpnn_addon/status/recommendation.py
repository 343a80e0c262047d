# SPDX-License-Identifier: GPL-3.0-or-later
"""Which of three ways of showing volumes suits a scene: the layer alone, a composite over Cycles, or baked light."""

from dataclasses import dataclass
from typing import Any

import bpy

from ..nodes.material import SURFACES, materials, shows_volume
from ..nodes.sockets import has_nodes
from ..objects.visibility import visible_objects
from ..scene.unrendered import in_composite

LAYER, COMPOSITE, BAKED_LIGHT = "layer", "composite", "baked light"

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
    """way: LAYER, COMPOSITE or BAKED_LIGHT. reason: a sentence for the panel."""

    way: str
    reason: str


def recommend(depsgraph: "bpy.types.Depsgraph") -> Recommendation:
    """What suits what renders show, without reading volumes."""
    scene = depsgraph.scene
    needs, surfaces = [], False
    for shown in visible_objects(depsgraph):
        kind = shown.object.type
        if kind in SURFACES and not shows_volume(shown.object):
            surfaces = True
            for material in materials(shown.object):
                needs += _shows_surroundings(material)
    if needs:
        found = list(dict.fromkeys(needs))
        listed = found[0] if len(found) == 1 else f"{', '.join(found[:-1])} and {found[-1]}"
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
