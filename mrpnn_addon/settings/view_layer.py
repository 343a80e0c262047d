# SPDX-License-Identifier: GPL-3.0-or-later
"""Render passes of a view layer: `view_layer.mrpnn`."""

from typing import Any

import bpy
from bpy.props import BoolProperty, PointerProperty


class MRPNN_PG_view_layer(bpy.types.PropertyGroup):
    use_pass_volume_direct: BoolProperty(
        name="Volume Direct",
        description="Single scattering. Combined is the sum of Volume Direct, Volume Indirect and Emission",
    )
    use_pass_volume_indirect: BoolProperty(
        name="Volume Indirect", description="Multiple scattering, predicted by the network, and scattered emission"
    )
    use_pass_emission: BoolProperty(
        name="Emission", description="Light that volumes emit, attenuated but not scattered on its way to the camera"
    )
    use_pass_uncertainty: BoolProperty(
        name="Uncertainty",
        description="Expected error of Combined: its standard deviation, averaged over the color channels. More depth "
        "samples lower it",
    )
    use_pass_median_depth: BoolProperty(
        name="Median Depth",
        description="Distance along the ray at which half of the opacity of the volumes is in front. The pass Position "
        "holds the point there",
    )
    use_pass_lights: BoolProperty(
        name="Each Light",
        description="A pass for the World and for each light that is in no light group. Each pass adds to the render "
        "time",
    )


def pass_settings(view_layer: "bpy.types.ViewLayer") -> MRPNN_PG_view_layer:
    """`view_layer.mrpnn`, which the types of bpy do not have."""
    return view_layer.path_resolve("mrpnn")


def register() -> None:
    bpy.utils.register_class(MRPNN_PG_view_layer)
    view_layer: Any = bpy.types.ViewLayer
    view_layer.mrpnn = PointerProperty(type=MRPNN_PG_view_layer)


def unregister() -> None:
    view_layer: Any = bpy.types.ViewLayer
    del view_layer.mrpnn
    bpy.utils.unregister_class(MRPNN_PG_view_layer)
