# SPDX-License-Identifier: GPL-3.0-or-later
"""What networks predict at single points, without a picture."""

import numpy as np

from .image.context import RenderContext
from .models.abilities import abilities
from .plan.detail import without_detail
from .points.group_radiance import GroupRadiance
from .render import prepare_scene
from .render_cache import RenderCache
from .runtime.progress import Progress
from .runtime.report import Report
from .runtime.tasks import Tasks
from .scene.camera import Camera
from .scene.description import Medium, Volume
from .scene.errors import SceneError
from .scene.light import Families, Light
from .scene.settings import Settings

# For the plan of a picture, of which there is none.
_NO_IMAGE = Camera(np.eye(4), resolution=(1, 1))


def predict_multiple(
    volume: Volume,
    medium: Medium,
    light: Light,
    positions: np.ndarray,
    directions: np.ndarray,
    model: str = "mrpnn",
) -> np.ndarray:
    """Multiple-scattered in-scattered radiance at points, as the network predicts it.

    light: of any kind. positions, directions: (N, 3) world positions and unit camera-ray directions. Returns float32
    (N, 3), W/(m^2 sr) for the light's strength, without the factor of the local albedo. Raises SceneError as `render`
    does, and for a lamp and a network that knows suns alone.
    """
    positions = np.asarray(positions, np.float64).reshape(-1, 3)
    directions = np.asarray(directions, np.float64).reshape(-1, 3)
    result = np.zeros((len(positions), 3), np.float32)
    if not len(positions):
        return result
    if Families.of([light]).lamps and not abilities(model).every_light:
        raise SceneError(f"{light.name}: the network {model} knows suns alone")
    settings, report = without_detail(Settings(model=model, threads=1)), Report()
    with Tasks(settings.threads) as tasks:
        context = RenderContext(settings, RenderCache(), tasks, Progress(None), report)
        scene = prepare_scene(context, [(volume, medium)], [light], _NO_IMAGE)
        for channels in scene.plan.channels:
            for g, _ in scene.predicted(channels):
                result += GroupRadiance(context, scene, g, channels)(positions, directions).T
    return result
