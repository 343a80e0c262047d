# SPDX-License-Identifier: GPL-3.0-or-later
"""What EEVEE does not show of a scene with baked light. Cycles shows all of it."""

from typing import Any

import bpy

from ..objects.visibility import VisibleObject, visible_objects
from ..world.lighting import lights_volumes
from .recommendation import is_surface, surroundings


def lacking(depsgraph: "bpy.types.Depsgraph") -> str:
    """A sentence for the panel; "" where nothing is missing, or the engine is another."""
    scene: Any = depsgraph.scene
    if "EEVEE" not in scene.render.engine:
        return ""
    shown = list(visible_objects(depsgraph))
    surfaces = [one for one in shown if is_surface(one)]
    missing = []
    if scene.camera is not None and scene.camera.data.type == "PANO":
        missing.append("panoramic cameras")
    if any(surroundings(one) for one in surfaces):
        missing.append("volumes in mirrors and glass")
    if surfaces and any(map(_is_light, shown)):
        missing.append("shadows of volumes on surfaces")
    if lights_volumes(scene.world):
        missing.append("shadows in the World's light")
    if not scene.eevee.use_volumetric_shadows and any(map(_is_light, shown)):
        missing.append("shadows within volumes (turn on Sampling > Shadows > Volume Shadows)")
    return f"EEVEE still lacks {', '.join(missing)}" if missing else ""


def _is_light(shown: VisibleObject) -> bool:
    return bool(shown.object.type == "LIGHT" and shown.visible_to("volume_scatter"))
