"""What holds for this machine, whatever scene is open: the extension's preferences."""

from dataclasses import dataclass

import bpy
from bpy.props import EnumProperty, IntProperty

from ...inference import Settings
from .models import model_items, model_number

# The extension's own package, under which Blender keeps its preferences.
# The extension's package, two above this one: bl_ext.<repository>.mrpnn.
EXTENSION = __package__.rsplit(".", 2)[0]
DEFAULT_THREADS, DEFAULT_MEMORY = 0, 8

# Names and descriptions of `inference.provider.PROVIDERS`. Numbers stand in files: new ones go to the end.
_OTHER = "; needs an onnxruntime built for it, otherwise the network runs on the processor and a warning says so"
_PROVIDER_ITEMS = [
    ('CPU', "Processor", "Always available", 0),
    ('CUDA', "CUDA", f"NVIDIA GPUs{_OTHER}", 1),
    ('DIRECTML', "DirectML", f"GPUs on Windows{_OTHER}", 2),
    ('COREML', "CoreML", f"macOS{_OTHER}", 3),
    ('OPENVINO', "OpenVINO", f"Intel processors and GPUs{_OTHER}", 4),
]


class PreferenceProperties:
    """Properties of the preferences; the panel that draws them is a subclass."""

    threads: IntProperty(
        name="Threads", default=DEFAULT_THREADS, min=0, max=1024,
        description="Number of render threads, for scenes that set none; 0 uses one per core")
    memory_limit: IntProperty(
        name="Memory Limit (GiB)", default=DEFAULT_MEMORY, min=1, max=1024,
        description="Memory that a render may use, in GiB, for scenes that set no limit; one that needs more is refused "
        "before it starts")
    model: EnumProperty(
        name="Network", items=model_items, default=model_number(Settings.model),
        description="Network that predicts multiple scattering, for scenes that choose none")
    provider: EnumProperty(
        name="Provider", items=_PROVIDER_ITEMS, default='CPU',
        description="Hardware that onnxruntime runs the network on")


@dataclass
class Machine:
    """memory_limit: GiB. model: of a weights file. provider: of `inference.provider.PROVIDERS`."""

    threads: int = DEFAULT_THREADS
    memory_limit: int = DEFAULT_MEMORY
    model: str = Settings.model
    provider: str = 'CPU'


def machine() -> Machine:
    """What the preferences say, or their defaults where there are none.

    Blender keeps no preferences of an extension that a script registered, or --addons enabled.
    """
    entry = bpy.context.preferences.addons.get(EXTENSION)
    if entry is None or entry.preferences is None:
        return Machine()
    found = entry.preferences
    # A number that stands for no network, as a later version may have left, reads as "".
    return Machine(found.threads, found.memory_limit, found.model or Settings.model, found.provider)
