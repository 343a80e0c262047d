# SPDX-License-Identifier: GPL-3.0-or-later
"""The frame and subframe of a scene, for work that visits other frames."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy

from ..objects.motion import GoTo


class KeptFrame:
    """Remembers where a scene is in time."""

    def __init__(self, scene: "bpy.types.Scene") -> None:
        # By name: a reference would not survive what undo or loading a file does to scenes.
        self._place = scene.name, scene.frame_current, scene.frame_subframe

    def restore(self) -> None:
        """Go back there, unless the scene is there still or is gone."""
        name, frame, subframe = self._place
        scene: Any = bpy.data.scenes.get(name)
        if scene is not None and (scene.frame_current, scene.frame_subframe) != (frame, subframe):
            scene.frame_set(frame, subframe=subframe)


def goes_to(scene: "bpy.types.Scene") -> GoTo:
    """What goes to frames of a scene."""
    return lambda frame, subframe: scene.frame_set(frame, subframe=subframe)


@contextmanager
def kept_frame(scene: "bpy.types.Scene") -> Iterator[None]:
    """The scene is back in its frame at the end, also after errors."""
    kept = KeptFrame(scene)
    try:
        yield
    finally:
        kept.restore()
