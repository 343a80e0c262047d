# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's own panels that are shown while this engine is chosen."""

from collections.abc import Iterator
from typing import Any

import bpy

# Panels of use to every engine that list only some.
SHARED = (
    "EEVEE_MATERIAL_PT_context_material",
    "VIEWLAYER_PT_layer_passes",
    "VIEWLAYER_PT_layer_passes_lightgroups",
    "VIEWLAYER_PT_layer_passes_cryptomatte",
    "VIEWLAYER_PT_filter",
)
# Panels that list every engine but are of no use to this one: it has its own panel for lights, and does not render
# light previews, light linking or the shading of surfaces.
USELESS = ("DATA_PT_light", "DATA_PT_spot", "DATA_PT_preview", "OBJECT_PT_shading")


def _useful_panels() -> Iterator[Any]:
    for panel in bpy.types.Panel.__subclasses__():
        # The Shader Editor's copies of panels share the originals' set of engines.
        name, engines = panel.__name__.removeprefix("NODE_"), getattr(panel, "COMPAT_ENGINES", ())
        useless = name in USELESS or "freestyle" in name
        if name in SHARED or "BLENDER_RENDER" in engines and not useless:
            yield panel


def register(engine: str) -> None:
    """Show the panels for the engine of this name."""
    for panel in _useful_panels():
        panel.COMPAT_ENGINES.add(engine)


def unregister(engine: str) -> None:
    """Undo `register`."""
    for panel in _useful_panels():
        panel.COMPAT_ENGINES.discard(engine)
