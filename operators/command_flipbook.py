# SPDX-License-Identifier: GPL-3.0-or-later
"""The action of the command line that renders six-way flipbooks."""

import argparse
import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy

from ..inference.scene import SceneError, Settings
from ..mrpnn_addon.flipbook.texture_files import FORMATS
from ..mrpnn_addon.output.frames import parse_frames
from ..mrpnn_addon.settings.flipbook import flipbook_settings
from .command_frames import frame_reader
from .console import Console
from .flipbook import begin_flipbook, scene_frames, seen

# Names of options that are properties of `scene.mrpnn_flipbook`.
OPTIONS = ("columns", "rows", "size", "padding", "layout", "alpha", "view")


def add_options(flipbook: argparse.ArgumentParser) -> None:
    """Add the options of the action, but for those that all actions have."""
    flipbook.add_argument(
        "--output",
        metavar="FILE",
        help="beginning of the files' names, and their format by .png, .tga or .exr; // is the .blend file's folder",
    )
    flipbook.add_argument(
        "--frames",
        "--frame",
        metavar="LIST",
        help="1-10,15 or 1..10, or every third as 1-10:3; without it, the scene's, spread evenly over the tiles",
    )
    flipbook.add_argument("--bits", type=int, choices=(8, 16), help="bits of each channel in PNG files")
    flipbook.add_argument("--normalize", action="store_true", help="scale the brightest texel of the light maps to 1")
    for name, values, what in (
        ("layout", ("unity", "right-left-top"), "which light map each channel holds"),
        ("alpha", ("premultiplied", "straight"), "whether the light maps are multiplied by alpha"),
        ("view", ("auto", "camera"), "auto: frame the volumes of all frames; camera: the active camera"),
    ):
        flipbook.add_argument(f"--{name}", choices=values, help=what)
    flipbook.add_argument("--angle", type=float, metavar="DEGREES", help="angular diameter of the six suns, 0 to 40")
    for name, what in (
        ("columns", "tiles in each row"),
        ("rows", "rows of tiles"),
        ("size", "width of the textures in pixels; tiles are square"),
        ("padding", "empty pixels at each edge of a tile"),
    ):
        flipbook.add_argument(f"--{name}", type=int, metavar="N", help=what)


def render_flipbook(options: argparse.Namespace, settings: Settings, console: Console, found: dict) -> None:
    """Render the flipbook. `found` collects the output of --json."""
    scene, started = bpy.context.scene, time.perf_counter()
    with _properties(options):
        frames = parse_frames(options.frames) if options.frames else scene_frames(scene)
        book = begin_flipbook(scene, frames, automatic=not options.frames)
    told: list[str] = []
    found["frames"] = []
    # Two, so that a frame without a volume is an empty tile.
    read = frame_reader(options, [*book.frames, *book.frames], flipbook=True)
    for frame in book.frames:
        book.render(seen(book, read(frame)), settings, console.progress(frame))
        warnings = book.warnings[len(told) :]
        told += warnings
        for warning in warnings:
            console.event("warning", warning, frame=frame, message=warning)
        facts = {"frame": frame, "empty": book.tiles[frame] is None, "warnings": warnings}
        found["frames"].append(facts)
        console.event("frame", f"frame {frame}: {'empty' if facts['empty'] else 'tile rendered'}", **facts)
    found["files"] = book.write()
    for warning in book.warnings[len(told) :]:
        console.event("warning", warning, message=warning)
    saved = "\n".join(f"Saved: '{path}'" for path in found["files"])
    seconds = time.perf_counter() - started
    console.event("saved", f"wrote {len(book.frames)} tiles in {seconds:.1f} s\n{saved}", files=found["files"])


@contextmanager
def _properties(options: argparse.Namespace) -> Iterator[None]:
    """The scene's settings of flipbooks are those of the command line meanwhile."""
    settings: Any = flipbook_settings(bpy.context.scene)
    values = {name: getattr(options, name) for name in OPTIONS if getattr(options, name) is not None}
    values = {
        name: value if isinstance(value, int) else value.upper().replace("-", "_") for name, value in values.items()
    }
    if options.angle is not None:
        if not 0.0 <= options.angle <= 40.0:
            raise SceneError(f"--angle must lie between 0 and 40 degrees, not {options.angle:g}")
        values["angle"] = math.radians(options.angle)
    if options.normalize:
        values["normalized"] = True
    if options.output:
        values["filepath"] = options.output
        ending = os.path.splitext(options.output)[1].lower()
        if ending not in {of for of, _ in FORMATS.values()}:
            raise SceneError(f"--output must end in .png, .tga or .exr, not {options.output!r}")
        values["file_format"] = {".png": "PNG", ".tga": "TGA", ".exr": "EXR"}[ending]
    if options.bits:
        if not values.get("file_format", settings.file_format).startswith("PNG"):
            raise SceneError("--bits is for .png files")
        values["file_format"] = "PNG16" if options.bits == 16 else "PNG"
    for name, value in values.items():
        limits = settings.bl_rna.properties[name]
        if limits.type == "INT" and not limits.hard_min <= value <= limits.hard_max:
            raise SceneError(f"--{name} must lie between {limits.hard_min} and {limits.hard_max}, not {value}")
    before = {name: getattr(settings, name) for name in values}
    try:
        for name, value in values.items():
            setattr(settings, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(settings, name, value)
