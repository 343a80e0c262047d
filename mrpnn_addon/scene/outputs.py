# SPDX-License-Identifier: GPL-3.0-or-later
"""What a view layer asks for besides its colours, and the passes that come of it."""

from dataclasses import dataclass, field
from typing import NamedTuple

import bpy
import numpy as np

from ...inference.image.layer import Layer
from ...inference.scene import Camera
from ...inference.scene.camera_rays import camera_rays
from ..settings.properties import scene_settings
from ..settings.view_layer import pass_settings
from .cryptomatte import matte_metadata, matte_passes

# The largest number of levels that Blender's passes hold.
MOST_LEVELS = 16
# Of each kind of matte, what tells the volumes apart, of Owner.
MATTES = {"CryptoObject": "object", "CryptoMaterial": "material"}
POSITION, MEDIAN, SHADOW = "Position", "Median Depth", "Shadow"
# What `Settings.outputs` calls that which each pass is made of.
_NEEDS = {POSITION: "median", MEDIAN: "median", SHADOW: "shadow", **dict.fromkeys(MATTES, "coverage")}


class Owner(NamedTuple):
    """Names of the object that shows a volume, and of its material."""

    object: str
    material: str


@dataclass
class Wanted:
    """passes: names of the view layer's, of mattes without their numbers. levels: of mattes. deep: whether deep samples
    are written. owners: of each volume, by its name.
    """

    passes: list[str] = field(default_factory=list)
    levels: int = 0
    deep: bool = False
    owners: dict[str, Owner] = field(default_factory=dict)

    @property
    def outputs(self) -> frozenset[str]:
        """As `Settings.outputs`."""
        return frozenset([*(_NEEDS[name] for name in self.passes), *(["deep"] if self.deep else [])])

    def add_to(self, layer: Layer, camera: Camera) -> None:
        """Add the passes to a layer of the camera's window."""
        shape = layer.alpha.shape
        for name in self.passes:
            if name in MATTES and layer.coverage is not None:
                images = matte_passes(layer.coverage, self._names(name, layer), shape, self.levels)
                layer.passes.update({f"{name}{number:02}": image for number, image in enumerate(images)})
            elif name == MEDIAN and layer.median is not None:
                layer.passes[MEDIAN] = layer.median
            elif name == POSITION and layer.median is not None:
                origins, directions, _, _ = camera_rays(camera)
                met = np.isfinite(layer.median).ravel()[:, None]
                distance = np.where(met, layer.median.reshape(-1, 1), 0.0)
                points = np.where(met, origins + distance * directions, 0.0)
                layer.passes[POSITION] = points.reshape(*shape, 3).astype(np.float32)
            elif name == SHADOW and layer.shadow is not None:
                layer.passes[SHADOW] = layer.shadow

    def metadata(self, view_layer: str, layer: Layer) -> dict[str, str]:
        """What files say about the mattes of a view layer."""
        found: dict[str, str] = {}
        for name in MATTES:
            if name in self.passes and layer.coverage is not None:
                found.update(matte_metadata(f"{view_layer}.{name}", self._names(name, layer)))
        return found

    def _names(self, kind: str, layer: Layer) -> list[str]:
        assert layer.coverage is not None
        return [getattr(self.owners.get(name, Owner(name, name)), MATTES[kind]) for name in layer.coverage.names]


def wanted(scene: "bpy.types.Scene", view_layer: "bpy.types.ViewLayer") -> Wanted:
    """What a view layer of a scene asks for."""
    return Wanted(_passes(view_layer), _levels(view_layer), scene_settings(scene).use_deep)


def _passes(view_layer: "bpy.types.ViewLayer") -> list[str]:
    switches = {
        POSITION: view_layer.use_pass_position,
        MEDIAN: pass_settings(view_layer).use_pass_median_depth,
        SHADOW: view_layer.use_pass_shadow,
        "CryptoObject": view_layer.use_pass_cryptomatte_object,
        "CryptoMaterial": view_layer.use_pass_cryptomatte_material,
    }
    return [name for name, on in switches.items() if on]


def _levels(view_layer: "bpy.types.ViewLayer") -> int:
    return min(view_layer.pass_cryptomatte_depth, MOST_LEVELS)


def pass_channels(view_layer: "bpy.types.ViewLayer") -> dict[str, str]:
    """The passes that a view layer asks for, with the letters of their channels."""
    letters = {POSITION: "XYZ", MEDIAN: "Z", SHADOW: "RGB"}
    found: dict[str, str] = {}
    for name in _passes(view_layer):
        if name in MATTES:
            # Lower-case letters, for which lossy compression keeps numbers as they are.
            found.update({f"{name}{number:02}": "rgba" for number in range(-(-_levels(view_layer) // 2))})
        else:
            found[name] = letters[name]
    return found
