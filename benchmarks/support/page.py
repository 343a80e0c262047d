"""Pages that benchmarks write."""

import os
from pathlib import Path


def replace(path: Path, text: str) -> None:
    """Write a page through a temporary name, so that it is never half there."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.part")
    partial.write_text(text)
    os.replace(partial, path)
