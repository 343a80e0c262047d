# SPDX-License-Identifier: GPL-3.0-or-later
"""The frames of a command: each is read and worked on, and one that fails does not end the animation."""

import argparse
import traceback
from collections.abc import Callable

import bpy

from ..inference.scene import SceneError
from ..mrpnn_addon.scene.kept_frame import goes_to
from ..mrpnn_addon.scene.reader import SceneDescription, read_frame, require_all
from .console import Console


def each_frame(frames: list[int], work: Callable[[int], dict], console: Console, found: dict, strict: bool) -> dict:
    """Do the work of each frame and collect its facts in found["frames"].

    The work goes on after a frame that fails, unless the command is strict or there are no others. Returns the messages
    of those that failed, by frame. An OSError stops the work: it would fail for all frames.
    """
    failed: dict[int, str] = {}
    found["frames"] = []
    for frame in frames:
        try:
            found["frames"].append(work(frame))
        except OSError:
            raise
        except Exception as error:
            if strict or len(frames) == 1:
                raise
            failed[frame] = error_message(error)
            console.event("error", f"frame {frame}: {failed[frame]}", frame=frame, message=failed[frame])
            found["frames"].append({"frame": frame, "error": failed[frame]})
    return failed


def error_message(error: Exception) -> str:
    """What to tell of an error; what is none of the user's is printed in full as well."""
    if isinstance(error, SceneError):
        return str(error)
    traceback.print_exception(error)
    return f"MRPNN failed, which is a bug: {type(error).__name__}: {error}"


def require_none(failed: dict[int, str], frames: list[int]) -> None:
    """Raises SceneError where frames have failed."""
    if failed:
        reasons = "; ".join(f"frame {frame}: {message}" for frame, message in failed.items())
        raise SceneError(f"{len(failed)} of {len(frames)} frames failed: {reasons}")


def frame_reader(
    options: argparse.Namespace, frames: list[int], flipbook: bool = False
) -> Callable[[int], SceneDescription]:
    """A function that reads a frame of the scene. Several frames are an animation, which goes on without volumes.

    flipbook: whether for tiles, which games blend: sharp ones, with what moves until the next frame.
    """

    def read(frame: int) -> SceneDescription:
        # Even for the current frame: an override may change what is evaluated.
        go_to = goes_to(bpy.context.scene)
        go_to(frame, 0.0)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        blur = None if flipbook else go_to
        description = read_frame(depsgraph, goes_on=len(frames) > 1, go_to=blur, flows=flipbook)
        if options.strict:
            require_all(description)
        return description

    return read
