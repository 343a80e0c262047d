# SPDX-License-Identifier: GPL-3.0-or-later
"""Light groups: the lights of a view layer by the names of their groups, and the light of each."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from ...inference.image.layer import Layer
from ...inference.image.predicted_error import expected_error
from ...inference.scene import Medium, Surface, Volume
from ..objects.animation import with_instanced
from ..objects.visibility import render_objects
from ..settings.view_layer import pass_settings

if TYPE_CHECKING:
    from .reader import SceneDescription


def lone_lights(scene: "bpy.types.Scene", view_layer: "bpy.types.ViewLayer") -> dict[str, str]:
    """Names of the passes of lights in no light group by the names of their objects, and of the World; empty where the
    view layer asks for none.
    """
    if not pass_settings(view_layer).use_pass_lights:
        return {}
    groups = {group.name for group in view_layer.lightgroups}
    lights: list[Any] = [one for one in with_instanced(render_objects(view_layer)) if one.type == "LIGHT"]
    if scene.world is not None and view_layer.use_sky:
        lights.append(scene.world)
    names = sorted({one.name for one in lights if one.lightgroup not in groups})
    return {name: f"{name} (light)" if name in groups else name for name in names}


@dataclass
class LightGroups:
    """names: of the view layer's light groups; empty where there are none. What is in none of them is in "".

    lone: names of groups of a single light, which are among them, by the name of its object or of the World.
    """

    names: list[str] = field(default_factory=list)
    lone: dict[str, str] = field(default_factory=dict)
    _groups: dict[int, str] = field(default_factory=dict)

    def add(self, shining: list, *groups: str) -> None:
        """Lights, volumes or meshes, and names of the group that they are in, of which the first that is one counts."""
        group = next((name for name in groups if name in self.names), "")
        self._groups.update({id(one): group for one in shining})

    def parts(
        self, description: "SceneDescription"
    ) -> Iterator[tuple[str, list[tuple[Volume, Medium]], list, list[Surface]]]:
        """Each group with any light, or "" without light: its name, volumes, lights and surfaces, as of
        `inference.render`.
        """

        def of(one: object) -> str:
            return self._groups.get(id(one), "")

        lit = False
        for name in [*self.names, ""]:
            lights = [light for light in description.lights if of(light) == name]
            volumes = [
                (volume, medium if of(volume) == name else replace(medium, emission=0.0))
                for volume, medium in description.volumes
            ]
            surfaces = [
                surface if of(mesh) == name else replace(surface, emission=0.0)
                for mesh, surface in zip(description.opaque, description.surfaces)
            ]
            emits = any(volume.emission is not None and medium.emission > 0.0 for volume, medium in volumes)
            if lights or emits or any(surface.emission.any() for surface in surfaces):
                lit = True
                yield name, volumes, lights, surfaces
        if not lit:
            # The volumes have their alpha all the same.
            yield "", description.volumes, [], description.surfaces


def sum_of_groups(layers: dict[str, Layer]) -> Layer:
    """The layer of all light, from those of each group, by name."""
    whole, *others = layers.values()
    report = whole.report
    for other in others:
        for name, seconds in other.report.seconds.items():
            report.seconds[name] = report.seconds.get(name, 0.0) + seconds
        for name, count in other.report.counts.items():
            report.counts[name] = report.counts.get(name, 0) + count
        report.warnings += [text for text in other.report.warnings if text not in report.warnings]
    stated = any(layer.report.expected_error for layer in layers.values())
    added = ("rgb", "single", "multiple", "emission", "uncertainty")
    sums = {name: np.sum([getattr(layer, name) for layer in layers.values()], axis=0) for name in added}
    groups = {name: layer.rgb for name, layer in layers.items() if name}
    layer = replace(whole, **sums, groups=groups, sampling_error=None)
    report.expected_error = expected_error(layer) if stated else None
    return layer
