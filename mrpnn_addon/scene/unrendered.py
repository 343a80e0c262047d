# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that a scene shows and this engine does not render, for the panel and the viewport."""

from dataclasses import dataclass, field

import bpy

from ..nodes.material import MESHES, SURFACES, shows_volume
from ..objects.surfaces import OWN_FOG, hides_own_fog
from ..objects.visibility import visible_objects


@dataclass
class Unrendered:
    """Names of objects and instances: surfaces that only hide and shade volumes; filled: those with fog inside."""

    surfaces: list[str] = field(default_factory=list)
    filled: list[str] = field(default_factory=list)

    @property
    def fog(self) -> str:
        """What shows the fog of the first surface that hides its own, or ""."""
        return f'"{self.filled[0]}" {OWN_FOG}' if self.filled else ""

    @property
    def sentence(self) -> str:
        """What they are for here, or ""."""
        if not self.surfaces:
            return ""
        does = "hides, shades and lights" if len(self.surfaces) == 1 else "hide, shade and light"
        return f"{self.summary}, which only {does} volumes"

    @property
    def summary(self) -> str:
        """All in a few words, or ""."""
        return f"Not rendered: {_names(self.surfaces, 'surface')}" if self.surfaces else ""

    def names(self, text: str) -> bool:
        """Whether a text mentions one of them."""
        return any(f'"{name}"' in text for name in self.surfaces)

    def told_last(self, warnings: list[str]) -> list[str]:
        """A render's warnings, those of the surfaces last: Blender's window shows the last report only."""
        named = [warning for warning in warnings if self.names(warning)]
        others = [warning for warning in warnings if not self.names(warning)]
        if not named and self.surfaces:
            named = [f"{self.sentence}; Composite over Cycles renders surfaces, too"]
        return others + named


def composited(scene: "bpy.types.Scene") -> bool:
    """Whether Cycles renders the scene's surfaces: Composite over Cycles made the scene for their volumes."""
    return scene.path_resolve("mrpnn_composite").surfaces is not None


def in_composite(scene: "bpy.types.Scene") -> bool:
    """Whether F12 shows the scene's surfaces together with its volumes."""
    return composited(scene) or scene.path_resolve("mrpnn_composite").active


def unrendered(depsgraph: "bpy.types.Depsgraph") -> Unrendered:
    """Search the objects that renders show, without reading volumes or meshes."""
    found = Unrendered()
    for shown in visible_objects(depsgraph):
        kind = shown.object.type
        if kind in SURFACES and not shows_volume(shown.object):
            found.surfaces.append(shown.name)
            if kind in MESHES and hides_own_fog(shown.object):
                found.filled.append(shown.name)
    return found


def _names(names: list[str], noun: str) -> str:
    """light "Lamp", or 3 lights."""
    return f'{noun} "{names[0]}"' if len(names) == 1 else f"{len(names)} {noun}s"
