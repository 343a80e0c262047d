# SPDX-License-Identifier: GPL-3.0-or-later
"""A layer as a multi-layer OpenEXR file."""

from ...inference.image.layer import Layer
from .exr_file import write_exr
from .layer_frame import finite_depth


def write_layer(
    path: str, layer: Layer, view_layer: str, metadata: dict[str, str | int | float], check=lambda: None
) -> None:
    """Write Combined, Alpha, Depth, Single, Multiple, Emission, Uncertainty and light groups as layers of one file.

    Channels have Blender's names (ViewLayer.Combined.R ...), so that its compositor shows each layer as an output of an
    Image node. Colours are scene-linear and premultiplied. check: as of `write_exr`.

    Raises OSError where the file cannot be written; no partial file is left.
    """
    channels = {
        "Combined.A": layer.alpha,
        "Alpha.A": layer.alpha,
        "Depth.Z": finite_depth(layer),
        "Uncertainty.X": layer.uncertainty,
    }
    for name, colour in (
        ("Combined", layer.rgb),
        ("Single", layer.single),
        ("Multiple", layer.multiple),
        ("Emission", layer.emission),
        *((f"Combined_{name}", rgb) for name, rgb in layer.groups.items()),
    ):
        for index, letter in enumerate("RGB"):
            channels[f"{name}.{letter}"] = colour[..., index]
    write_exr(path, {f"{view_layer}.{name}": values for name, values in channels.items()}, metadata, check)
