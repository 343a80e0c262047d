# SPDX-License-Identifier: GPL-3.0-or-later
"""The compositor nodes that lay the volumes' scene over a scene."""

from typing import Any

import bpy

FIVE = bpy.app.version >= (5, 0, 0)
MATH = "ShaderNodeMath" if FIVE else "CompositorNodeMath"
BACKGROUND, FOREGROUND = ("Background", "Foreground") if FIVE else ("Image", "Image_001")
# Nodes of a compositor that shows the scene unchanged; before 5.0 Blender creates one by default.
BARE = (
    {"NodeGroupOutput"}
    if FIVE
    else {"CompositorNodeComposite", "CompositorNodeRLayers", "CompositorNodeViewer", "NodeReroute"}
)
# Custom property with the role of each of these nodes.
MARK = "mrpnn_composite"
LOCATIONS = {
    "relight": (-300, -200),
    "surfaces": (-600, 200),
    "volumes": (-600, -200),
    "over": (0, 100),
    "nearer": (-250, 0),
}
TITLES = {
    "surfaces": "Surfaces by Cycles",
    "volumes": "Volumes by MRPNN",
    "over": "Volumes over Surfaces",
    "nearer": "Volume before surface",
    "relight": "Lights of the Volumes",
}


def build_nodes(scene: "bpy.types.Scene", volumes: "bpy.types.Scene") -> bool:
    """Insert the volumes before the compositor's output, or repair the nodes.

    Returns whether the scene had no compositor before.
    """
    made = _tree(scene) is None
    tree, result = compositor(scene)
    layer = node_of_role(tree, "volumes", "CompositorNodeRLayers")
    over = node_of_role(tree, "over", "CompositorNodeAlphaOver")
    # Before the node is told, which then offers the depth.
    volumes.view_layers[0].use_pass_z = True
    layer.scene, layer.layer = volumes, volumes.view_layers[0].name
    layer.mute = over.mute = False
    sockets = _sockets(over)
    if not _upstream(result, over):
        if result.is_linked:
            tree.links.new(result.links[0].from_socket, sockets[BACKGROUND])
        tree.links.new(over.outputs["Image"], result)
    if not sockets[BACKGROUND].is_linked:
        tree.links.new(_surfaces(tree, scene).outputs["Image"], sockets[BACKGROUND])
    tree.links.new(layer.outputs["Image"], sockets[FOREGROUND])
    _remove(tree, "nearer")
    if _panorama(scene):
        _compare_depths(tree, _surfaces(tree, scene), layer, sockets["Fac"])
    return made


def remove_nodes(scene: "bpy.types.Scene", made: bool) -> None:
    """Remove the nodes of `build_nodes`. made: its result."""
    tree = _tree(scene)
    if tree is None:
        return
    over, surfaces = _found(tree, "over"), _found(tree, "surfaces")
    if over is not None:
        behind = _sockets(over)[BACKGROUND]
        source = behind.links[0].from_socket if behind.is_linked else None
        for link in list(over.outputs["Image"].links):
            if source is not None and source.node != surfaces:
                tree.links.new(source, link.to_socket)
    for role in ("over", "nearer", "volumes"):
        _remove(tree, role)
    if surfaces is not None and not any(socket.is_linked for socket in surfaces.outputs):
        tree.nodes.remove(surfaces)
    # Keep a compositor with other nodes.
    if made and {node.bl_idname for node in tree.nodes} <= BARE:
        if FIVE:
            settings: Any = scene
            settings.compositing_node_group = None
            bpy.data.node_groups.remove(tree)
        else:
            scene.use_nodes = False


