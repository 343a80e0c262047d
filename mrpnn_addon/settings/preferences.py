# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension's preferences: settings of this machine, whatever scene is open."""

from dataclasses import dataclass
from typing import Any

import bpy
from bpy.props import EnumProperty, IntProperty

from ...inference import Settings
from .models import model_items, model_number

# The extension's package, two above this one: bl_ext.<repository>.mrpnn. Blender stores its preferences under that
# name.
EXTENSION = __package__.rsplit(".", 2)[0]
DEFAULT_THREADS, DEFAULT_MEMORY = 0, 8

# Names and descriptions of `inference.network.provider.PROVIDERS`. Files store the numbers: append new ones.
_OTHER = "; needs an onnxruntime built for it. Without one, the processor runs the network, with a warning"
_PROVIDER_ITEMS = [
    ("CPU", "Processor", "Always available", 0),
    ("CUDA", "CUDA", f"NVIDIA GPUs{_OTHER}", 1),
    ("DIRECTML", "DirectML", f"GPUs on Windows{_OTHER}", 2),
    ("COREML", "CoreML", "Apple's graphics and neural processors, on macOS", 3),
    ("OPENVINO", "OpenVINO", f"Intel processors and GPUs{_OTHER}", 4),
]


class PreferenceProperties:
    """Properties of the preferences, without the panel that draws them."""

    threads: IntProperty(
        name="Threads",
        default=DEFAULT_THREADS,
        min=0,
        max=1024,
        description="Number of render threads, for scenes that set none; 0 uses one per core",
    )
    memory_limit: IntProperty(
        name="Memory Limit (GiB)",
        default=DEFAULT_MEMORY,
        min=1,
        max=1024,
        description="Memory that a render may use, in GiB, for scenes that set no limit. Where it needs more, the "
        "largest volumes lose resolution, or the render is refused",
    )
    model: EnumProperty(
        name="Network",
        items=model_items,
        default=model_number(Settings.model),
        description="Network that predicts multiple scattering, for scenes that do not choose one",
    )
    provider: EnumProperty(
        name="Device",
        items=_PROVIDER_ITEMS,
        default="CPU",
        description="Hardware that runs the network",
    )


@dataclass
class Machine:
    """The machine's settings. memory_limit: GiB. model: name of a weights file. provider: a key of
    `inference.network.provider.PROVIDERS`.
    """

    threads: int = DEFAULT_THREADS
    memory_limit: int = DEFAULT_MEMORY
    model: str = Settings.model
    provider: str = "CPU"


def machine() -> Machine:
    """The preferences, or their defaults where there are none.

    Blender stores no preferences for an extension that a script registered or that `--addons` enabled.
    """
    entry: Any = bpy.context.preferences.addons.get(EXTENSION)
    if entry is None or entry.preferences is None:
        return Machine()
    found = entry.preferences
    # A number of no available network, written by another version, reads as "".
    return Machine(found.threads, found.memory_limit, found.model or Settings.model, found.provider)
