# SPDX-License-Identifier: GPL-3.0-or-later
"""Forgets checks, renders and comparisons of a file when another one is loaded."""

import bpy

from . import last_comparison, last_render, scene_check


@bpy.app.handlers.persistent
def _loaded(_file: str) -> None:
    for result in (last_render, last_comparison, scene_check):
        result.forget()


def register() -> None:
    bpy.app.handlers.load_post.append(_loaded)


def unregister() -> None:
    bpy.app.handlers.load_post.remove(_loaded)
