"""The networks as items of Blender's menus."""

import zlib

from ...inference import available_models

# Blender keeps no reference to the strings of a dynamic enum, so they live here.
_items = []


def model_number(name: str) -> int:
    """What files hold for a network: it must not depend on which other networks there are."""
    return zlib.crc32(name.encode()) & 0x7FFFFFFF


def model_items(_owner=None, _context=None):
    """Enum items: the networks in inference/weights."""
    _items[:] = [
        (name, name.upper().replace("_", " "), "Network that predicts multiple scattering", "NONE", model_number(name))
        for name in available_models()
    ]
    return _items
