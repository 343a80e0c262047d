# SPDX-License-Identifier: GPL-3.0-or-later
"""Settings with which Cycles shows baked light fast: light that is baked is nearly free of noise."""

import importlib
from typing import Any

import bpy

from .baked_scene import chooses_ray_marching, set_cycles

# Of the usual length of a step; error and bias grow little, see docs/use/baked-light.md.
STEP_RATE = 4.0


def fast_settings(scene: "bpy.types.Scene", volumes_alone: bool) -> dict:
    """Settings of Cycles, by name.

    volumes_alone: whether the scene shows nothing else, in the light of suns and the World. There one sample is enough,
    and the denoiser needs no albedo and normals, which say nothing in a volume. Surfaces, lamps and blur need what the
    scene has.
    """
    found: dict = {}
    # Blender 5 marches volumes with a larger bias, which longer steps raise.
    if not chooses_ray_marching(scene):
        found["volume_step_rate"] = STEP_RATE
    if _denoises():
        found["use_denoising"] = True
        if volumes_alone:
            found |= {"samples": 1, "denoising_input_passes": "RGB"}
    return found


def set_fast(scene: "bpy.types.Scene", volumes_alone: bool) -> str:
    """Set what `fast_settings` says, until `remove_light`; gives a sentence about it."""
    found = fast_settings(scene, volumes_alone)
    set_cycles(scene, **found)
    words = []
    if "volume_step_rate" in found:
        words.append(f"Step Rate Render {STEP_RATE:g}")
    if "samples" in found:
        words.append("1 sample")
    words.append("denoised" if "use_denoising" in found else "not denoised, which this Blender cannot")
    return f"Cycles renders the light with {', '.join(words)}; Remove Baked Light restores the settings"


def _denoises() -> bool:
    """Whether this build of Blender has OpenImageDenoise."""
    try:
        cycles: Any = importlib.import_module("_cycles")
    except ImportError:
        return False
    return bool(cycles.with_openimagedenoise)
