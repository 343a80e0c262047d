# SPDX-License-Identifier: GPL-3.0-or-later
"""EXR files that Blender or the extension wrote, read with OpenEXR.

Import it after bpy, whose compiled libraries must come first.
"""

import numpy as np
import OpenEXR


def channels(path):
    """All channels; from 5.0 on Blender writes a part for each pass."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for part in file.parts for name, channel in part.channels.items()}


def combined(path, view_layer="ViewLayer."):
    found = channels(path)
    return np.stack([found[f"{view_layer}Combined.{c}"] for c in "RGBA"], axis=-1)


def header(path):
    """Attributes of the first part."""
    with OpenEXR.File(str(path)) as file:
        return dict(file.header())
