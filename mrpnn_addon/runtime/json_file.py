"""JSON files, complete or not at all."""

import json

from ...inference.scene import SceneError
from .whole_file import whole_file


def write_json(path: str, content) -> None:
    """Write `content` to `path`, which is replaced in one step. Raises SceneError where it cannot be written."""
    try:
        with whole_file(path) as file:
            file.write((json.dumps(content, indent=1) + "\n").encode())
    except OSError as error:
        raise SceneError(str(error)) from None
