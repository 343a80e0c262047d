# SPDX-License-Identifier: GPL-3.0-or-later
"""A flipbook in the making: its tiles frame by frame, then its files. Imports no bpy."""

import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from ...inference import RenderCache
from ...inference.scene import Camera, Cancelled, SceneError, Settings
from ..runtime.atomic_write import atomic_write, make_folder
from ..runtime.background import Worker
from ..runtime.onnxruntime_version import check_runtime
from ..scene.reader import SceneDescription
from .atlas import Atlas, Textures, textures
from .light_maps import Tile, is_coloured, render_tile
from .texture_files import FORMATS, write_texture

# Brightest texel of light maps below which 8 bits show steps.
DARK = 0.3


@dataclass
class Flipbook:
    """frames: numbers, in order. base: absolute path of the files without what their names end in. file_format: a key
    of FORMATS. camera: of all frames, or None for each frame's own. angle: angular diameter of the suns, radians.
    fps: of the scene. tiles: of the frames so far, by number; None for one that stays empty. warnings: of all of it.
    """

    atlas: Atlas
    frames: list[int]
    base: str
    file_format: str
    camera: Camera | None = None
    angle: float = 0.0
    fps: float = 24.0
    tiles: dict[int, Tile | None] = field(default_factory=dict)
    warnings: list[str] = field(default_factory=list)
    _cache: RenderCache = field(default_factory=RenderCache)

    def warn(self, text: str) -> None:
        """Remember a warning once."""
        if text not in self.warnings:
            self.warnings.append(text)

    def render(
        self,
        scene: SceneDescription,
        settings: Settings,
        progress: Callable[[float, str], None] | None = None,
        cancelled: Callable[[], bool] | None = None,
    ) -> None:
        """Render a frame's tile; one that cannot be rendered stays empty, with a warning that names the frame.

        The scene's camera has the size of a tile without its padding. Calls no bpy. Raises Cancelled.
        """
        for text in [*scene.warnings, *check_runtime()]:
            # Its own lights are left out.
            if f"frame {scene.frame} is black" not in text:
                self.warn(text.replace("is an empty picture", "is an empty tile"))
        for volume, medium in scene.volumes:
            if is_coloured(medium):
                self.warn(f'volume "{volume.name}" is colored, but light maps are gray: tint it in the game engine')
        tile = None
        if scene.volumes:
            try:
                until = self._until_next(scene.frame)
                tile = render_tile(scene, settings, self.angle, until, progress, cancelled, self._cache)
            except SceneError as problem:
                self.warn(f"frame {scene.frame} is an empty tile: {problem}")
        elif not any(text.startswith(f"frame {scene.frame} ") for text in self.warnings):
            self.warn(f"frame {scene.frame} is an empty tile: it shows no volume")
        self.tiles[scene.frame] = tile

    def _until_next(self, frame: int) -> int:
        """Frames from a tile to the next one; after the last as before it."""
        place = min(self.frames.index(frame), max(len(self.frames) - 2, 0))
        return self.frames[place + 1] - self.frames[place] if len(self.frames) > 1 else 1

    def write(self, check: Callable[[], None] = lambda: None) -> list[str]:
        """Write the textures and what an engine has to know of them; returns the paths.

        check: an exception that it raises stops the writing. Raises SceneError where all tiles are empty, and OSError
        where a file cannot be written.
        """
        if not any(self.tiles.values()):
            raise SceneError(f"no frame shows a volume: {'; '.join(self.warnings)}")
        made = textures(self.atlas, [self.tiles.get(frame) for frame in self.frames])
        if made.clipped > 0.0 and self.file_format != "EXR":
            self.warn(
                f"{100.0 * made.clipped:.2g} % of the smoke's texels are brighter than 1 and clipped; turn on "
                "Normalize, or choose OpenEXR"
            )
        if made.brightest < DARK and FORMATS[self.file_format][1] == 8:
            self.warn(
                f"the brightest texel is {made.brightest:.2g}, so that 8 bits hold few shades; turn on Normalize, "
                "or choose PNG 16-bit or OpenEXR"
            )
        make_folder(os.path.dirname(self.base))
        ending, paths = FORMATS[self.file_format][0], []
        for name, pixels in made.images.items():
            check()
            paths.append(f"{self.base}_{name}{ending}")
            write_texture(paths[-1], pixels, self.file_format, check)
        paths.append(f"{self.base}.json")
        with atomic_write(paths[-1]) as file:
            file.write((json.dumps(self._facts(made), indent=1) + "\n").encode())
        return paths

    def _facts(self, made: Textures) -> dict[str, Any]:
        atlas = self.atlas
        return {
            "columns": atlas.columns,
            "rows": atlas.rows,
            "tile": atlas.tile,
            "padding": atlas.padding,
            "layout": atlas.layout,
            "alpha": "straight" if atlas.straight else "premultiplied",
            "frames": self.frames,
            "fps": self.fps,
            "light_angle": self.angle,
            "light_scale": made.scale,
            "emission_scale": made.emission_scale,
            "motion_scale": made.motion_scale,
        }


class TileJob(Worker):
    """Flipbook.render on a worker thread."""

    def __init__(self, flipbook: Flipbook, scene: SceneDescription, settings: Settings) -> None:
        self._task = flipbook, scene, settings
        self._start("mrpnn flipbook", awaited=True)

    def _work(self) -> None:
        flipbook, scene, settings = self._task
        flipbook.render(scene, settings, self._progress, lambda: self.stopped)

    def _progress(self, fraction: float, message: str) -> None:
        self.fraction, self.message = fraction, message


class WriteJob(Worker):
    """Flipbook.write on a worker thread. result: the paths when done."""

    message = "writing the textures"

    def __init__(self, flipbook: Flipbook) -> None:
        self.result: list[str] = []
        self._flipbook = flipbook
        self._start("mrpnn flipbook files", awaited=True)

    def _work(self) -> None:
        self.result = self._flipbook.write(self._check)

    def _check(self) -> None:
        if self.stopped:
            raise Cancelled()
