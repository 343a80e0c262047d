# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that a scene shows and this engine does not render, for the panel and the viewport."""

from dataclasses import dataclass, field

import bpy

from ..nodes.material import SURFACES, shows_volume
from ..objects.visibility import visible_objects


@dataclass
class Unrendered:
    """Names of objects and instances: surfaces that only hide and shade volumes."""

    surfaces: list[str] = field(default_factory=list)

    @property
    def lines(self) -> list[str]:
        """One line per kind; none without objects."""
        found = []
        if self.surfaces:
            found.append(f"Not rendered: {_names(self.surfaces, 'surface')}. Surfaces only hide and shade volumes")
        return found

    @property
    def summary(self) -> str:
        """All in a few words, or ""."""
        found = [_names(self.surfaces, "surface")] if self.surfaces else []
        return f"Not rendered: {', '.join(found)}" if found else ""

    @property
    def message(self) -> str:
        """`summary`, with a remedy."""
        more = "; Composite over Cycles in the render properties renders surfaces, too" if self.surfaces else ""
        return self.summary + more

    def names(self, text: str) -> bool:
        """Whether a text mentions one of them."""
        return any(f'"{name}"' in text for name in self.surfaces)


def composited(scene: "bpy.types.Scene") -> bool:
    """Whether Cycles renders the scene's surfaces: Composite over Cycles made the scene for their volumes."""
    return scene.path_resolve("mrpnn_composite").surfaces is not None


def unrendered(depsgraph: "bpy.types.Depsgraph") -> Unrendered:
    """Search the objects that renders show, without reading volumes or meshes."""
    found = Unrendered()
    for shown in visible_objects(depsgraph):
        kind = shown.object.type
        if kind in SURFACES and not shows_volume(shown.object):
            found.surfaces.append(shown.name)
    return found


def _names(names: list[str], noun: str) -> str:
    """light "Lamp", or 3 lights."""
    return f'{noun} "{names[0]}"' if len(names) == 1 else f"{len(names)} {noun}s"
