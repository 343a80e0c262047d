"""Operator `mrpnn.composite`: the volumes by MRPNN over the rest of the scene by Cycles."""

import bpy
from bpy.props import BoolProperty

from ..mrpnn_addon.engine import MRPNNRenderEngine
from ..mrpnn_addon.material import shows_volume

COLLECTION = "MRPNN Volumes"
FIVE = bpy.app.version >= (5, 0, 0)
MATH = 'ShaderNodeMath' if FIVE else 'CompositorNodeMath'
BEHIND, BEFORE = ("Background", "Foreground") if FIVE else ("Image", "Image_001")


class MRPNN_OT_composite(bpy.types.Operator):
    """Render this scene in Cycles without its volumes, the volumes in a second scene with MRPNN, and put
    them together in the compositor. Volumes end at surfaces"""

    bl_idname = "mrpnn.composite"
    bl_label = "Composite over Cycles"
    bl_options = {'REGISTER', 'UNDO'}

    shadows: BoolProperty(
        name="Shadows on Surfaces", default=True,
        description="Keep the volumes in Cycles, invisible to the camera, so that they shade surfaces")

    @classmethod
    def poll(cls, context):
        return hasattr(context.scene, "cycles")

    def execute(self, context):
        scene = context.scene
        volumes = [shown for shown in scene.objects if shows_volume(shown)]
        if not volumes:
            self.report({'ERROR'}, "the scene holds no Volume object; add one (Add > Volume > Import OpenVDB)")
            return {'CANCELLED'}
        name = f"{scene.name} MRPNN"
        if name in bpy.data.scenes:
            self.report({'ERROR'}, f"there is a scene \"{name}\" already; delete it to build it again")
            return {'CANCELLED'}
        collection = _collect(scene, volumes)
        layered = _volume_scene(scene, name)
        scene.render.engine = 'CYCLES'
        for view_layer in scene.view_layers:
            view_layer.use_pass_z = True
            child = view_layer.layer_collection.children[collection.name]
            child.indirect_only = self.shadows
            child.exclude = not self.shadows
        _build_nodes(scene, layered)
        self.report({'INFO'}, f"F12 renders the volumes of scene \"{name}\" over this one")
        return {'FINISHED'}


def _collect(scene, volumes):
    """A collection of the scene that alone holds its volumes."""
    collection = bpy.data.collections.new(COLLECTION)
    scene.collection.children.link(collection)
    for volume in volumes:
        for other in volume.users_collection:
            other.objects.unlink(volume)
        collection.objects.link(volume)
    return collection


def _volume_scene(scene, name: str):
    """A scene of the same collections and settings, rendered by MRPNN on a transparent film."""
    layered = scene.copy()
    layered.name = name
    layered.render.engine = MRPNNRenderEngine.bl_idname
    layered.render.film_transparent = True
    layered.render.use_compositing = layered.render.use_sequencer = False
    for view_layer in layered.view_layers[1:]:
        layered.view_layers.remove(view_layer)
    layered.view_layers[0].use_pass_z = True
    return layered


def _build_nodes(scene, layered) -> None:
    """Put the volumes between what the compositor shows so far and its output."""
    tree, result = _compositor(scene)
    nodes, links = tree.nodes, tree.links
    surfaces = nodes.new('CompositorNodeRLayers')
    surfaces.scene, surfaces.label = scene, "Surfaces by Cycles"
    volumes = nodes.new('CompositorNodeRLayers')
    volumes.scene, volumes.label = layered, "Volumes by MRPNN"
    over = nodes.new('CompositorNodeAlphaOver')
    shown = result.links[0].from_socket if result.is_linked else surfaces.outputs["Image"]
    sockets = {socket.identifier: socket for socket in over.inputs}
    if scene.camera is not None and scene.camera.data.type == 'PANO':
        _compare_depths(tree, surfaces, volumes, sockets["Fac"])
    links.new(shown, sockets[BEHIND])
    links.new(volumes.outputs["Image"], sockets[BEFORE])
    links.new(over.outputs["Image"], result)
    scene.render.use_compositing = True
    for node, place in ((surfaces, (-600, 200)), (volumes, (-600, -200)), (over, (0, 100))):
        node.location = place


def _compare_depths(tree, surfaces, volumes, factor) -> None:
    """Show volumes only where they lie before surfaces: in panoramas they do not end at them."""
    nearer = tree.nodes.new(MATH)
    nearer.operation, nearer.label, nearer.location = 'LESS_THAN', "Volume before surface", (-250, 0)
    tree.links.new(volumes.outputs["Depth"], nearer.inputs[0])
    tree.links.new(surfaces.outputs["Depth"], nearer.inputs[1])
    tree.links.new(nearer.outputs[0], factor)


def _compositor(scene):
    """The scene's compositor tree, made if need be, and the socket that its result is linked to."""
    if not FIVE:
        scene.use_nodes = True
        tree = scene.node_tree
        output = next((node for node in tree.nodes if node.bl_idname == 'CompositorNodeComposite'), None)
        output = output or tree.nodes.new('CompositorNodeComposite')
        return tree, output.inputs["Image"]
    tree = scene.compositing_node_group
    if tree is None:
        tree = scene.compositing_node_group = bpy.data.node_groups.new("Compositor", 'CompositorNodeTree')
        tree.interface.new_socket("Image", in_out='OUTPUT', socket_type='NodeSocketColor')
    output = next((node for node in tree.nodes if node.bl_idname == 'NodeGroupOutput' and node.is_active_output), None)
    output = output or tree.nodes.new('NodeGroupOutput')
    return tree, output.inputs[0]


classes = (MRPNN_OT_composite,)
