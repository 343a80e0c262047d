"""JSON files, complete or not at all."""

import json
import os
from pathlib import Path

from ..inference.scene import SceneError


def write_json(path: str, content) -> None:
    """Write `content` to `path`, which is replaced in one step. Raises SceneError where it cannot be written."""
    target = Path(path)
    unfinished = target.with_name(f".{target.name}.{os.getpid()}.part")
    try:
        unfinished.write_text(json.dumps(content, indent=1) + "\n")
        os.replace(unfinished, target)
    except OSError as error:
        if unfinished.exists():
            unfinished.unlink()
        raise SceneError(f"cannot write {path}: {error.strerror}") from None
