"""What renders of this session, and those of this machine before it, have told about the seconds that one takes."""

import json
import math
import os
from typing import Optional

import bpy

from ...inference.scene import SceneError
from ..objects.workload import Workload
from ..runtime.json_file import write_json
from ..volumes.bounding_boxes import forget_densities
from .cost_model import STAGES, Experience, learn

FILE = "mrpnn_speed.json"
# A machine's rates that differ by less are not written again.
SAME = 0.1

_known: Optional[Experience] = None


def experience() -> Experience:
    """What is known."""
    global _known
    if _known is None:
        _known = _read()
    return _known


def learn_from(asked: Optional[Workload], layer) -> None:
    """Keep what a render tells. asked: what it had to do, or None where nothing was."""
    if asked is None:
        return
    known = experience()
    before = dict(known.rates), known.threads
    learn(known, asked, layer.report, layer.alpha)
    rates, threads = before
    if threads != known.threads or any(
            abs(rate - rates.get(stage, 0.0)) > SAME * rate for stage, rate in known.rates.items()):
        _write(known)


def forget() -> None:
    """As at the start of a session; for tests."""
    global _known
    _known = None


@bpy.app.handlers.persistent
def _after_load(*_):
    # Volumes of another file may have the same names.
    experience().shares.clear()
    forget_densities()


def register():
    bpy.app.handlers.load_post.append(_after_load)


def unregister():
    bpy.app.handlers.load_post.remove(_after_load)


def _path() -> str:
    """In Blender's folder of the user's settings; "" where there is none."""
    folder = bpy.utils.user_resource('CONFIG')
    return os.path.join(folder, FILE) if folder and os.path.isdir(folder) else ""


def _read() -> Experience:
    try:
        with open(_path()) as file:
            found = json.load(file)
        rates = {stage: float(found["rates"][stage]) for stage in STAGES if stage in found["rates"]}
        if all(0.0 < rate < math.inf for rate in rates.values()) and int(found["threads"]) > 0:
            return Experience(rates=rates, threads=int(found["threads"]))
    except (OSError, ValueError, TypeError, KeyError):
        # None has been written, or by another version.
        pass
    return Experience()


def _write(known: Experience) -> None:
    path = _path()
    try:
        if path:
            write_json(path, {"rates": known.rates, "threads": known.threads})
    except SceneError:
        # It is a convenience: a folder that cannot be written to is no reason to speak.
        pass
