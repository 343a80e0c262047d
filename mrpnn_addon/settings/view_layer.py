"""Render passes that a view layer can ask for: `view_layer.mrpnn`."""

import bpy
from bpy.props import BoolProperty, PointerProperty


class MRPNN_PG_view_layer(bpy.types.PropertyGroup):
    use_pass_volume_direct: BoolProperty(
        name="Volume Direct", description="Light scattered once; with Volume Indirect and Emission it is Combined")
    use_pass_volume_indirect: BoolProperty(
        name="Volume Indirect", description="Light scattered more than once, which the network predicts, and "
        "what volumes scatter of their own light")
    use_pass_emission: BoolProperty(
        name="Emission", description="Light that volumes emit, dimmed by what lies before it and not scattered")
    use_pass_uncertainty: BoolProperty(
        name="Uncertainty", description="Standard error of Volume Indirect from the choice of depths along each ray; "
        "more depth samples lower it. The network's own error is not in it")


def register():
    bpy.utils.register_class(MRPNN_PG_view_layer)
    bpy.types.ViewLayer.mrpnn = PointerProperty(type=MRPNN_PG_view_layer)


def unregister():
    del bpy.types.ViewLayer.mrpnn
    bpy.utils.unregister_class(MRPNN_PG_view_layer)
