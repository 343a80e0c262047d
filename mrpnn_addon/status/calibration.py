# SPDX-License-Identifier: GPL-3.0-or-later
"""Calibrates the cost models by renders and bakes, of this session and of earlier ones on this machine."""

import json
import math
import os
from typing import Any

import bpy

from ...inference.image.layer import Layer
from ...inference.scene import SceneError
from ..objects.workload import Workload
from ..runtime.json_file import write_json
from ..settings.preferences import EXTENSION
from ..volumes.bounding_boxes import forget_densities
from .bake_cost import BAKE, BakeWork, calibrate_bake
from .cost_model import STAGES, Calibration, calibrate

FILE = "mrpnn_rates.json"
# Smaller changes of a machine's rates are not written.
TOLERANCE = 0.1

_known: Calibration | None = None


def calibration() -> Calibration:
    """The current calibration."""
    global _known
    if _known is None:
        _known = _read()
    return _known


def calibrate_by(workload: Workload | None, layer: Layer) -> None:
    """Calibrate by a render. workload: its work, or None without volumes."""
    if workload is None:
        return
    known = calibration()
    before = dict(known.rates)
    calibrate(known, workload, layer.report, layer.alpha)
    _keep_changed(known, before)


def calibrate_by_bake(work: BakeWork, threads: int, seconds: float) -> None:
    """Calibrate by a bake of all volumes that took so many seconds."""
    known = calibration()
    before = dict(known.rates)
    calibrate_bake(known, work, threads, seconds)
    _keep_changed(known, before)


def _keep_changed(known: Calibration, before: dict[str, float]) -> None:
    """Write rates that differ from those before."""
    if any(abs(rate - before.get(stage, 0.0)) > TOLERANCE * rate for stage, rate in known.rates.items()):
        _write(known)


def forget() -> None:
    """Start over as in a new session; for tests."""
    global _known
    _known = None


@bpy.app.handlers.persistent
def _after_load(*_: Any) -> None:
    # Another file's volumes may have the same names.
    calibration().shares.clear()
    calibration().bakes.clear()
    forget_densities()


def register() -> None:
    bpy.app.handlers.load_post.append(_after_load)


def unregister() -> None:
    bpy.app.handlers.load_post.remove(_after_load)


def _path() -> str:
    """File in the folder that Blender gives the extension for its data."""
    try:
        folder = bpy.utils.extension_path_user(EXTENSION, create=True)
    except ValueError:
        # A clone is not installed as an extension.
        folder = bpy.utils.user_resource("EXTENSIONS", path=".user", create=True)
    return os.path.join(folder, FILE)


def _read() -> Calibration:
    try:
        with open(_path()) as file:
            found = json.load(file)
        rates = {stage: float(found["rates"][stage]) for stage in (*STAGES, BAKE) if stage in found["rates"]}
        if all(0.0 < rate < math.inf for rate in rates.values()):
            return Calibration(rates=rates)
    except (OSError, ValueError, TypeError, KeyError):
        # The file is missing, or was written by another version.
        pass
    return Calibration()


def _write(known: Calibration) -> None:
    try:
        write_json(_path(), {"rates": known.rates})
    except SceneError:
        # Calibration is optional: ignore folders that cannot be written to.
        pass
