# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render is asked for besides its colours."""

import bpy

from ..settings.properties import scene_settings


def wanted_outputs(scene: "bpy.types.Scene", view_layer: "bpy.types.ViewLayer") -> frozenset[str]:
    """As `Settings.outputs`."""
    wanted = {"deep": scene_settings(scene).use_deep}
    return frozenset(name for name, on in wanted.items() if on)
