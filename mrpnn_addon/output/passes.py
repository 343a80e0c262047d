# SPDX-License-Identifier: GPL-3.0-or-later
"""Render passes of a view layer, by Cycles' names."""

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import bpy
import numpy as np

from ...inference.image.layer import Layer
from ..scene.light_groups import lone_lights
from ..scene.outputs import pass_channels
from ..settings.view_layer import pass_settings
from .layer_frame import finite, finite_depth

# Cycles abbreviates pass names before 5.0.
DIRECT, INDIRECT, EMISSION = (
    ("Volume Direct", "Volume Indirect", "Emission")
    if bpy.app.version >= (5, 0, 0)
    else ("VolumeDir", "VolumeInd", "Emit")
)


@dataclass
class RenderPass:
    """name, channels, kind: arguments of RenderEngine.register_pass. pixels: function from a Layer to float32 (H, W) or
    (H, W, 3).
    """

    name: str
    channels: str
    kind: Literal["VALUE", "VECTOR", "COLOR"]
    pixels: Callable[[Layer], np.ndarray]


def extra_passes(scene: "bpy.types.Scene", view_layer: "bpy.types.ViewLayer") -> list[RenderPass]:
    """Passes that a view layer of a scene requests besides Combined."""
    switches = pass_settings(view_layer)
    passes = [
        (view_layer.use_pass_z, RenderPass("Depth", "Z", "VALUE", finite_depth)),
        (switches.use_pass_volume_direct, RenderPass(DIRECT, "RGB", "COLOR", lambda layer: layer.single)),
        (switches.use_pass_volume_indirect, RenderPass(INDIRECT, "RGB", "COLOR", lambda layer: layer.multiple)),
        (switches.use_pass_emission, RenderPass(EMISSION, "RGB", "COLOR", lambda layer: layer.emission)),
        (switches.use_pass_uncertainty, RenderPass("Uncertainty", "X", "VALUE", lambda layer: layer.uncertainty)),
    ]
    groups = [
        RenderPass(f"Combined_{name}", "RGB", "COLOR", functools.partial(_of_group, name=name))
        for name in light_names(scene, view_layer)
    ]
    kinds: dict[str, Literal["VALUE", "VECTOR", "COLOR"]] = {"Z": "VALUE", "XYZ": "VECTOR"}
    others = [
        RenderPass(name, letters, kinds.get(letters, "COLOR"), functools.partial(_pass, name=name, count=len(letters)))
        for name, letters in pass_channels(view_layer).items()
    ]
    return [wanted for on, wanted in passes if on] + groups + others


def light_names(scene: "bpy.types.Scene", view_layer: "bpy.types.ViewLayer") -> list[str]:
    """Names of the light groups and the lights that have a pass each."""
    return [*(group.name for group in view_layer.lightgroups), *lone_lights(scene, view_layer).values()]


def _of_group(layer: Layer, name: str) -> np.ndarray:
    return layer.groups.get(name, np.zeros_like(layer.rgb))


def _pass(layer: Layer, name: str, count: int) -> np.ndarray:
    nothing = np.zeros((*layer.alpha.shape, count), np.float32)
    return finite(layer.passes.get(name, nothing))
