# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether objects change in time, so that one that shows nothing in a frame may show something in others."""

import os
import re
from collections.abc import Iterable, Iterator
from typing import Any

import bpy

from ..nodes.material import first_material, is_animated, shows_volume


def with_instanced(objects: "Iterable[bpy.types.Object]") -> "Iterator[bpy.types.Object]":
    """Objects and those of the collections that they instance."""
    ahead, seen = [list(objects)], set()
    while ahead:
        for shown in ahead.pop():
            yield shown
            collection = shown.instance_collection if shown.instance_type == "COLLECTION" else None
            if collection is not None and collection not in seen:
                seen.add(collection)
                ahead.append(list(collection.all_objects))


def volumes_change(objects: "Iterable[bpy.types.Object]") -> bool:
    """Whether any volume among objects changes in time, or what instances it."""
    return any(changes(shown) for shown in objects if shows_volume(shown) or shown.instance_type != "NONE")


def changes(shown: "bpy.types.Object") -> bool:
    """Whether keyframes, drivers, modifiers or the numbered files of a sequence change an object in time."""
    data: Any = shown.data
    keys = getattr(data, "shape_keys", None)
    return (
        any(_has_keyframes(block) for block in (shown, data, keys, shown.parent))
        or bool(len(shown.modifiers))
        or shown.type == "VOLUME" and data.is_sequence and _has_files(data)
        or shows_volume(shown) and is_animated(first_material(shown))
    )  # fmt: skip


def _has_keyframes(block: "bpy.types.ID | None") -> bool:
    found = getattr(block, "animation_data", None)
    return found is not None and (found.action is not None or bool(len(found.drivers)) or bool(len(found.nla_tracks)))


def _has_files(data: "bpy.types.Volume") -> bool:
    """Whether any file of a numbered sequence is there."""
    folder, name = os.path.split(bpy.path.abspath(data.filepath, library=data.library))
    number = re.search(r"\d+(?=\D*$)", name)
    if number is None or not os.path.isdir(folder):
        return False
    before, after = name[: number.start()], name[number.end() :]
    numbered = re.compile(rf"{re.escape(before)}\d+{re.escape(after)}")
    return any(numbered.fullmatch(file) for file in os.listdir(folder))
