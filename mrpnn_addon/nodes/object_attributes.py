# SPDX-License-Identifier: GPL-3.0-or-later
"""Attribute nodes of type Object: properties of the object that a material is on, with Cycles' meaning."""

from typing import Any

import bpy
import numpy as np

OBJECT = "OBJECT"


def object_value(shown: "bpy.types.Object", name: str) -> tuple[float, ...]:
    """(red, green, blue, alpha) of a custom property of an evaluated object or of its data, or else of a property of
    Blender's; 0 for one that does not exist or is no number, as in Cycles.
    """
    for holder in (shown, shown.data):
        value = None if holder is None else _property(holder, name)
        if value is not None:
            return value
    return (0.0,) * 4


def object_values(material: "bpy.types.Material | None", shown: "bpy.types.Object") -> tuple[tuple[float, ...], ...]:
    """What the Attribute nodes of a material and of its groups read of an object."""
    found: list[tuple[float, ...]] = []
    trees: list[Any] = [material and material.node_tree]
    for tree in filter(None, trees):
        for node in tree.nodes:
            if node.bl_idname == "ShaderNodeAttribute" and node.attribute_type == OBJECT:
                found.append(object_value(shown, node.attribute_name))
            elif node.type == "GROUP" and node.node_tree not in trees:
                trees.append(node.node_tree)
    return tuple(found)


def _property(holder: Any, name: str) -> tuple[float, ...] | None:
    try:
        value = holder[name] if name in holder else holder.path_resolve(name)
    except (ValueError, TypeError):
        return None
    if isinstance(value, (bool, int, float)):
        return (float(value),) * 3 + (1.0,)
    try:
        numbers = np.array(value, np.float64)
    except (ValueError, TypeError):
        return None
    if numbers.ndim != 1 or not 0 < len(numbers) <= 4:
        return None
    return (*numbers.tolist(), *(0.0, 0.0, 0.0, 1.0)[len(numbers) :])
