"""Lists of frames, and the file of each."""

import os
import re
from typing import List

import bpy

from ...inference.scene import SceneError

# "12", "1-10" and Blender's own "1..10"; frames may be negative.
# Blender's own largest frame.
MOST_FRAMES = 1 << 20
_SPAN = re.compile(r"(-?\d+)(?:(?:\.\.|-)(-?\d+))?")


def parse_frames(text: str) -> List[int]:
    """Frames of e.g. "1-10,15,20..25", each once, in the order given.

    Raises SceneError for anything else.
    """
    frames = []
    for part in text.split(","):
        match = _SPAN.fullmatch(part.strip())
        if match is None:
            raise SceneError(f"cannot read frames {text!r}; write them as 1-10,15")
        first = int(match[1])
        last = first if match[2] is None else int(match[2])
        if last < first:
            raise SceneError(f"frames {part.strip()} run backwards; write {last}-{first}")
        if last - first >= MOST_FRAMES:
            raise SceneError(f"{part.strip()} are more than {MOST_FRAMES} frames")
        frames += range(first, last + 1)
    return list(dict.fromkeys(frames))


def frame_path(pattern: str, frame: int, many: bool) -> str:
    """The file of a frame, absolute: the last run of # becomes its number, as in Blender's output path.

    many: whether there are several frames; a pattern without # then gets the number before its ending.
    "//" at the start is the .blend file's folder.

    Raises SceneError where that folder is not known yet.
    """
    if pattern.startswith("//") and not bpy.data.filepath:
        raise SceneError(f"{pattern} lies beside the .blend file, which is not saved yet; save it, or enter a full path")
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
