"""What a render will cost, from what can be known at once, for a panel that is drawn many times a second."""

import os
from dataclasses import dataclass
from typing import List

import numpy as np

from ..inference.plan import merge_parallel
from ..inference.scene import SceneError
from .camera import read_camera
from .cost_model import is_rough, seconds_of, work
from .experience import experience
from .lights import read_suns
from .material import shows_volume
from .visibility import shown_objects, why_unseen
from .volume_boxes import box_around
from .world import expected_lights


@dataclass
class Forecast:
    """volumes, suns: how many. pixels: inside the bounds of volumes. points: that the network
    predicts, at most. seconds: of the render. warnings: of camera and suns.
    problem: what keeps the scene from rendering, or "". rough: whether the volumes' density is a guess, since
    they have not been read.
    """

    volumes: int
    suns: int
    pixels: int
    points: int
    seconds: float
    warnings: List[str]
    problem: str = ""
    rough: bool = False


def forecast(depsgraph) -> Forecast:
    """Look at the scene without reading its volumes."""
    settings = depsgraph.scene.mrpnn.settings()
    try:
        camera, warnings = read_camera(depsgraph)
        boxes, channels, lights = [], 1, []
        for shown in shown_objects(depsgraph):
            if shows_volume(shown.object) and not why_unseen(shown, depsgraph.view_layer):
                box, different = box_around(shown)
                boxes.append(box)
                channels = max(channels, different)
            elif shown.object.type == 'LIGHT' and shown.object.data.type == 'SUN':
                suns, said = read_suns(shown)
                if shown.object.visible_volume_scatter:
                    lights += [sun for sun in suns if np.any(sun.irradiance > 0.0)]
                    warnings += said
        world = expected_lights(depsgraph.scene.world, lights, depsgraph.scene.mrpnn.world_directions)
    except SceneError as error:
        return Forecast(0, 0, 0, 0, 0.0, [], str(error))
    suns = len(merge_parallel(lights)) + world
    asked = work(boxes, camera, suns, settings.depth_samples, channels)
    points = asked.window * settings.depth_samples * suns
    seconds = seconds_of(asked, settings.threads or os.cpu_count() or 1, experience())
    return Forecast(len(boxes), suns, asked.window, points, seconds, warnings, rough=is_rough(asked, experience()))
