# SPDX-License-Identifier: GPL-3.0-or-later
"""Bakes the light of a scene that has been read and writes it to files, in the calling thread or on a worker thread."""

import os
import re
import secrets
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

from ... import inference
from ...inference import RenderCache
from ...inference.baking.directional_factor import DirectionalFactor, NodeGrid
from ...inference.plan.overlap import overlapping
from ...inference.scene import SceneError, Settings
from ..runtime.atomic_write import make_folder
from ..runtime.background import Worker
from ..runtime.onnxruntime_version import check_runtime
from ..scene.reader import SceneDescription
from ..vdb.light_file import TooSmall, brightness, write_light
from .content import light_keys, volume_names

# End of the keys of light for a first look, and what makes its bake fast.
COARSE = "-coarse"
COARSE_SETTINGS: dict[str, Any] = {"directional": False, "most_voxels": 48}


@dataclass(frozen=True)
class BakedVolume:
    """The baked light of one volume in one frame.

    name: of the volume, unique in the scene. key: of its content. path: of the file. scale: by which the light in it
    is divided. directional: of the light, for the material, without coefficients.
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

    folder: of the files, which exists or can be made. keys: by name, of what is baked already and stays. coarse:
    whether light is baked for a first look, on a coarse lattice and from the camera only; its keys end in COARSE.
    known: by key, light that is baked already but not shown. cache: of earlier bakes, or None.
    """

    folder: str
    keys: dict[str, str] = field(default_factory=dict)
    coarse: bool = False
    known: dict[str, BakedVolume] = field(default_factory=dict)
    cache: RenderCache | None = None


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
    shown = {name: key.removesuffix(COARSE) if target.coarse else key for name, key in target.keys.items()}
    # Overlapping volumes share their light.
    stale = [g for g in overlapping(scene.volumes)[0] if any(shown.get(names[v]) != keys[v] for v in g)]
    known = [group for group in stale if all(keys[v] in target.known for v in group)]
    baked = [replace(target.known[keys[v]], name=names[v]) for group in known for v in group]
    wanted = sorted(v for group in stale if group not in known for v in group)
    if not wanted:
        return BakedScene(scene.frame, baked, names, 0.0, warnings, settings.directional)
    # Before the work, which a folder that cannot be made would waste.
    make_folder(target.folder)
    try:
        lit = inference.bake(
            [scene.volumes[v] for v in wanted],
            scene.lights,
            scene.camera,
            replace(settings, **COARSE_SETTINGS) if target.coarse else settings,
            progress,
            cancelled,
            target.cache,
            surfaces=scene.surfaces,
        )
    except MemoryError:
        raise SceneError("not enough memory for this bake; resample the grids, or close other programs") from None
    for v, one in zip(wanted, lit):
        name, seconds = names[v], one.report.seconds["total"]
        # Blender caches files by path: every bake has names of its own.
        path = os.path.join(target.folder, f"{file_name(name)}-{secrets.token_hex(4)}_{scene.frame:04d}.vdb")
        scale = brightness(one)
        try:
            write_light(path, one, scale)
        except TooSmall:
            warnings.append(
                f'not baked, so it scatters light once only: volume "{name}" is too small; scale the scene up'
            )
            continue
        key = keys[v] + COARSE * target.coarse
        baked.append(BakedVolume(name, key, path, scale, _for_material(one.directional)))
    return BakedScene(scene.frame, baked, names, seconds, warnings + lit[0].report.warnings, settings.directional)


def _for_material(factor: DirectionalFactor | None) -> DirectionalFactor | None:
    """A factor without its coefficients, which are in the file: many frames and updates are kept."""
    if factor is None:
        return None
    colours = None if factor.colours is None else _emptied(factor.colours)
    return replace(factor, smooth=_emptied(factor.smooth), anchors=_emptied(factor.anchors), colours=colours)


def _emptied(nodes: NodeGrid) -> NodeGrid:
    return replace(nodes, values=nodes.values[:0, :0, :0].copy())


def file_name(name: str) -> str:
    """The beginning of a volume's files."""
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
