# SPDX-License-Identifier: GPL-3.0-or-later
"""The available networks as items of Blender's menus."""

import zlib
from typing import Any

from ...inference import Settings, available_models

_DEFAULT, _OTHER = "Least error and least time; the default", "For comparison with the paper: more error than MRPNN"
# Blender keeps no reference to the strings of a dynamic enum, so this list does.
_items: list[tuple[str, str, str, str, int]] = []


def model_number(name: str) -> int:
    """The number that .blend files store for a network; it does not depend on which other networks exist."""
    return zlib.crc32(name.encode()) & 0x7FFFFFFF


def model_items(_owner: Any = None, _context: Any = None) -> list[tuple[str, str, str, str, int]]:
    """Enum items, one per network in inference/weights."""
    _items[:] = [
        (
            name,
            name.upper().replace("_", " "),
            _DEFAULT if name == Settings.model else _OTHER,
            "NONE",
            model_number(name),
        )
        for name in available_models()
    ]
    return _items
