"""Values of node sockets, where they can be known without running the shader."""

from typing import Optional, Tuple

import bpy


class Unsupported(Exception):
    """A node or link that cannot be evaluated here; the message names it."""


def active_output(block):
    """The output node that Cycles uses of a material, World or light; None without nodes."""
    # From 5.0 on materials and Worlds always use their nodes, and asking for it warns.
    always = bpy.app.version >= (5, 0, 0) and not isinstance(block, bpy.types.Light)
    if not (always or block.use_nodes) or block.node_tree is None:
        return None
    return block.node_tree.get_output_node('CYCLES')


def linked_node(socket):
    """The node linked to an input socket, past reroutes; None where there is none.

    Raises Unsupported for a muted node, whose meaning depends on its internal links.
    """
    return _source(socket)[0]


def _source(socket):
    while socket.is_linked:
        link = socket.links[0]
        if link.is_muted or not link.is_valid:
            break
        node = link.from_node
        if node.mute:
            raise Unsupported(f"node \"{node.name}\" is muted; delete it or turn it on")
        if node.bl_idname != 'NodeReroute':
            return node, link.from_socket
        socket = node.inputs[0]
    return None, None


def constant(socket, node):
    """The socket's value: a number, a string or an RGBA tuple.

    Raises Unsupported where something other than a Value or RGB node is linked.
    """
    source, output = _source(socket)
    if source is None:
        return _value(socket)
    if source.bl_idname in ('ShaderNodeValue', 'ShaderNodeRGB'):
        value = _value(output)
        # A number linked to a colour is grey; a colour linked to a number would need its luminance.
        if isinstance(value, tuple) == isinstance(_value(socket), tuple):
            return value
        if not isinstance(value, tuple):
            return (value, value, value, 1.0)
    raise Unsupported(f"node \"{source.name}\" linked to {socket.name} of \"{node.name}\" is not supported; "
                      "unlink it and enter a value")


def _value(socket):
    value = socket.default_value
    return value if isinstance(value, (int, float, str)) else tuple(value)


def density_input(socket, node) -> Tuple[Optional[str], float]:
    """(grid name or None, factor) of a Density socket.

    Understands a plain value, the Fac of an Attribute node, the Density of Volume Info, and one
    Math node that multiplies either by a value.

    Raises Unsupported for everything else.
    """
    source, output = _source(socket)
    if source is None or source.bl_idname == 'ShaderNodeValue':
        return None, constant(socket, node)
    if source.bl_idname == 'ShaderNodeMath' and source.operation == 'MULTIPLY' and not source.use_clamp:
        return _product(source)
    return _grid_output(source, output), 1.0


def _product(math) -> Tuple[str, float]:
    first, second = math.inputs[0], math.inputs[1]
    for grid_socket, factor_socket in ((first, second), (second, first)):
        source, output = _source(grid_socket)
        if source is not None and source.bl_idname != 'ShaderNodeValue':
            return _grid_output(source, output), constant(factor_socket, math)
    raise Unsupported(f"node \"{math.name}\" multiplies no grid; link Volume Info or Attribute to it")


def _grid_output(node, output) -> str:
    if node.bl_idname == 'ShaderNodeVolumeInfo' and output.identifier == 'Density':
        return "density"
    if node.bl_idname == 'ShaderNodeAttribute' and output.identifier == 'Fac' and node.attribute_type == 'GEOMETRY':
        return node.attribute_name
    raise Unsupported(f"output {output.name} of node \"{node.name}\" is not supported as density; "
                      "use the Density of Volume Info or the Fac of a geometry Attribute")
