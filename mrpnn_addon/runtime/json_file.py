# SPDX-License-Identifier: GPL-3.0-or-later
"""JSON files that are complete or absent."""

import json
import os

from ...inference.scene import SceneError
from .atomic_write import atomic_write


def write_json(path: str, content) -> None:
    """Write `content` to `path` atomically, in a folder that is made if need be.

    Raises SceneError where the file cannot be written.
    """
    try:
        os.makedirs(os.path.dirname(os.path.abspath(path)), exist_ok=True)
        with atomic_write(path) as file:
            file.write((json.dumps(content, indent=1) + "\n").encode())
    except OSError as error:
        raise SceneError(str(error)) from None
