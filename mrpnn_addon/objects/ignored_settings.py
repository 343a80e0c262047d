# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings that change Cycles' picture and not this one, each with the warning that names it.

`tests/mrpnn_addon/scene/test_settings_of_cycles.py` lists every other setting of objects, lights, Worlds, scenes and
view layers, and why it needs no warning.
"""

from dataclasses import dataclass
from typing import Any

import bpy


@dataclass(frozen=True)
class IgnoredSetting:
    """A setting without effect where Cycles has one.

    path: attributes from the owner, as "data.cycles.max_bounces"; owners without it are left alone. warning: where the
    setting differs from its default, after the owner's name. harmless: other values without effect in Cycles. switch:
    path of what turns the setting on, if anything does.
    """

    path: str
    warning: str
    harmless: tuple[object, ...] = ()
    switch: str = ""


# Cycles' own before 4.3, where `use_shadow` is EEVEE's.
_CAST_SHADOW = "data.use_shadow" if bpy.app.version >= (4, 3, 0) else "data.cycles.cast_shadow"
#: Of objects that shine: lamps and meshes.
SHINING = (
    IgnoredSetting(
        "light_linking.blocker_collection", "is shadowed by some objects only; it is rendered as shadowed by all"
    ),
)
#: Of objects whose data is a light.
LIGHT = (
    *SHINING,
    IgnoredSetting(_CAST_SHADOW, "casts no shadow; it is rendered with shadows"),
    IgnoredSetting("data.cycles.max_bounces", "has a limit of bounces; its light is rendered with all of them"),
)
# Values of up to that of new volumes, as single-precision numbers.
_CLIPPING = 0.0, 0.0010000000474974513
#: Of objects that show a volume.
VOLUME = (
    IgnoredSetting(
        "data.render.clipping",
        "has a larger Clipping; densities below it are rendered, and Cycles drops them",
        _CLIPPING,
    ),
)
#: Of their materials.
VOLUME_MATERIAL = (
    IgnoredSetting(
        "cycles.volume_interpolation", "has cubic interpolation of volumes; they are rendered with linear interpolation"
    ),
)
WORLD = (
    IgnoredSetting("cycles.max_bounces", "has a limit of bounces; its light is rendered with all of them"),
    # Blender 5.2 and later.
    IgnoredSetting("cycles.use_shadows", "casts no shadow; it is rendered with shadows"),
)
SCENE = (
    IgnoredSetting(
        "cycles.rolling_shutter_type", "Motion Blur > Rolling Shutter has no effect", (), "render.use_motion_blur"
    ),
    IgnoredSetting("cycles.use_fast_gi", "Light Paths > Fast GI Approximation has no effect on volumes"),
    IgnoredSetting("cycles.sample_clamp_direct", "Light Paths > Clamping > Direct Light has no effect on volumes"),
    IgnoredSetting(
        "cycles.sample_clamp_indirect", "Light Paths > Clamping > Indirect Light has no effect on volumes", (0.0,)
    ),
    IgnoredSetting("cycles.filter_width", "Film > Pixel Filter > Width has no effect on volumes"),
    IgnoredSetting(
        "cycles.use_camera_cull",
        "Simplify > Culling has no effect; all objects are rendered",
        (),
        "render.use_simplify",
    ),
    IgnoredSetting(
        "cycles.use_distance_cull",
        "Simplify > Culling has no effect; all objects are rendered",
        (),
        "render.use_simplify",
    ),
    # Blender 5.2 and later.
    IgnoredSetting(
        "cycles.texture_resolution_render", "Simplify > Texture has no effect on volumes", (), "render.use_simplify"
    ),
    IgnoredSetting(
        "cycles.texture_limit_render", "Simplify > Texture Limit has no effect on volumes", (), "render.use_simplify"
    ),
)
VIEW_LAYER = (
    IgnoredSetting("material_override", "overrides materials; volumes keep their own"),
    IgnoredSetting("world_override", "overrides the World; the scene's own is rendered"),
)


def ignored_settings(owner: Any, settings: tuple[IgnoredSetting, ...], name: str = "") -> list[str]:
    """The warnings of an owner's settings that differ from their defaults, each beginning with its name."""
    # Scripts that set Cycles' properties leave evaluated copies as they are.
    original = getattr(owner, "original", owner)
    found = [setting.warning for setting in settings if _is_set(original, setting)]
    return [f"{name} {warning}".strip() for warning in dict.fromkeys(found)]


def _is_set(owner: Any, setting: IgnoredSetting) -> bool:
    path, _, name = setting.path.rpartition(".")
    parent = _at(owner, path)
    known: Any = parent.bl_rna.properties if parent is not None else ()
    if name not in known or setting.switch and not _at(owner, setting.switch):
        return False
    return getattr(parent, name) not in (getattr(known[name], "default", None), *setting.harmless)


def _at(owner: Any, path: str) -> Any:
    """What a path leads to; None where this Blender lacks it, as Cycles' settings while Cycles is disabled."""
    for name in path.split(".") if path else ():
        owner = getattr(owner, name, None)
    return owner
