# SPDX-License-Identifier: GPL-3.0-or-later
"""A node group whose sliders change the colour and the strength of lights after rendering.

The layer is linear in its lights. With a pass p of each light, or group of lights, and its factor f of strength and
colour, the picture in the changed light is the rendered one plus the sum of (f - 1) p.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import bpy

from .composite_nodes import FIVE, compositor, node_of_role

GROUP, PREFIX = "MRPNN Relight", "Combined_"
# Names of an input socket of the group, after that of the light.
STRENGTH, COLOUR = "Strength", "Color"
SPACING = 180.0


def relight(scene: "bpy.types.Scene", source: "bpy.types.Scene", names: Sequence[str]) -> Any:
    """Put the group between the layer and what shows it in a scene's compositor, or bring it up to date.

    source: whose passes are changed: the scene itself, or that of its volumes. names: of the lights that have a pass.
    Sliders of lights that the group has already keep their values. Returns the node.
    """
    tree, result = compositor(scene)
    layer = _layer(tree, source)
    node = node_of_role(tree, "relight", "CompositorNodeGroup")
    before = {socket.name: _value(socket) for socket in node.inputs if socket.name.endswith((STRENGTH, COLOUR))}
    old, node.node_tree = node.node_tree, _group(names)
    if old is not None and not old.users:
        bpy.data.node_groups.remove(old)
    for socket in node.inputs:
        if socket.name in before:
            socket.default_value = before[socket.name]
    image = layer.outputs["Image"]
    shown = [link.to_socket for link in image.links if link.to_node != node]
    if not shown and not node.outputs["Image"].is_linked and not result.is_linked:
        shown = [result]
    for socket in shown:
        tree.links.new(node.outputs["Image"], socket)
    tree.links.new(image, node.inputs["Image"])
    for name in names:
        tree.links.new(layer.outputs[PREFIX + name], node.inputs[name])
    node.location, node.width = (layer.location[0] + 300.0, layer.location[1]), 240.0
    return node


def _layer(tree: Any, source: "bpy.types.Scene") -> Any:
    """The node of the source's layer, made as needed."""
    layers = [node for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers" and node.scene == source]
    if layers:
        layer = layers[0]
    else:
        layer = tree.nodes.new("CompositorNodeRLayers")
        layer.scene, layer.location = source, (-600.0, 0.0)
    # The node learns of new passes when it is told its layer.
    layer.layer = layer.layer
    return layer


def _value(socket: Any) -> Any:
    value = socket.default_value
    return value if isinstance(value, float) else tuple(value)


def _group(names: Sequence[str]) -> Any:
    tree = bpy.data.node_groups.new(GROUP, "CompositorNodeTree")
    sockets: Any = tree.interface
    sockets.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    sockets.new_socket("Image", in_out="INPUT", socket_type="NodeSocketColor")
    for name in names:
        sockets.new_socket(name, in_out="INPUT", socket_type="NodeSocketColor").hide_value = True
    for name in names:
        strength = sockets.new_socket(f"{name} {STRENGTH}", in_out="INPUT", socket_type="NodeSocketFloat")
        strength.default_value, strength.min_value = 1.0, 0.0
        strength.description = f"Factor of the strength of {name}"
        colour = sockets.new_socket(f"{name} {COLOUR}", in_out="INPUT", socket_type="NodeSocketColor")
        colour.default_value, colour.description = (1.0, 1.0, 1.0, 1.0), f"Factor of the color of {name}"
    given, found = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    shown, place = given.outputs["Image"], 1.0
    for name in names:
        own = given.outputs[name]
        scaled = own
        for factor in (given.outputs[f"{name} {STRENGTH}"], given.outputs[f"{name} {COLOUR}"]):
            scaled = _mixed(tree, "MULTIPLY", (scaled, factor), place)
            place += 1.0
        more = _mixed(tree, "SUBTRACT", (scaled, own), place)
        shown = _mixed(tree, "ADD", (shown, more), place + 1.0)
        place += 2.0
    tree.links.new(shown, found.inputs["Image"])
    found.location = SPACING * place, 0.0
    return tree


def _mixed(tree: Any, operation: str, sockets: tuple[Any, Any], place: float) -> Any:
    """Two colours in one, with the alpha of the first."""
    if FIVE:
        node = tree.nodes.new("ShaderNodeMix")
        node.data_type, node.clamp_factor, node.clamp_result = "RGBA", False, False
    else:
        node = tree.nodes.new("CompositorNodeMixRGB")
    node.blend_type, node.location = operation, (SPACING * place, 0.0)
    colours = [socket for socket in node.inputs if socket.type == "RGBA" and socket.enabled]
    factor = next(socket for socket in node.inputs if socket.type == "VALUE" and socket.enabled)
    factor.default_value = 1.0
    for socket, mixed in zip(sockets, colours):
        tree.links.new(socket, mixed)
    return next(socket for socket in node.outputs if socket.type == "RGBA" and socket.enabled)


def sliders(node: Any) -> Iterator[tuple[Any, Any]]:
    """The sockets of strength and colour of each light of a group's node."""
    sockets = list(node.inputs)
    number = (len(sockets) - 1) // 3
    for light in range(number):
        yield sockets[1 + number + 2 * light], sockets[2 + number + 2 * light]
