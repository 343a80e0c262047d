"""Volumetric rendering with predicted multiple scattering; numpy and onnxruntime only.

    layer = render([(volume, medium)], [sun], camera, Settings())
"""

from .network import available_models
from .render import predict_multiple, render
from .report import Report
from .scene import Camera, Cancelled, Layer, Medium, SceneError, Settings, Sun, Volume

__all__ = [
    "Camera",
    "Cancelled",
    "Layer",
    "Medium",
    "Report",
    "SceneError",
    "Settings",
    "Sun",
    "Volume",
    "available_models",
    "predict_multiple",
    "render",
]
