# SPDX-License-Identifier: GPL-3.0-or-later
"""JSON files that are complete or absent."""

import json
from typing import Any

from ...inference.scene import SceneError
from .atomic_write import atomic_write


def write_json(path: str, content: Any) -> None:
    """Write `content` to `path` atomically. Raises SceneError where the file cannot be written."""
    try:
        with atomic_write(path) as file:
            file.write((json.dumps(content, indent=1) + "\n").encode())
    except OSError as error:
        raise SceneError(str(error)) from None
