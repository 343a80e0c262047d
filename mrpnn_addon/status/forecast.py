"""What a render will cost, from what can be known at once, for a panel that is drawn many times a second."""

import os
from dataclasses import dataclass
from typing import List

import numpy as np

from ...inference.plan.plan import merge_parallel
from ...inference.scene import SceneError
from ..nodes.material import shows_volume
from ..objects.camera import read_camera
from ..objects.lights import read_suns
from ..objects.placement import scaled_to_nothing, why_unplaced
from ..objects.visibility import shown_objects, why_unseen
from ..objects.workload import estimate_workload
from ..volumes.bounding_boxes import box_around
from ..world.lighting import expected_lights
from .cost_model import is_rough, seconds_of
from .experience import experience


@dataclass
class Forecast:
    """volumes, suns: how many, a soft sun and the World counting as several. pixels: inside the bounds of volumes.
    points: that the network predicts, at most. seconds: of the render. warnings: of camera and suns. problem: what keeps
    the scene from rendering, or "". lamps: sun lamps. world: whether the World lights the volumes. rough: whether the
    density of the volumes is a guess, since they have not been read.
    """

    volumes: int
    suns: int
    pixels: int
    points: int
    seconds: float
    warnings: List[str]
    problem: str = ""
    lamps: int = 0
    world: bool = False
    rough: bool = False


def forecast(depsgraph) -> Forecast:
    """Look at the scene without reading its volumes."""
    settings = depsgraph.scene.mrpnn.settings()
    try:
        camera, warnings = read_camera(depsgraph)
        boxes, channels, lamps, lights = [], 1, 0, []
        for shown in shown_objects(depsgraph):
            if shows_volume(shown.object):
                if not (why_unseen(shown, depsgraph.view_layer) or why_unplaced(shown.matrix)
                        or scaled_to_nothing(shown.matrix)):
                    box, different = box_around(shown)
                    boxes.append(box)
                    channels = max(channels, different)
            elif shown.object.type == 'LIGHT' and shown.object.data.type == 'SUN':
                try:
                    suns, said = read_suns(shown)
                except SceneError as problem:
                    suns, said = [], [f"{problem} (left out)"]
                if shown.object.visible_volume_scatter:
                    bright = [sun for sun in suns if np.any(sun.irradiance > 0.0)]
                    lamps += bool(bright)
                    lights += bright
                    warnings += said
        world = expected_lights(depsgraph.scene.world, lights, depsgraph.scene.mrpnn.world_directions)
    except SceneError as error:
        return Forecast(0, 0, 0, 0, 0.0, [], str(error))
    suns = len(merge_parallel(lights)) + world
    asked = estimate_workload(boxes, camera, suns, settings.depth_samples, channels)
    points = asked.window * settings.depth_samples * suns
    seconds = seconds_of(asked, settings.threads or os.cpu_count() or 1, experience())
    return Forecast(len(boxes), suns, asked.window, points, seconds, warnings, lamps=lamps, world=world > 0,
                    rough=is_rough(asked, experience()))
