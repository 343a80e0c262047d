# SPDX-License-Identifier: GPL-3.0-or-later
"""A layer, or those of several views, as a multi-layer OpenEXR file."""

from collections.abc import Callable, Mapping

import numpy as np

from ...inference.image.layer import Layer
from .exr_file import write_exr
from .layer_frame import finite, finite_depth

# Of the channels of passes by name, and of others by their number.
LETTERS, OF_COUNT = {"Position": "XYZ"}, {1: "Z", 3: "RGB", 4: "rgba"}


def write_layer(
    path: str,
    layer: Layer,
    view_layer: str,
    metadata: Mapping[str, str | int | float],
    check: Callable[[], None] = lambda: None,
) -> None:
    """As `write_layers`, for a picture of one view."""
    write_layers(path, {"": layer}, view_layer, metadata, check)


def write_layers(
    path: str,
    layers: Mapping[str, Layer],
    view_layer: str,
    metadata: Mapping[str, str | int | float],
    check: Callable[[], None] = lambda: None,
) -> None:
    """Write Combined, Alpha, Depth, Single, Multiple, Emission, Uncertainty, light groups and the layer's other
    passes as layers of one file.

    layers: of each view, by its name; that of a file with one view is "". Channels have Blender's names
    (ViewLayer.Combined.R, ViewLayer.Combined.left.R ...), so that its compositor shows each layer as an output of an
    Image node. Colours are scene-linear and premultiplied. check: as of `write_exr`.

    Raises OSError where the file cannot be written; no partial file is left.
    """
    channels: dict[str, np.ndarray] = {}
    attributes: dict[str, str | list[str] | int | float] = {**metadata}
    for view, layer in layers.items():
        for name, values in _channels(layer).items():
            channel, letter = name.rsplit(".", 1)
            channels[".".join(filter(None, (view_layer, channel, view, letter)))] = values
    if any(layers):
        attributes["multiView"] = list(layers)
    write_exr(path, channels, attributes, check)


def _channels(layer: Layer) -> dict[str, np.ndarray]:
    """float32 (H, W) of each channel, by its name within the view layer."""
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
    for name, values in layer.passes.items():
        for index, letter in enumerate(LETTERS.get(name) or OF_COUNT[values.size // layer.alpha.size]):
            channels[f"{name}.{letter}"] = finite(values.reshape(*layer.alpha.shape, -1)[..., index])
    return channels
