# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that are complete or absent, and their folders."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from typing import BinaryIO


def make_folder(path: str) -> None:
    """Make a folder, and those above it, where there is none. Raises OSError, naming it and the reason."""
    try:
        os.makedirs(path, exist_ok=True)
    except OSError as error:
        raise OSError(f"cannot make the folder {path}: {error.strerror or error}") from error


@contextmanager
def atomic_write(path: str) -> Iterator[BinaryIO]:
    """A binary file to write, renamed to `path` when the `with` block ends.

    Raises OSError, naming the file and the reason, where it cannot be written. An earlier file at `path` is then
    unchanged, and no partial file is left.
    """
    # In the target's folder, so that it can be renamed; the name is unpredictable, and an existing file is never
    # opened.
    unfinished = os.path.join(os.path.dirname(os.path.abspath(path)), f".mrpnn-{secrets.token_hex(8)}.part")
    try:
        with open(unfinished, "xb") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(unfinished, path)
    except OSError as error:
        raise OSError(f"cannot write {path}: {error.strerror or error}") from error
    finally:
        if os.path.exists(unfinished):
            os.unlink(unfinished)
