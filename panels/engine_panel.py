# SPDX-License-Identifier: GPL-3.0-or-later
"""Base of this engine's panels in Blender's own tabs."""

from typing import Any

import bpy
from bpy_extras.node_utils import find_node_input

from ..mrpnn_addon.engine.engine import MRPNNRenderEngine
from ..mrpnn_addon.nodes.sockets import active_output, always_has_nodes, has_nodes


class EnginePanel:
    """A panel of the properties editor, shown while the engine is chosen."""

    bl_space_type: Any = "PROPERTIES"
    bl_region_type: Any = "WINDOW"

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return context.engine == MRPNNRenderEngine.bl_idname


def draw_shader(layout: "bpy.types.UILayout", block: Any, name: str, colour: str = "") -> None:
    """Draw the shader at an input of the output that is rendered, of a material, World or light.

    colour: the property that holds the colour without nodes, or "".
    """
    layout.use_property_split = True
    # Every block has a surface: draw the switch once.
    if name == "Surface" and not always_has_nodes(block):
        layout.prop(block, "use_nodes", icon="NODETREE")
    output = active_output(block)
    if output is not None:
        layout.template_node_view(block.node_tree, output, find_node_input(output, name))
    elif has_nodes(block):
        layout.label(text="No output node")
    elif colour:
        layout.prop(block, colour, text="Color")
