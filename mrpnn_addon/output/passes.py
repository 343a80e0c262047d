"""Render passes by Cycles' names, and the view layer's switches for them: `view_layer.mrpnn`."""

from dataclasses import dataclass
from typing import Callable, List

import bpy
import numpy as np
from bpy.props import BoolProperty, PointerProperty

from ...inference.image.layer import Layer
from .layer_frame import finite_depth

# Cycles has spelt its passes out since 5.0.
DIRECT, INDIRECT, EMISSION = (
    ("Volume Direct", "Volume Indirect", "Emission") if bpy.app.version >= (5, 0, 0) else
    ("VolumeDir", "VolumeInd", "Emit"))


@dataclass
class RenderPass:
    """name, channels and kind: as RenderEngine.register_pass takes them.
    pixels: of a Layer, float32 (H, W) or (H, W, 3).
    """

    name: str
    channels: str
    kind: str
    pixels: Callable[[Layer], np.ndarray]


def extra_passes(view_layer) -> List[RenderPass]:
    """What a view layer asks for besides Combined."""
    switches = view_layer.mrpnn
    passes = [
        (view_layer.use_pass_z, RenderPass("Depth", "Z", 'VALUE', finite_depth)),
        (switches.use_pass_volume_direct, RenderPass(DIRECT, "RGB", 'COLOR', lambda layer: layer.single)),
        (switches.use_pass_volume_indirect, RenderPass(INDIRECT, "RGB", 'COLOR', lambda layer: layer.multiple)),
        (switches.use_pass_emission, RenderPass(EMISSION, "RGB", 'COLOR', lambda layer: layer.emission)),
        (switches.use_pass_uncertainty, RenderPass("Uncertainty", "X", 'VALUE', lambda layer: layer.uncertainty)),
    ]
    return [wanted for on, wanted in passes if on]


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
