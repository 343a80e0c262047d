# SPDX-License-Identifier: GPL-3.0-or-later
"""Live Light: a switch of each scene with which its light is baked again by itself.

A timer on Blender's main thread advances the live scenes that a window shows. Their files are in a temporary folder,
because Blender caches files by path, so that each update is a new file. Saving and switching off copy the files that
are shown beside the .blend file. The folder goes when nothing is live, when another file is loaded and at the exit; the
next start removes one that a crash has left.
"""

import os
import shutil
import sys
from pathlib import Path
from typing import Any

import bpy
from bpy.props import BoolProperty

from ..runtime.atomic_write import make_folder
from ..runtime.redraw import redraw_panels
from ..runtime.session_folder import SessionFolder, remove_leftovers
from .baked_scene import light_state, set_file
from .light_folder import FOLDER, is_within, light_folder
from .live_scene import LiveScene

POLL_INTERVAL = 0.05
PREFIX = "mrpnn-live-"

_live: dict[int, LiveScene] = {}
_folder: SessionFolder | None = None
_statuses: list[str] = []
# Why light could not be made permanent.
_not_kept: list[str] = []


def is_live(scene: "bpy.types.Scene") -> bool:
    """Whether *Live Light* is on."""
    return bool(scene.path_resolve("mrpnn_live_light"))


def live_status(scene: "bpy.types.Scene") -> tuple[str, bool]:
    """What goes on in a live scene, and whether that is a problem."""
    found = _live.get(scene.session_uid)
    return ("", False) if found is None else (found.status, bool(found.problem))


def not_kept() -> list[str]:
    """Sentences about light that is in temporary files still, although the .blend file was saved."""
    return list(_not_kept)


def tick() -> float | None:
    """Advance each live scene that a window shows; a function for a timer."""
    _sync()
    if bpy.app.is_job_running("RENDER"):
        # The render may read the files, and nobody may change the scene.
        return POLL_INTERVAL
    windows = {window.scene.session_uid: window for window in reversed(bpy.context.window_manager.windows)}
    for uid, live in _live.items():
        if uid in windows:
            with bpy.context.temp_override(window=windows[uid]):
                live.advance(bpy.context)
    _redraw()
    return POLL_INTERVAL if _live else None


def _sync() -> None:
    """Begin and end what the switches of the scenes say, which undo and scripts change too."""
    global _folder
    scenes = {scene.session_uid: scene for scene in bpy.data.scenes}
    wanted = [uid for uid, scene in scenes.items() if is_live(scene) and scene.library is None]
    for uid in [uid for uid in _live if uid not in wanted]:
        live = _live.pop(uid)
        live.close()
        if uid in scenes:
            _keep(scenes[uid], light_folder())
        live.remove_files()
    for uid in wanted:
        if uid not in _live:
            _folder = _folder or SessionFolder(_base(), PREFIX)
            _live[uid] = LiveScene(str(_folder.path / str(uid)))
    if not _live:
        _remove_folder()


def _base() -> Path:
    """The folder of temporary folders."""
    return Path(bpy.app.tempdir).parent


def _remove_folder() -> None:
    global _folder
    if _folder is not None:
        _folder.remove()
        _folder = None


def _keep(scene: "bpy.types.Scene", folder: str) -> None:
    """Copy a scene's temporary files of light to a folder, and show those."""
    for item in light_state(scene).volumes:
        data: Any = item.shown and item.shown.data
        path = data and os.path.abspath(bpy.path.abspath(data.filepath))
        if not path or not _is_temporary(path) or is_within(path, folder):
            continue
        if data.is_sequence:
            _not_kept.append(f'the light of "{item.name}" is in temporary files; bake the animation again')
            continue
        kept = os.path.join(folder, os.path.basename(path))
        try:
            make_folder(folder)
            shutil.copyfile(path, kept)
            set_file(data, kept)
        except OSError as error:
            _not_kept.append(f'the light of "{item.name}" is temporary still: {error.strerror or error}')


def _is_temporary(path: str) -> bool:
    return is_within(path, bpy.app.tempdir) or _folder is not None and is_within(path, str(_folder.path))


def _redraw() -> None:
    """Draw the panels again where they have something else to say."""
    statuses = [live.status for live in _live.values()]
    if statuses == _statuses:
        return
    _statuses[:] = statuses
    redraw_panels()


def _switched(_scene: "bpy.types.Scene", _context: "bpy.types.Context") -> None:
    _sync()
    _start()


def _start() -> None:
    if not bpy.app.timers.is_registered(tick) and any(map(is_live, bpy.data.scenes)):
        bpy.app.timers.register(tick, first_interval=POLL_INTERVAL)


@bpy.app.handlers.persistent
def _after_undo(*_: Any) -> None:
    for live in _live.values():
        live.forget_shown()
    _start()


@bpy.app.handlers.persistent
def _before_save(path: str = "", *_: Any) -> None:
    _not_kept.clear()
    for scene in bpy.data.scenes if path else ():
        _keep(scene, os.path.join(os.path.dirname(path), FOLDER.removeprefix("//")))
    for sentence in _not_kept:
        print(f"mrpnn: {sentence}", file=sys.stderr)


@bpy.app.handlers.persistent
def _before_load(*_: Any) -> None:
    for live in _live.values():
        live.close()


@bpy.app.handlers.persistent
def _after_load(*_: Any) -> None:
    """A file that names files of the folder, as one that Blender saves by itself may, gets its light anew."""
    _live.clear()
    _not_kept.clear()
    _remove_folder()
    _start()


@bpy.app.handlers.persistent
def _after_failed_load(*_: Any) -> None:
    _after_undo()


_HANDLERS = {
    "undo_post": _after_undo,
    "redo_post": _after_undo,
    "save_pre": _before_save,
    "load_pre": _before_load,
    "load_post": _after_load,
    "load_post_fail": _after_failed_load,
}


def register() -> None:
    scene: Any = bpy.types.Scene
    scene.mrpnn_live_light = BoolProperty(
        name="Live Light",
        update=_switched,
        description="Bake the light again by itself whenever lights, volumes, materials or the World change: coarse at "
        "once, finer when nothing moves",
    )
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).append(handler)
    remove_leftovers(_base(), PREFIX)


def unregister() -> None:
    """Blender calls this when it quits, too."""
    if bpy.app.timers.is_registered(tick):
        bpy.app.timers.unregister(tick)
    for name, handler in _HANDLERS.items():
        getattr(bpy.app.handlers, name).remove(handler)
    for live in _live.values():
        live.close()
    _live.clear()
    _remove_folder()
    scene: Any = bpy.types.Scene
    del scene.mrpnn_live_light
