"""Files that are there complete or not at all."""

import os
import secrets
from contextlib import contextmanager


@contextmanager
def whole_file(path: str):
    """A binary file to write, which appears under `path` in one step at the end of the `with` block.

    Raises OSError, saying which file and why, where it cannot be written; then nothing is left of it, and a file that
    was there before stays as it was.
    """
    # Beside the target, so that it can be renamed; the name cannot be foreseen, and what exists is never opened.
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
