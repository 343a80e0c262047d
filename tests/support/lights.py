# SPDX-License-Identifier: GPL-3.0-or-later
"""One light of every class, and the classes of descriptions that are no lights."""

import numpy as np

from inference.scene import (
    AreaLight,
    Camera,
    Cancelled,
    Environment,
    Lens,
    Light,
    Medium,
    Motion,
    PointLight,
    SceneError,
    Settings,
    Shutter,
    SparseGrid,
    SpotLight,
    Sun,
    Surface,
    Velocity,
    Volume,
)

NO_LIGHTS = {
    Camera,
    Cancelled,
    Lens,
    Light,
    Medium,
    Motion,
    SceneError,
    Settings,
    Shutter,
    SparseGrid,
    Surface,
    Velocity,
    Volume,
}


def one_of_each():
    """Lights around a unit cube at the origin, about as bright there as each other."""
    above = np.eye(4)
    above[2, 3] = 2.0
    image = np.full((8, 16, 3), 0.1, np.float32)
    image[:4] *= 2.0
    return [
        Sun((0.4, 0.3, 0.8), (1.5, 2.0, 1.0)),
        PointLight((0.0, 2.0, 0.5), 90.0, radius=0.1),
        SpotLight((0.0, 0.0, 2.5), (0.0, 0.1, -1.0), (130.0, 90.0, 50.0), angle=0.5, blend=0.3),
        AreaLight(above, "disk", 0.8, 20.0),
        Environment(image),
    ]
