# SPDX-License-Identifier: GPL-3.0-or-later
"""The cost of a render, estimated without reading volumes: fast enough for a panel that is redrawn often."""

import os
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...inference.plan.lights import predicted_suns
from ...inference.plan.plan import merge_parallel
from ...inference.scene import SceneError, Sun
from ..nodes.material import shows_volume
from ..objects.camera import read_camera
from ..objects.lights import read_lamp, read_suns
from ..objects.placement import has_zero_scale, placement_problem
from ..objects.surfaces import is_transparent
from ..objects.views import wanted_views
from ..objects.visibility import VisibleObject, hidden_from_camera, visible_objects
from ..objects.workload import estimate_workload
from ..scene.film import sky_seconds
from ..settings.properties import scene_settings
from ..volumes.bounding_boxes import box_around
from ..world.lighting import lights_volumes
from .calibration import calibration
from .cost_model import estimate_seconds, is_rough


@dataclass
class Forecast:
    """volumes, suns: numbers of each; a soft sun counts as one, as do other lamps and the World. pixels: inside
    the bounds of volumes. points: predictions of the network, at most. seconds: of the render. warnings: of camera and
    lights. problem: why the scene cannot be rendered, or "". lamps: of all kinds. world: whether the World lights the
    volumes. rough: whether the density of the volumes is a guess because they have not been read.
    """

    volumes: int
    suns: int
    pixels: int
    points: int
    seconds: float
    warnings: list[str]
    problem: str = ""
    lamps: int = 0
    world: bool = False
    rough: bool = False


def _read_light(shown: VisibleObject) -> tuple[list[Sun], int, list[str]]:
    """Bright suns and the number of bright lamps that a light is, and warnings."""
    try:
        if shown.data.type == "SUN":
            suns, noted = read_suns(shown)
            return [sun for sun in suns if np.any(sun.irradiance > 0.0)], 0, noted
        lamp, noted = read_lamp(shown)
        return [], int(lamp is not None and bool(np.any(lamp.power > 0.0))), noted
    except SceneError as problem:
        return [], 0, [f"{problem} (left out)"]


def forecast(depsgraph: "bpy.types.Depsgraph") -> Forecast:
    """Estimate the render without reading volumes."""
    settings = scene_settings(depsgraph.scene).settings()
    try:
        camera, warnings = read_camera(depsgraph)
        boxes, channels, volumes, lamps, lights, placed, surfaces = [], 1, 0, 0, [], 0, False
        for shown in visible_objects(depsgraph):
            if shows_volume(shown.object):
                if not (
                    hidden_from_camera(shown, depsgraph.view_layer)
                    or placement_problem(shown.matrix)
                    or has_zero_scale(shown.matrix)
                ):
                    box, different = box_around(shown)
                    volumes += 1
                    # Without a file, a volume's box is a point, and nothing of it is rendered.
                    if np.any(box.high > box.low):
                        boxes.append(box)
                        channels = max(channels, different)
            elif shown.object.type == "LIGHT" and shown.visible_to("volume_scatter"):
                suns, others, noted = _read_light(shown)
                lamps += bool(suns or others)
                lights += suns
                placed += others
                warnings += noted
            elif shown.object.type == "MESH" and not is_transparent(shown.object):
                surfaces = True
        world = lights_volumes(depsgraph.scene.world)
        sky = sky_seconds(depsgraph, camera)
    except SceneError as error:
        return Forecast(0, 0, 0, 0, 0.0, [], str(error))
    suns = merge_parallel(lights)
    # Surfaces shadow each part of a soft sun differently.
    count = len(suns if surfaces else predicted_suns(suns)) + placed + world
    more: dict[str, Any] = {"surfaces": surfaces, "lamps": placed, "worlds": int(world), "sky": sky}
    workload = estimate_workload(boxes, camera, count, settings.depth_samples, channels, **more)
    points = workload.window * settings.depth_samples * workload.lights
    seconds = estimate_seconds(workload, settings.threads or os.cpu_count() or 1, calibration())
    seconds *= max(len(wanted_views(depsgraph.scene.render)), 1)
    return Forecast(
        volumes,
        count,
        workload.window,
        points,
        seconds,
        warnings,
        lamps=lamps,
        world=world,
        rough=is_rough(workload, calibration()),
    )
