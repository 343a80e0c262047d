# SPDX-License-Identifier: GPL-3.0-or-later
"""Lists of frames, and the path of each frame's file."""

import os
import re

import bpy

from ...inference.scene import SceneError

# Blender's largest frame.
MAX_FRAMES = 1 << 20
# "12", "1-10", Blender's "1..10" and, every third, "1-10:3"; frames may be negative.
_RANGE = re.compile(r"(-?\d+)(?:(?:\.\.|-)(-?\d+)(?::0*([1-9]\d*))?)?")


def parse_frames(text: str) -> list[int]:
    """Frames of e.g. "1-10,15,20..25,30-50:5", without repetitions, in the order given.

    Raises SceneError for anything else.
    """
    frames: list[int] = []
    for part in text.split(","):
        match = _RANGE.fullmatch(part.strip())
        if match is None:
            raise SceneError(f"cannot read frames {text!r}; write them as 1-10,15")
        first = int(match[1])
        last = first if match[2] is None else int(match[2])
        if last < first:
            raise SceneError(f"frames {part.strip()} run backwards; write {last}-{first}")
        if last - first >= MAX_FRAMES:
            raise SceneError(f"{part.strip()} has more than {MAX_FRAMES} frames")
        frames += range(first, last + 1, int(match[3] or 1))
    return list(dict.fromkeys(frames))


def frame_path(pattern: str, frame: int, many: bool) -> str:
    """The absolute path of a frame's file: its number replaces the last run of #, as in Blender's output path.

    many: whether there are several frames; a pattern without # then gets the number before its extension. A leading
    "//" is the .blend file's folder.

    Raises SceneError where that folder is unknown.
    """
    if pattern.startswith("//") and not bpy.data.filepath:
        raise SceneError(
            f"{pattern} is relative to the .blend file, which is not saved yet; save it, or enter a full path"
        )
    path = os.path.abspath(bpy.path.abspath(pattern))
    folder, name = os.path.split(path)
    runs = list(re.finditer("#+", name))
    if runs:
        start, end = runs[-1].span()
    elif many:
        start = end = len(os.path.splitext(name)[0])
    else:
        return path
    digits = f"{abs(frame):0{(end - start) or 4}d}"
    return os.path.join(folder, name[:start] + ("-" if frame < 0 else "") + digits + name[end:])


def picture_path(scene: "bpy.types.Scene", numbered: bool, part: str = "") -> str:
    """The absolute path, without extension, of the picture that Blender writes of a frame.

    numbered: whether it is one of several frames. part: what tells several files of a frame apart, added to the name.

    Raises SceneError where its folder is unknown.
    """
    render = scene.render
    if render.filepath.startswith("//") and not bpy.data.filepath:
        raise SceneError(f"{render.filepath} is relative to the .blend file, which is not saved yet; save it")
    path = render.frame_path(frame=scene.frame_current) if numbered else bpy.path.abspath(render.filepath)
    path = path.removesuffix(render.file_extension)
    if not os.path.basename(path):
        path += f"{scene.frame_current:04d}"
    return path + (f"_{bpy.path.clean_name(part)}" if part else "")
