"""What a scene shows and this engine does not, in a line for the panel and the viewport."""

from dataclasses import dataclass, field
from typing import List

from ..nodes.material import SURFACES, shows_volume
from ..objects.visibility import shown_objects

RENDERED_LIGHTS = {'SUN'}


@dataclass
class Unrendered:
    """Names of objects and instances: lights that are left out, and surfaces that only hide and shade volumes."""

    lights: List[str] = field(default_factory=list)
    surfaces: List[str] = field(default_factory=list)

    @property
    def lines(self) -> List[str]:
        """A line for each kind, none where there is nothing to say."""
        found = []
        if self.lights:
            found.append(f"Left out: {_names(self.lights, 'light')}. Only suns and the World light volumes")
        if self.surfaces:
            found.append(f"Not rendered: {_names(self.surfaces, 'surface')}. Surfaces only hide and shade volumes")
        return found

    @property
    def summary(self) -> str:
        """All of it in a few words, or ""."""
        found = [_names(self.lights, "light")] if self.lights else []
        found += [_names(self.surfaces, "surface")] if self.surfaces else []
        return f"Not rendered: {', '.join(found)}" if found else ""

    @property
    def message(self) -> str:
        """`summary`, and what to do about it."""
        more = "; Composite over Cycles in the render properties renders surfaces, too" if self.surfaces else ""
        return self.summary + more

    def names(self, text: str) -> bool:
        """Whether a text is about one of them."""
        return any(f"\"{name}\"" in text for name in (*self.lights, *self.surfaces))


def composited(scene) -> bool:
    """Whether Cycles renders the scene's surfaces: it is the one that Composite over Cycles has made for the volumes."""
    return scene.mrpnn_composite.surfaces is not None


def unrendered(depsgraph) -> Unrendered:
    """Look through the objects that renders show; reads no volume and no mesh."""
    found = Unrendered()
    for shown in shown_objects(depsgraph):
        kind = shown.object.type
        if kind == 'LIGHT' and shown.object.data.type not in RENDERED_LIGHTS:
            found.lights.append(shown.name)
        elif kind in SURFACES and not shows_volume(shown.object):
            found.surfaces.append(shown.name)
    return found


def _names(names: List[str], noun: str) -> str:
    """light "Lamp", or 3 lights."""
    return f"{noun} \"{names[0]}\"" if len(names) == 1 else f"{len(names)} {noun}s"
