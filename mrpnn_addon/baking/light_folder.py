# SPDX-License-Identifier: GPL-3.0-or-later
"""Folders of baked light: beside the .blend file, or temporary ones."""

import os

import bpy

FOLDER = "//baked_light"


def light_folder(folder: str = FOLDER) -> str:
    """The absolute path of a folder of baked light; a temporary one beside no .blend file."""
    if folder.startswith("//") and not bpy.data.filepath:
        return os.path.join(bpy.app.tempdir, "baked_light")
    return os.path.abspath(bpy.path.abspath(folder))


def is_within(path: str, folder: str) -> bool:
    """Whether an absolute path lies in a folder or below it."""
    return os.path.realpath(path).startswith(os.path.join(os.path.realpath(folder), ""))
