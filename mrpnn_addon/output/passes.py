"""Render passes of a view layer, by Cycles' names."""

from dataclasses import dataclass
from typing import Callable, List

import bpy
import numpy as np

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
