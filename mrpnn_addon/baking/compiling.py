# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws baked light again while EEVEE compiles its material.

Until that is compiled, EEVEE's viewport shows the default material, which fills the light's box. Blender 4.3 shows it
for good: it does not draw a volume anew once its material is there, but only when the volume changes.
"""

from typing import Any

import bpy

from ..nodes.material import LIGHT_MARK

# Seconds between two drawings: nothing says when a material is compiled, which takes a minute without a graphics card.
_INTERVALS = (1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0)
_left: list[float] = []


def draw_again() -> None:
    """Have EEVEE's viewports draw all baked light again, at growing intervals from now on."""
    _left[:] = _INTERVALS
    if not bpy.app.timers.is_registered(_draw):
        bpy.app.timers.register(_draw, first_interval=_left.pop(0))


def _draw() -> float | None:
    if any(map(_shows_eevee, bpy.context.window_manager.windows)):
        for data in _baked():
            data.update_tag()
    return _left.pop(0) if _left else None


def _baked() -> list[Any]:
    """Volume data-blocks of baked light."""
    volumes: Any = bpy.data.volumes
    return [data for data in volumes if LIGHT_MARK in data]


def _shows_eevee(window: "bpy.types.Window") -> bool:
    """Whether a viewport of the window draws with EEVEE. Cycles' would begin anew for nothing."""
    shadings = {"MATERIAL"} | ({"RENDERED"} if "EEVEE" in window.scene.render.engine else set())
    spaces: list[Any] = [area.spaces.active for area in window.screen.areas if area.type == "VIEW_3D"]
    return any(space.shading.type in shadings for space in spaces)


@bpy.app.handlers.persistent
def _after_load(*_: Any) -> None:
    if _baked():
        draw_again()


def register() -> None:
    bpy.app.handlers.load_post.append(_after_load)


def unregister() -> None:
    bpy.app.handlers.load_post.remove(_after_load)
    if bpy.app.timers.is_registered(_draw):
        bpy.app.timers.unregister(_draw)
