# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that appear under their names only when they are complete, so that every command can be stopped and resumed."""

import contextlib
import os
import pathlib
import time

import numpy as np


@contextlib.contextmanager
def complete_file(path):
    """A binary file, written under a temporary name and renamed to `path` where nothing is raised."""
    partial = f"{path}.partial"
    with open(partial, "wb") as file:
        yield file
    os.replace(partial, path)


def write_rows(path: pathlib.Path, make_rows):
    """Write the arrays that `make_rows()` returns, a dict with one entry per row, to an npz file, unless it exists."""
    if path.exists():
        return
    start = time.perf_counter()
    rows = make_rows()
    with complete_file(path) as file:
        np.savez(file, **rows)
    print(f"{path.name}: {len(rows['gamma'])} rows in {time.perf_counter() - start:.1f} s", flush=True)
