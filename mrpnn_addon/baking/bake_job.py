# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes the light of a scene that has been read and writes it to files, in the calling thread or on a worker thread."""

import os
import re
import secrets
from collections.abc import Callable
from dataclasses import dataclass, field

from ... import inference
from ...inference.baking.directional_factor import DirectionalFactor
from ...inference.plan.overlap import overlapping
from ...inference.scene import SceneError, Settings
from ..runtime.atomic_write import make_folder
from ..runtime.background import Worker
from ..runtime.onnxruntime_version import check_runtime
from ..scene.reader import SceneDescription
from ..vdb.light_file import brightness, write_light
from .content import light_keys, volume_names


@dataclass(frozen=True)
class BakedVolume:
    """The baked light of one volume in one frame.

    name: of the volume, unique in the scene. key: of its content. path: of the file. scale: by which the light in it
    is divided. directional: of the light, for the material.
    """

    name: str
    key: str
    path: str
    scale: float
    directional: DirectionalFactor | None


@dataclass
class BakedScene:
    """One frame's baked light. volumes: that were baked. names: of all volumes of the frame. seconds: of the bake.
    directional: whether other directions were baked.
    """

    frame: int
    volumes: list[BakedVolume]
    names: list[str]
    seconds: float
    warnings: list[str]
    directional: bool = True


@dataclass
class BakeTarget:
    """Where light goes.

    folder: of the files, which exists or can be made. keys: by name, of what is baked already and stays. scales: by
    name, of earlier frames of a sequence, whose files are all divided by one value; extended. names: by name, beginning
    of a sequence's files; extended.
    """

    folder: str
    keys: dict[str, str] = field(default_factory=dict)
    scales: dict[str, float] = field(default_factory=dict)
    names: dict[str, str] = field(default_factory=dict)


def bake_scene(
    scene: SceneDescription,
    settings: Settings,
    target: BakeTarget,
    progress: Callable[[float, str], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> BakedScene:
    """Bake what has changed of a scene's light. Calls no bpy, so any thread may call this.

    Raises SceneError for what cannot be baked, Cancelled when `cancelled()` returns True, and OSError where a file
    cannot be written.
    """
    warnings = [*scene.warnings, *check_runtime()]
    names, seconds = volume_names(scene), 0.0
    if not scene.volumes:
        return BakedScene(scene.frame, [], names, 0.0, warnings, settings.directional)
    keys = light_keys(scene, settings)
    stale = [v for v, name in enumerate(names) if target.keys.get(name) != keys[v]]
    # Overlapping volumes share their light.
    wanted = sorted(v for group in overlapping(scene.volumes)[0] for v in group if stale and set(group) & set(stale))
    if not wanted:
        return BakedScene(scene.frame, [], names, 0.0, warnings, settings.directional)
    # Before the work, which a folder that cannot be made would waste.
    make_folder(target.folder)
    try:
        lit = inference.bake(
            [scene.volumes[v] for v in wanted],
            scene.lights,
            scene.camera,
            settings,
            progress,
            cancelled,
            surfaces=scene.surfaces,
        )
    except MemoryError:
        raise SceneError("not enough memory for this bake; resample the grids, or close other programs") from None
    baked = []
    for v, one in zip(wanted, lit):
        name, seconds = names[v], one.report.seconds["total"]
        # Blender caches files by path: every bake has names of its own.
        stem = target.names.setdefault(name, f"{_file_name(name)}-{secrets.token_hex(4)}")
        scale = target.scales.setdefault(name, brightness(one))
        path = os.path.join(target.folder, f"{stem}_{scene.frame:04d}.vdb")
        write_light(path, one, scale)
        baked.append(BakedVolume(name, keys[v], path, scale, one.directional))
    return BakedScene(scene.frame, baked, names, seconds, warnings + lit[0].report.warnings, settings.directional)


def _file_name(name: str) -> str:
    return re.sub(r"[^A-Za-z0-9_-]+", "-", name).strip("-")[:40] or "volume"


class BakeJob(Worker):
    """bake_scene on a worker thread. result: a BakedScene when done, or None with `error` set."""

    def __init__(self, scene: SceneDescription, settings: Settings, target: BakeTarget) -> None:
        self.result: BakedScene | None = None
        self._task = scene, settings, target
        self._start("mrpnn bake", awaited=True)

    def _work(self) -> None:
        self.result = bake_scene(*self._task, self._progress, lambda: self.stopped)

    def _progress(self, fraction: float, message: str) -> None:
        self.fraction, self.message = fraction, message