def compositor_problems(scene: "bpy.types.Scene", volumes: "bpy.types.Scene") -> list[str]:
    """Reasons why the compositor's output does not show the volumes as it should."""
    tree = _tree(scene)
    if tree is None:
        return ["The compositor does not use nodes"]
    layer, over, output = _found(tree, "volumes"), _found(tree, "over"), _output(tree)
    if layer is None or over is None or output is None or not _upstream(output.inputs[0], over):
        return ["The compositor's output does not show the volumes"]
    sockets, found = _sockets(over), []
    if layer.mute or over.mute or not _upstream(sockets[FOREGROUND], layer):
        found.append("The compositor's output does not show the volumes")
    if not sockets[BACKGROUND].is_linked:
        found.append("The compositor's output does not show the surfaces")
    if volumes is not None and layer.scene != volumes:
        found.append(f'The compositor shows the volumes of another scene than "{volumes.name}"')
    if (_found(tree, "nearer") is None) == _panorama(scene):
        found.append("The camera is a panorama now" if _panorama(scene) else "The camera is no longer a panorama")
    return found


def _panorama(scene: "bpy.types.Scene") -> bool:
    """Whether the camera is a panorama, in which surfaces do not hide volumes."""
    lens: Any = scene.camera and scene.camera.data
    return isinstance(lens, bpy.types.Camera) and lens.type == "PANO"


def _compare_depths(tree: Any, surfaces: Any, volumes: Any, factor: Any) -> None:
    """Show volumes only where they are in front of surfaces."""
    surfaces.scene.view_layers[surfaces.layer].use_pass_z = True
    nearer = node_of_role(tree, "nearer", MATH)
    nearer.operation = "LESS_THAN"
    tree.links.new(volumes.outputs["Depth"], nearer.inputs[0])
    tree.links.new(surfaces.outputs["Depth"], nearer.inputs[1])
    tree.links.new(nearer.outputs[0], factor)


def _surfaces(tree: Any, scene: "bpy.types.Scene") -> Any:
    node = node_of_role(tree, "surfaces", "CompositorNodeRLayers")
    if node.scene != scene:
        node.scene = scene
    return node


def _sockets(node: Any) -> dict[str, Any]:
    return {socket.identifier: socket for socket in node.inputs}


def _found(tree: Any, role: str) -> Any:
    return next((node for node in tree.nodes if node.get(MARK) == role), None)


def node_of_role(tree: Any, role: str, kind: str) -> Any:
    """The tree's node of this role, created as needed."""
    node = _found(tree, role)
    if node is None:
        node = tree.nodes.new(kind)
        node[MARK], node.label, node.location = role, TITLES[role], LOCATIONS[role]
    return node


def _remove(tree: Any, role: str) -> None:
    node = _found(tree, role)
    if node is not None:
        tree.nodes.remove(node)


def _upstream(socket: Any, sought: Any) -> bool:
    """Whether a node contributes to a socket."""
    ahead, seen = [socket], set()
    while ahead:
        for link in ahead.pop().links:
            node = link.from_node
            if node == sought:
                return True
            if node.name not in seen:
                seen.add(node.name)
                ahead += node.inputs
    return False


def _tree(scene: "bpy.types.Scene") -> Any:
    """The compositor's nodes; None where it uses none."""
    if FIVE:
        settings: Any = scene
        return settings.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def _output(tree: Any) -> Any:
    if not FIVE:
        return next((node for node in tree.nodes if node.bl_idname == "CompositorNodeComposite"), None)
    outputs = [node for node in tree.nodes if node.bl_idname == "NodeGroupOutput"]
    return next((node for node in outputs if node.is_active_output), None)


def compositor(scene: "bpy.types.Scene") -> tuple[Any, Any]:
    """The scene's compositor tree, created as needed, and the input socket of its output."""
    if not FIVE:
        scene.use_nodes = True
        nodes = scene.node_tree
        output = _output(nodes) or nodes.nodes.new("CompositorNodeComposite")
        return nodes, output.inputs["Image"]
    settings: Any = scene
    tree = settings.compositing_node_group
    if tree is None:
        tree = settings.compositing_node_group = bpy.data.node_groups.new("Compositor", "CompositorNodeTree")
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    output = _output(tree) or tree.nodes.new("NodeGroupOutput")
    return tree, output.inputs[0]
