# SPDX-License-Identifier: GPL-3.0-or-later
"""Follows the links of node sockets through reroutes, groups and muted nodes."""

from dataclasses import dataclass
from typing import Any

import bpy

# Nodes and sockets of Blender, or their copies by `snapshot`; what they hold depends on their type.
Node = Any
Socket = Any
# The group nodes around a node, outermost first.
Groups = tuple[Node, ...]


class Unsupported(Exception):
    """A node or link that cannot be evaluated; the message names it."""


def unsupported(node: Node, what: str) -> Unsupported:
    """The exception for something that a node has."""
    return Unsupported(f'node "{node.name}" ({node.bl_label}): {what} cannot be evaluated')


@dataclass(frozen=True)
class Source:
    """What drives a socket.

    node, output: the node and its output socket; both None where nothing is linked.
    socket: the input that holds the value where nothing is linked; None where that is 0, as in Cycles: behind a muted
        node or a reroute whose own input is not linked.
    groups: the enclosing group nodes, outermost first.
    passed: types of the sockets that convert the value in turn; the last is the socket's that is driven.
    """

    node: Node | None
    output: Socket | None
    socket: Socket | None
    groups: Groups = ()
    passed: tuple[str, ...] = ()


def always_has_nodes(block: Any) -> bool:
    """Whether materials, Worlds or lights always have nodes; querying `use_nodes` of them is then deprecated."""
    return bpy.app.version >= (5, 0, 0) and not isinstance(block, bpy.types.Light)


def has_nodes(block: Any) -> bool:
    """Whether a material, World or light is shaded by nodes."""
    return block.node_tree is not None and (always_has_nodes(block) or block.use_nodes)


def active_output(block: Any) -> Node | None:
    """The output node that Cycles uses for a material, World or light; None without nodes."""
    return block.node_tree.get_output_node("CYCLES") if has_nodes(block) else None


def source_of(socket: Socket, groups: Groups = ()) -> Source:
    """Follow the links of an input socket, through reroutes, muted nodes and groups."""
    passed: list[str] = [socket.type]
    holds_value = True
    while socket.is_linked:
        link = socket.links[0]
        if link.is_muted or not link.is_valid:
            break
        node, output = link.from_node, link.from_socket
        if node.mute:
            through = next((inner.from_socket for inner in node.internal_links if inner.to_socket == output), None)
            if through is None:
                break
            socket, holds_value, kind = through, False, output.type
        elif node.bl_idname == "NodeReroute":
            socket, holds_value, kind = node.inputs[0], False, output.type
        elif node.bl_idname == "NodeGroupInput" and groups:
            socket, groups, holds_value = _same(groups[-1].inputs, output), groups[:-1], True
            kind = socket.type
        elif node.bl_idname == "ShaderNodeGroup":
            socket, groups, holds_value = _same(_group_output(node).inputs, output), (*groups, node), True
            kind = socket.type
        else:
            return Source(node, output, socket, groups, tuple(reversed(passed)))
        # What a muted node passes on has the type of its output, whatever that of its input.
        passed.append(kind)
    return Source(None, None, socket if holds_value else None, groups, tuple(reversed(passed)))


def _same(sockets: Any, wanted: Socket) -> Socket:
    return next(socket for socket in sockets if socket.identifier == wanted.identifier)


def _group_output(group: Node) -> Node:
    nodes = group.node_tree.nodes if group.node_tree else ()
    for node in nodes:
        if node.bl_idname == "NodeGroupOutput" and node.is_active_output:
            return node
    raise Unsupported(f'group "{group.name}" has no output')


def input_of(node: Node, identifier: str) -> Socket:
    """A node's input socket by its identifier, which is unique where its name is not."""
    return next(socket for socket in node.inputs if socket.identifier == identifier)
