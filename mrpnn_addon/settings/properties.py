# SPDX-License-Identifier: GPL-3.0-or-later
"""Render settings of a scene: `scene.mrpnn`."""

from typing import Any

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, PointerProperty, StringProperty

from ...inference import Settings
from ...inference.scene.optimizations import ALL, OPTIMIZATIONS, numbers
from .models import model_items
from .preferences import machine

# Version of the properties in files. 0: networks are numbered by their position in the list. 1: there is a number of
# directions of the World. 2: the optimizations that are on are called leave_out.
VERSION = 3

# Blender 4.5 and later require this option for paths that start with "//"; earlier versions reject it.
RELATIVE_PATH = {"PATH_SUPPORTS_BLEND_RELATIVE"} if bpy.app.version >= (4, 5, 0) else set()

# Depth samples of each preset.
PRESETS = {"PREVIEW": 1, "DRAFT": 4, "FINAL": 16}
_PRESET_ITEMS = [
    ("PREVIEW", "Preview", "1 depth sample: fastest. Shapes are final, multiple scattering is rough"),
    ("DRAFT", "Draft", "4 depth samples: little sampling error"),
    ("FINAL", "Final", "16 depth samples: no visible sampling error, except in the densest clouds"),
    ("CUSTOM", "Custom", "Another number of depth samples"),
]

_OPTIMIZATION_ITEMS = [
    (name, OPTIMIZATIONS[name].title, OPTIMIZATIONS[name].what, "NONE", 1 << number)
    for name, number in numbers().items()
]

# The scene's choice to follow the preferences.
AS_PREFERRED = ("PREFERENCES", "From Preferences", "The network chosen in the preferences", "NONE", 0)
_model_items: list[tuple[str, str, str, str, int]] = []


def _scene_models(_owner: Any = None, _context: "bpy.types.Context | None" = None) -> list[tuple]:
    _model_items[:] = [AS_PREFERRED, *model_items()]
    return _model_items


def _preset(settings: Any) -> int:
    samples = list(PRESETS.values())
    return samples.index(settings.depth_samples) if settings.depth_samples in samples else len(samples)


def _choose_preset(settings: Any, number: int) -> None:
    samples = list(PRESETS.values())
    if number < len(samples):
        settings.depth_samples = samples[number]


class MRPNN_PG_scene(bpy.types.PropertyGroup):
    version: IntProperty(options={"HIDDEN"})
    preset: EnumProperty(
        name="Preset",
        items=_PRESET_ITEMS,
        get=_preset,
        set=_choose_preset,
        options={"SKIP_SAVE"},
        description="Quality of multiple scattering, by the number of depth samples",
    )
    depth_samples: IntProperty(
        name="Depth Samples",
        default=PRESETS["DRAFT"],
        min=1,
        max=256,
        soft_max=64,
        description="Points along each camera ray at which the network predicts multiple scattering. More are more "
        "exact and take longer",
    )
    blur_rays: IntProperty(
        name="Blur Rays",
        default=Settings.blur_rays,
        min=2,
        max=256,
        soft_max=32,
        description="Rays through each pixel where depth of field or motion blur is on. More give less noise",
    )
    viewport_blur: BoolProperty(
        name="Blur in Viewport",
        default=False,
        description="Show depth of field in Rendered shading, in viewports that look through the camera",
    )
    model: EnumProperty(
        name="Network",
        items=_scene_models,
        default=AS_PREFERRED[-1],
        description="Network that predicts multiple scattering",
    )
    seed: IntProperty(
        name="Seed", default=0, min=0, description="Seed of the random numbers; the same seed gives the same image"
    )
    optimizations: EnumProperty(
        name="Optimizations",
        items=_OPTIMIZATION_ITEMS,
        default=set(ALL),
        options={"ENUM_FLAG"},
        description="Shortcuts that save time and hardly change the picture. Turn one off to check",
    )
    threads: IntProperty(
        name="Threads",
        default=0,
        min=0,
        max=1024,
        description="Number of render threads. 0 uses the number in the preferences",
    )
    memory_limit: IntProperty(
        name="Memory Limit (GiB)",
        default=0,
        min=0,
        max=1024,
        description="Memory that a render may use, in GiB. Where it needs more, the largest volumes lose resolution, "
        "or the render is refused. 0 uses the limit in the preferences",
    )
    use_exr: BoolProperty(
        name="Write EXR",
        default=False,
        description="Write a multi-layer OpenEXR file after each Render Volumes. F12 follows the output properties",
    )
    exr_path: StringProperty(
        name="EXR File",
        default="//mrpnn.exr",
        subtype="FILE_PATH",
        options=RELATIVE_PATH,
        description="Multi-layer OpenEXR file to write",
    )

    use_deep: BoolProperty(
        name="Deep EXR",
        default=False,
        description="Also write a deep OpenEXR file beside the picture, with _deep after its name. Deep compositing "
        "puts other renders into the volumes, at any depth",
    )

    def settings(self) -> Settings:
        """The settings of `inference.render`."""
        preferred = machine()
        # A number of no available network, written by another version, reads as "".
        model = preferred.model if self.model == AS_PREFERRED[0] else self.model or Settings.model
        return Settings(
            depth_samples=self.depth_samples,
            blur_rays=self.blur_rays,
            model=model,
            seed=self.seed,
            optimizations=self.optimizations,
            threads=self.threads or preferred.threads,
            provider=preferred.provider,
            memory_limit=(self.memory_limit or preferred.memory_limit) << 30,
        )


