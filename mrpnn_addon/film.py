"""What a render shows behind the layer where the film is not transparent."""

from typing import List, Tuple

import bpy
import numpy as np

from .layer_frame import rgba
from .node_values import constant
from .sockets import Unsupported, active_output, linked_node
from .visibility import evaluated_world


def background(depsgraph) -> Tuple[np.ndarray, List[str]]:
    """The World's own colour as the camera sees it, float32 (3,), and warnings.

    Only a constant Background is shown. An image or a sky is black, with a warning.
    """
    black = np.zeros(3, np.float32)
    world = evaluated_world(depsgraph)
    if world is None or not _seen_by_camera(world):
        return black, []
    output = active_output(world)
    if output is None:
        # Without nodes, Blender before 5.0 shows the World's own colour.
        return (black if bpy.app.version >= (5, 0, 0) else np.array(world.color, np.float32)), []
    try:
        node = linked_node(output.inputs['Surface'])
        if node is None:
            return black, []
        if node.bl_idname != 'ShaderNodeBackground':
            raise Unsupported(f"node \"{node.name}\" is not supported")
        colour = constant(node.inputs['Strength']) * constant(node.inputs['Color'])
        return colour.astype(np.float32), []
    except Unsupported as problem:
        return black, [f"World \"{world.name}\": {problem}, so the background is black; "
                       "turn on Film > Transparent to put the layer over your own"]


def _seen_by_camera(world) -> bool:
    # Cycles' own properties, gone while Cycles is disabled.
    visibility = getattr(world, 'cycles_visibility', None)
    return visibility is None or visibility.camera


def on_background(layer, colour: np.ndarray) -> np.ndarray:
    """float32 (H, W, 4): the layer over a colour (3,), with alpha 1."""
    image = rgba(layer)
    image[..., :3] += (1.0 - image[..., 3:]) * colour
    image[..., 3] = 1.0
    return image
