# SPDX-License-Identifier: GPL-3.0-or-later
"""The plan of a scene's render, found by reading the scene: for the panel, before rendering."""

from dataclasses import dataclass, field

import bpy

from ...inference.scene import SceneError
from ..baking.baked_scene import stale_light
from ..runtime.onnxruntime_version import check_runtime
from ..scene.changes import scene_state
from ..scene.kept_frame import goes_to
from ..scene.reader import read_frame
from ..settings.properties import scene_settings
from ..volumes.reader import VolumeReader


@dataclass
class SceneCheck:
    """error: why the scene cannot be rendered, or "". warnings: what is ignored or approximated, naming each object.
    planned, left_out: sentences of the plan. memory: bytes. voxels: grid shape by volume. state: `scene_state` of the
    scene.
    """

    state: tuple
    error: str = ""
    warnings: list[str] = field(default_factory=list)
    planned: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    memory: int = 0
    voxels: dict[str, tuple] = field(default_factory=dict)

    def outdated(self, scene: "bpy.types.Scene") -> bool:
        """Whether the scene has changed since, or is another one."""
        return self.state != scene_state(scene)


_last = None


def check_scene(depsgraph: "bpy.types.Depsgraph", reader: VolumeReader | None = None) -> SceneCheck:
    """Read the scene and plan its render; stored as `last_check`. reader: as of `read_frame`."""
    global _last
    # The evaluated scene's name and camera are those of the original.
    state, settings = scene_state(depsgraph.scene), scene_settings(depsgraph.scene).settings()
    try:
        warnings = check_runtime()
        scene = read_frame(depsgraph, reader, go_to=goes_to(depsgraph.scene.original))
        plan = scene.plan(settings)
        voxels = {volume.name: volume.density.shape for volume, _ in scene.volumes}
        _last = SceneCheck(
            state,
            warnings=[*scene.warnings, *warnings, *stale_light(depsgraph.scene.original, scene)],
            planned=plan.planned if plan else [],
            left_out=plan.left_out if plan else [],
            memory=plan.memory if plan else 0,
            voxels=voxels,
        )
    except SceneError as error:
        _last = SceneCheck(state, str(error))
    return _last


def forget() -> None:
    """Called when another file is loaded."""
    global _last
    _last = None


def last_check() -> "SceneCheck | None":
    """The SceneCheck, or None before the first."""
    return _last
