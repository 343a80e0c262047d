"""What holds for this machine, whatever scene is open: the extension's preferences."""

import bpy
from bpy.props import IntProperty

# The extension's own package, under which Blender keeps its preferences.
EXTENSION = __package__.rpartition(".")[0]
DEFAULT_THREADS, DEFAULT_MEMORY = 0, 8


class PreferenceProperties:
    """Properties of the preferences; the panel that draws them is a subclass."""

    threads: IntProperty(
        name="Threads", default=DEFAULT_THREADS, min=0, max=1024,
        description="Worker threads where the scene says nothing else; 0 uses one a core")
    memory_limit: IntProperty(
        name="Memory Limit", default=DEFAULT_MEMORY, min=1, max=1024,
        description="GiB that a render may use where the scene says nothing else; one that needs more is refused "
        "before it starts")


def machine_settings():
    """(threads, memory limit in GiB): from the preferences, or their defaults where there are none.

    Blender keeps no preferences of an extension that a script registered, or --addons enabled.
    """
    entry = bpy.context.preferences.addons.get(EXTENSION)
    if entry is None or entry.preferences is None:
        return DEFAULT_THREADS, DEFAULT_MEMORY
    return entry.preferences.threads, entry.preferences.memory_limit
