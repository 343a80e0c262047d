# SPDX-License-Identifier: GPL-3.0-or-later
"""The cost of a render, estimated without reading volumes: fast enough for a panel that is redrawn often."""

import os
from dataclasses import dataclass, field
from typing import Any

import bpy
import numpy as np

from ...inference.plan.lights import predicted_suns
from ...inference.plan.plan import merge_parallel
from ...inference.scene import Camera, SceneError, Settings, Sun
from ..nodes.material import shows_volume
from ..objects.camera import read_camera
from ..objects.lights import read_lamp, read_suns
from ..objects.placement import has_zero_scale, placement_problem
from ..objects.surfaces import is_transparent
from ..objects.views import wanted_views
from ..objects.visibility import LEFT_OUT, VisibleObject, hidden_from_camera, visible_objects
from ..objects.workload import Box, estimate_workload
from ..runtime.text import duration
from ..scene.film import sky_seconds
from ..settings.properties import scene_settings
from ..volumes.bounding_boxes import box_around
from ..world.lighting import lights_volumes
from .bake_cost import BakeWork, bake_work, estimate_bake
from .calibration import calibration
from .cost_model import estimate_seconds, is_rough


@dataclass
class Forecast:
    """volumes, suns: numbers of each; a soft sun counts as one, as do other lamps and the World. pixels: inside
    the bounds of volumes. points: predictions of the network, at most. seconds: of the render. warnings: of camera,
    lights and empty volumes. problem: why the scene cannot be rendered, or "". lamps: of all kinds. empty: number of
    volumes without voxels, which are left out. world: whether the World lights the volumes. rough: whether the density
    of the volumes is a guess because they have not been read.
    """

    volumes: int
    suns: int
    pixels: int
    points: int
    seconds: float
    warnings: list[str]
    problem: str = ""
    lamps: int = 0
    empty: int = 0
    world: bool = False
    rough: bool = False


@dataclass(frozen=True)
class BakeForecast:
    """work, threads: of a bake. seconds: it takes. rough: whether the density of volumes is a guess."""

    work: BakeWork
    threads: int
    seconds: float
    rough: bool

    def __str__(self) -> str:
        """A text such as "about 12 s"."""
        return f"{'roughly' if self.rough else 'about'} {duration(self.seconds)}"


def _read_light(shown: VisibleObject) -> tuple[list[Sun], int, list[str]]:
    """Bright suns and the number of bright lamps that a light is, and warnings."""
    try:
        if shown.data.type == "SUN":
            suns, noted = read_suns(shown)
            return [sun for sun in suns if np.any(sun.irradiance > 0.0)], 0, noted
        lamp, noted = read_lamp(shown)
        return [], int(lamp is not None and bool(np.any(lamp.power > 0.0))), noted
    except SceneError as problem:
        return [], 0, [f"{problem}{LEFT_OUT}"]


@dataclass
class _Contents:
    """What costs time in a scene.

    boxes: of volumes that are seen. empty: number of volumes without voxels. channels: of colour that are marched
    apart. lamps: their number. suns: bright ones. placed: bright lamps that are no suns. world: whether the World
    lights the volumes. surfaces: whether there are any. warnings: of camera, lights and empty volumes.
    """

    camera: Camera
    warnings: list[str]
    boxes: list[Box] = field(default_factory=list)
    channels: int = 1
    empty: int = 0
    lamps: int = 0
    suns: list[Sun] = field(default_factory=list)
    placed: int = 0
    world: bool = False
    surfaces: bool = False

    @property
    def sun_count(self) -> int:
        """Suns that are predicted."""
        suns = merge_parallel(self.suns)
        # Surfaces shadow each part of a soft sun differently.
        return len(suns if self.surfaces else predicted_suns(suns))


def _contents(depsgraph: "bpy.types.Depsgraph") -> _Contents:
    """Raises SceneError."""
    found = _Contents(*read_camera(depsgraph))
    for shown in visible_objects(depsgraph):
        if shows_volume(shown.object):
            if not (
                hidden_from_camera(shown, depsgraph.view_layer)
                or placement_problem(shown.matrix)
                or has_zero_scale(shown.matrix)
            ):
                box, different = box_around(shown)
                # Without a file, a volume's box is a point, and nothing of it is rendered.
                if np.any(box.high > box.low):
                    found.boxes.append(box)
                    found.channels = max(found.channels, different)
                else:
                    found.empty += 1
                    found.warnings.append(f'volume "{shown.name}" is empty, or its file is missing{LEFT_OUT}')
        elif shown.object.type == "LIGHT" and shown.visible_to("volume_scatter"):
            suns, others, noted = _read_light(shown)
            found.lamps += bool(suns or others)
            found.suns += suns
            found.placed += others
            found.warnings += noted
        elif shown.object.type == "MESH" and not is_transparent(shown.object):
            found.surfaces = True
    found.world = lights_volumes(depsgraph.scene.world)
    return found


def forecast(depsgraph: "bpy.types.Depsgraph") -> Forecast:
    """Estimate the render without reading volumes."""
    settings = scene_settings(depsgraph.scene).settings()
    try:
        found = _contents(depsgraph)
        sky = sky_seconds(depsgraph, found.camera)
    except SceneError as error:
        return Forecast(0, 0, 0, 0, 0.0, [], str(error))
    count = found.sun_count + found.placed + found.world
    more: dict[str, Any] = {
        "surfaces": found.surfaces,
        "lamps": found.placed,
        "worlds": int(found.world),
        "sky": sky,
    }
    workload = estimate_workload(found.boxes, found.camera, count, settings.depth_samples, found.channels, **more)
    points = workload.window * settings.depth_samples * workload.lights
    seconds = estimate_seconds(workload, _threads(settings), calibration())
    seconds *= max(len(wanted_views(depsgraph.scene.render)), 1)
    return Forecast(
        len(found.boxes),
        count,
        workload.window,
        points,
        seconds,
        found.warnings,
        lamps=found.lamps,
        empty=found.empty,
        world=found.world,
        rough=is_rough(workload, calibration()),
    )


def forecast_bake(depsgraph: "bpy.types.Depsgraph", directional: bool = True) -> BakeForecast | None:
    """Estimate a bake of all volumes without reading them; None where there is nothing to bake."""
    try:
        found = _contents(depsgraph)
    except SceneError:
        return None
    if not found.boxes or not found.lamps + found.world:
        return None
    lights = found.sun_count, found.placed, int(found.world)
    work = bake_work(found.boxes, found.camera, lights, found.surfaces, directional)
    threads = _threads(scene_settings(depsgraph.scene).settings())
    rough = any(box.filled is None for box in found.boxes)
    return BakeForecast(work, threads, estimate_bake(work, threads, calibration()), rough)


def _threads(settings: Settings) -> int:
    return settings.threads or os.cpu_count() or 1
