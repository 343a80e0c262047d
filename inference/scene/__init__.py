"""Description of a scene: volumes, media, lights, surfaces, the camera and the settings, as plain arrays."""

from ..runtime.cancellation import Cancelled
from .camera import Camera
from .description import ANISOTROPY_MOST, IRRADIANCE_MOST, Medium, Sun, Surface, Volume
from .errors import SceneError
from .settings import Settings
from .sparse_grid import SparseGrid

__all__ = [
    "ANISOTROPY_MOST",
    "Camera",
    "Cancelled",
    "IRRADIANCE_MOST",
    "Medium",
    "SceneError",
    "Settings",
    "SparseGrid",
    "Sun",
    "Surface",
    "Volume",
]
