"""What a render will cost, from what can be known at once, for a panel that is drawn many times a second."""

from dataclasses import dataclass
from typing import List

import numpy as np

from ..inference.scene.camera_rays import window_around
from ..inference.scene import Camera, SceneError
from .camera import read_camera
from .last_render import last_render
from .lights import read_suns
from .material import shows_volume
from .placement import scaled_to_nothing, why_unplaced
from .visibility import shown_objects, why_unseen
from .world import expected_lights

# Two cores of a desktop of 2020: a point that the network predicts, a pixel's ray, the fields of a
# volume and sun. A render of this session puts its own figure for points in their place.
SECONDS_A_POINT, SECONDS_A_PIXEL, SECONDS_A_FIELD = 8e-6, 1.3e-5, 0.8


@dataclass
class Forecast:
    """volumes, suns: how many, a soft sun and the World counting as several. pixels: inside the bounds of volumes.
    points: that the network predicts, at most. seconds: of the render, roughly. warnings: of camera and suns.
    problem: what keeps the scene from rendering, or "". lamps: sun lamps. world: whether the World lights the volumes.
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


def forecast(depsgraph) -> Forecast:
    """Look at the scene without reading its volumes."""
    try:
        camera, warnings = read_camera(depsgraph)
        covered, volumes, lamps, lights = np.zeros(camera.resolution[::-1], bool), 0, 0, []
        for shown in shown_objects(depsgraph):
            if shows_volume(shown.object):
                if not (why_unseen(shown, depsgraph.view_layer) or why_unplaced(shown.matrix)
                        or scaled_to_nothing(shown.matrix)):
                    volumes += 1
                    _cover(covered, camera, shown)
            elif shown.object.type == 'LIGHT' and shown.object.data.type == 'SUN':
                lamps += 1
                try:
                    suns, said = read_suns(shown)
                except SceneError as problem:
                    suns, said = [], [f"{problem} (left out)"]
                lights += suns
                warnings += said
        directions = expected_lights(depsgraph.scene.world, lights, depsgraph.scene.mrpnn.world_directions)
        suns = len(lights) + directions
    except SceneError as error:
        return Forecast(0, 0, 0, 0, 0.0, [], str(error))
    x0, y0, x1, y1 = camera.window
    pixels = int(covered[y0:y1, x0:x1].sum())
    points = pixels * depsgraph.scene.mrpnn.depth_samples * suns
    seconds = pixels * SECONDS_A_PIXEL + points * _seconds_a_point() + volumes * suns * SECONDS_A_FIELD
    return Forecast(volumes, suns, pixels, points, seconds, warnings, lamps=lamps, world=directions > 0)


def _seconds_a_point() -> float:
    last = last_render()
    # Small renders measure something else.
    if last is None or last.points < 10_000:
        return SECONDS_A_POINT
    return last.network_seconds / last.points


def _cover(covered: np.ndarray, camera: Camera, shown) -> None:
    """Mark the pixels around a volume's bounds."""
    corners = np.array([(*corner, 1.0) for corner in shown.object.bound_box]) @ shown.matrix.T
    left, top, right, bottom = window_around(camera, corners[:, :3])
    covered[top:bottom, left:right] = True
