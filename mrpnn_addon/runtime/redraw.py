# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws panels again when what they say has changed.

Blender draws an editor when the mouse moves over it or its data change. A render that ends on a thread of its own is
neither, so that panels went on showing the render before.
"""

import threading

import bpy

# Seconds between two looks.
INTERVAL = 0.25
_wanted = threading.Event()


def redraw_panels() -> None:
    """Draw the panels of all Properties editors soon. May be called on any thread."""
    _wanted.set()


def _tick() -> float:
    if _wanted.is_set():
        _wanted.clear()
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "PROPERTIES":
                    area.tag_redraw()
    return INTERVAL


def register() -> None:
    if not bpy.app.background:
        # Other threads may not start a timer.
        bpy.app.timers.register(_tick, first_interval=INTERVAL, persistent=True)


def unregister() -> None:
    if bpy.app.timers.is_registered(_tick):
        bpy.app.timers.unregister(_tick)
