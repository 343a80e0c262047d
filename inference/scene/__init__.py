# SPDX-License-Identifier: GPL-3.0-or-later
"""Description of a scene: volumes, media, lights, surfaces, the camera and the settings, as plain arrays."""

from ..runtime.cancellation import Cancelled
from .camera import Camera, Lens, Shutter
from .description import MAX_ANISOTROPY, MAX_IRRADIANCE, Medium, Motion, Sun, Surface, Velocity, Volume
from .environment import Environment
from .errors import SceneError
from .lamps import AreaLight, PointLight, SpotLight
from .light import Light
from .settings import Settings
from .soft_sun import soft_sun
from .sparse_grid import SparseGrid

__all__ = [
    "MAX_ANISOTROPY",
    "MAX_IRRADIANCE",
    "AreaLight",
    "Camera",
    "Cancelled",
    "Environment",
    "Lens",
    "Light",
    "Medium",
    "Motion",
    "PointLight",
    "SceneError",
    "Settings",
    "Shutter",
    "SparseGrid",
    "SpotLight",
    "Sun",
    "Surface",
    "Velocity",
    "Volume",
    "soft_sun",
]
