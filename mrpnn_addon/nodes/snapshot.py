# SPDX-License-Identifier: GPL-3.0-or-later
"""Plain copies of shader nodes, read once, for threads that must not call bpy.

Nodes and sockets keep their property names, so the same code evaluates Blender's nodes and copies. Copies include
curves, colour ramps, groups and object transforms that a node refers to.
"""

from typing import Any

import bpy
import numpy as np

from .environment_image import read_pixels
from .functions import RAMP_CELLS, curve_tables
from .object_attributes import OBJECT, object_value
from .sockets import Node, Socket

PLAIN = {"BOOLEAN", "INT", "FLOAT", "STRING", "ENUM"}
# Curves of nodes that have some.
CURVES = {"ShaderNodeFloatCurve": 1, "ShaderNodeRGBCurve": 4, "ShaderNodeVectorCurve": 3}
# Sockets with a value.
VALUED = {"VALUE", "INT", "BOOLEAN", "VECTOR", "RGBA", "ROTATION", "STRING"}


class Copy:
    """A node, a socket or a link; compared by identity, as Blender's objects are."""

    def __init__(self, **values: Any) -> None:
        vars(self).update(values)

    def as_pointer(self) -> int:
        return id(self)


class Ramp(Copy):
    """A colour ramp, tabulated."""

    table: list[tuple[float, ...]]

    def evaluate(self, place: float) -> tuple[float, ...]:
        return self.table[round(place * (RAMP_CELLS - 1))]


def snapshot(tree: Any, node: Node, shown: "bpy.types.Object | None" = None) -> Copy:
    """A copy of one node of a tree, with all nodes that it is linked to.

    shown: the evaluated object that has the material, of which Attribute nodes read properties.
    """
    return _tree(tree, {}, shown)[node.as_pointer()]


def _tree(tree: Any, groups: dict[int, dict[int, Node]], shown: "bpy.types.Object | None") -> dict[int, Node]:
    """Copies of a tree's nodes, by pointer. groups: copies of group trees made so far, by pointer."""
    nodes: dict[int, Node] = {}
    sockets: dict[int, Socket] = {}
    for node in tree.nodes:
        copy = Copy(**_plain(node), name=node.name, bl_idname=node.bl_idname, bl_label=node.bl_label, mute=node.mute)
        for side in ("inputs", "outputs"):
            found = [_socket(socket, copy) for socket in getattr(node, side)]
            sockets.update(zip((socket.as_pointer() for socket in getattr(node, side)), found))
            setattr(copy, side, found)
        _copy_references(copy, node, groups, shown)
        nodes[node.as_pointer()] = copy
    for node in tree.nodes:
        nodes[node.as_pointer()].internal_links = [_link(link, sockets) for link in node.internal_links]
    for link in tree.links:
        sockets[link.to_socket.as_pointer()].links.append(_link(link, sockets))
    for socket in sockets.values():
        socket.is_linked = bool(socket.links)
    return nodes


def _plain(node: Node) -> dict[str, Any]:
    """Numbers, strings and choices that are specific to this type of node."""
    common = bpy.types.Node.bl_rna.properties
    return {
        p.identifier: _value(getattr(node, p.identifier))
        for p in node.bl_rna.properties
        if p.type in PLAIN and p.identifier not in common and not getattr(p, "is_enum_flag", False)
    }


def _value(value: Any) -> Any:
    return value if isinstance(value, (bool, int, float, str)) else tuple(np.array(value, float).ravel().tolist())


def _socket(socket: Socket, node: Copy) -> Copy:
    copy: Socket = Copy(node=node, name=socket.name, identifier=socket.identifier, type=socket.type, links=[])
    if socket.type in VALUED and hasattr(socket, "default_value"):
        copy.default_value = _value(socket.default_value)
    return copy


def _link(link: Any, sockets: dict[int, Socket]) -> Copy:
    start, end = (sockets[socket.as_pointer()] for socket in (link.from_socket, link.to_socket))
    return Copy(is_muted=link.is_muted, is_valid=link.is_valid, from_node=start.node, from_socket=start, to_socket=end)


def _copy_references(
    copy: Node, node: Node, groups: dict[int, dict[int, Node]], shown: "bpy.types.Object | None"
) -> None:
    """Copy what a node refers to."""
    if node.bl_idname == "ShaderNodeAttribute" and node.attribute_type == OBJECT and shown is not None:
        copy.object_value = object_value(shown, node.attribute_name)
    if hasattr(node, "color_ramp"):
        ramp = node.color_ramp
        copy.color_ramp = Ramp(
            interpolation=ramp.interpolation,
            table=[tuple(ramp.evaluate(n / (RAMP_CELLS - 1))) for n in range(RAMP_CELLS)],
        )
    if node.bl_idname in CURVES:
        copy.mapping = Copy(extend=node.mapping.extend, tables=curve_tables(node.mapping, CURVES[node.bl_idname]))
    if node.bl_idname == "ShaderNodeTexImage" and any(socket.is_linked for socket in node.outputs):
        try:
            copy.image = read_pixels(node.image)
        except ValueError:
            # Told where it is evaluated.
            copy.image = None
    if hasattr(node, "object"):
        copy.object = node.object and Copy(matrix_world=np.array(node.object.matrix_world))
    if hasattr(node, "node_tree"):
        key = node.node_tree and node.node_tree.as_pointer()
        if key and key not in groups:
            groups[key] = _tree(node.node_tree, groups, shown)
        copy.node_tree = Copy(nodes=list(groups[key].values())) if key else None
