"""Volumetric rendering with predicted multiple scattering; numpy and onnxruntime only.

    layer = render([(volume, medium)], [sun], camera, Settings())
"""

from .kept import Kept
from .layer import Layer, render
from .multiple import predict_multiple
from .network import available_models
from .report import Report
from .scene import Camera, Cancelled, Medium, SceneError, Settings, Sun, Volume
from .sparse_grid import SparseGrid
from .surfaces import Surface

__all__ = [
    "Camera",
    "Cancelled",
    "Kept",
    "Layer",
    "Medium",
    "Report",
    "SceneError",
    "Settings",
    "SparseGrid",
    "Sun",
    "Surface",
    "Volume",
    "available_models",
    "predict_multiple",
    "render",
]
