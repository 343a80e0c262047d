# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials with a single shader, for the scenes of the benchmarks."""

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