def scene_settings(scene: "bpy.types.Scene") -> MRPNN_PG_scene:
    """`scene.mrpnn`, which the types of bpy do not have."""
    return scene.path_resolve("mrpnn")


def migrate(scene: "bpy.types.Scene") -> None:
    """Bring a scene's properties up to VERSION; those of a newer version stay unchanged."""
    settings = scene_settings(scene)
    if settings.version >= VERSION:
        return
    # Version 0 numbered networks by position, and there was one.
    if settings.version < 1 and settings.is_property_set("model"):
        settings.model = Settings.model
    stored = stored_properties(scene)
    if stored.pop("world_directions", None) == 0:
        _hide_world(scene)
    bits = stored.pop("leave_out", None)
    if bits is not None:
        settings.optimizations = {name for name, number in numbers().items() if bits >> number & 1}
    settings.version = VERSION


def stored_properties(scene: "bpy.types.Scene") -> dict:
    """Values of `scene.mrpnn` as the file holds them, those of properties that are gone included; may be changed."""
    if bpy.app.version >= (5, 0, 0):
        settings: Any = scene_settings(scene)
        return settings.bl_system_properties_get(do_create=True)
    return scene.get("mrpnn", {})


def _hide_world(scene: "bpy.types.Scene") -> None:
    """Keep the World from lighting volumes: with 0 directions it did not."""
    world = scene.world
    # Properties of Cycles, absent while Cycles is disabled.
    visibility = getattr(world, "cycles_visibility", None)
    if visibility is None or world.library is not None or not visibility.scatter:
        return
    visibility.scatter = False
    print(
        f'MRPNN: scene "{scene.name}" had 0 World Directions, which are gone; World "{world.name}" does not light '
        "volumes since its Ray Visibility > Volume Scatter is now off"
    )


def _own_scenes() -> "list[bpy.types.Scene]":
    # Linked scenes are read-only.
    return [scene for scene in bpy.data.scenes if scene.library is None]


@bpy.app.handlers.persistent
def _after_load(*_: Any) -> None:
    for scene in _own_scenes():
        migrate(scene)


@bpy.app.handlers.persistent
def _before_save(*_: Any) -> None:
    for scene in _own_scenes():
        settings = scene_settings(scene)
        settings.version = max(settings.version, VERSION)


def register() -> None:
    bpy.utils.register_class(MRPNN_PG_scene)
    scene: Any = bpy.types.Scene
    scene.mrpnn = PointerProperty(type=MRPNN_PG_scene)
    bpy.app.handlers.load_post.append(_after_load)
    bpy.app.handlers.save_pre.append(_before_save)


def unregister() -> None:
    bpy.app.handlers.save_pre.remove(_before_save)
    bpy.app.handlers.load_post.remove(_after_load)
    scene: Any = bpy.types.Scene
    del scene.mrpnn
    bpy.utils.unregister_class(MRPNN_PG_scene)
