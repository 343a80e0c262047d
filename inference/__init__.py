# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumetric rendering with predicted multiple scattering; with numpy, and onnxruntime where it is installed.

layer = render([(volume, medium)], [sun], camera, Settings())
"""

from .baking.bake import bake
from .baking.lit_volume import LitVolume
from .image.layer import Layer
from .network.network import available_models, register_kind
from .network.ray_predictor import RAY
from .paper import register_paper
from .predict_multiple import predict_multiple
from .render import render, render_tiles
from .render_cache import RenderCache
from .runtime.report import Report
from .scene import (
    AreaLight,
    Camera,
    Cancelled,
    Environment,
    Lens,
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
    soft_sun,
)

# The kinds of networks that weights files may state.
register_kind("ray", RAY)
register_paper()

__all__ = [
    "AreaLight",
    "Camera",
    "Cancelled",
    "Environment",
    "Layer",
    "Lens",
    "LitVolume",
    "Medium",
    "Motion",
    "PointLight",
    "RenderCache",
    "Report",
    "SceneError",
    "Settings",
    "Shutter",
    "SparseGrid",
    "SpotLight",
    "Sun",
    "Surface",
    "Velocity",
    "Volume",
    "available_models",
    "bake",
    "predict_multiple",
    "render",
    "render_tiles",
    "soft_sun",
]
