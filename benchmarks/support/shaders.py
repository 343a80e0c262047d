# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials with a single shader, and skies, for the scenes of the benchmarks."""

import bpy


def add_shader(data, name: str, kind: str, socket: str = "Volume"):
    """A material of one shader node, linked to a socket of its output, on a mesh or volume; gives the node."""
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new(f"ShaderNode{kind}")
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[socket])
    data.materials.append(material)
    return shader


def add_sky(world, colour, heights, radiance) -> None:
    """Have a World of nodes shine in one colour (3,), as strongly as radiance (at the lower, at the upper height).

    heights: lower and upper one, of directions' z; linear between them, constant beyond.
    """
    tree = world.node_tree
    background = tree.nodes["Background"]
    background.inputs["Color"].default_value = (*colour, 1.0)
    place, parts, strength = (tree.nodes.new(f"ShaderNode{name}") for name in ("TexCoord", "SeparateXYZ", "MapRange"))
    tree.links.new(place.outputs["Generated"], parts.inputs[0])
    tree.links.new(parts.outputs["Z"], strength.inputs["Value"])
    for name, value in zip(("From Min", "From Max", "To Min", "To Max"), (*heights, *radiance)):
        strength.inputs[name].default_value = value
    tree.links.new(strength.outputs[0], background.inputs["Strength"])
