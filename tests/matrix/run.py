# SPDX-License-Identifier: GPL-3.0-or-later
"""Sends the matrix' rows through their doors, in the Blender that runs it.

python -m tests.matrix.run [--row 17] [--door bake] [--first 0 --step 10] [--json results.json]
blender -b --python tests/matrix/run.py -- [the same]

A row is checked and sent through its own door, or through the one that is named. Prints a line for each fault,
with the row's number, its values and its door. The exit status is 1 where there is a fault.
"""

import argparse
import json
import os
import sys
import tempfile
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType

import bpy

# Started as a script, in a Blender program.
sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.matrix.covering import Row, covering_rows
from tests.matrix.doors import DOORS, Shot, check_scene
from tests.matrix.features import DIMENSIONS, build

# What the console must never hold.
FAULTS = ("Traceback", "which is a bug", "Error in ", "RuntimeWarning")


def matrix() -> list[Row]:
    """The rows, the same in every version of Blender."""
    return covering_rows({**{name: list(values) for name, values in DIMENSIONS.items()}, "door": list(DOORS)})


def extension() -> ModuleType:
    """The installed extension, or in the bpy module that of the repository."""
    for name in bpy.context.preferences.addons.keys():
        if name.endswith(".mrpnn"):
            return sys.modules[name]
    from benchmarks.support.extension import extension as from_repository

    return from_repository()


def coarsen(package: ModuleType) -> None:
    """Halve the cells along an edge of the working cube and of its transport: doors agree at any resolution, and a
    scene as small as these takes most of its time for cells that show nothing more.
    """
    for name, module in list(sys.modules.items()):
        if name.startswith(f"{package.__name__}.inference."):
            for constant in ("LEVEL0_CELLS", "TRANSPORT_CELLS"):
                if hasattr(module, constant):
                    setattr(module, constant, getattr(module, constant) // 2)


@contextmanager
def console(file: Path) -> Iterator[None]:
    """All that the process prints goes to a file, what Blender itself prints included."""
    sys.stdout.flush()
    sys.stderr.flush()
    kept = os.dup(1), os.dup(2)
    with open(file, "wb") as into:
        os.dup2(into.fileno(), 1)
        os.dup2(into.fileno(), 2)
    try:
        yield
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        for number, old in zip((1, 2), kept):
            os.dup2(old, number)
            os.close(old)


def faults_of(row: Row, door: str, package: ModuleType, folder: Path) -> list[str]:
    """What is wrong with a row, after a door."""
    found, said = [], folder / "console.txt"
    with console(said):
        try:
            shot = Shot(row, build(row, folder), package)
            check_scene(shot)
            DOORS[door](shot)
        except AssertionError as error:
            found.append(str(error))
        except Exception:
            found.append(traceback.format_exc())
    text = said.read_text(errors="replace")
    found += [f"the console says: {line}" for line in text.splitlines() if any(fault in line for fault in FAULTS)]
    if found:
        found.append("console:\n" + text[-3000:])
    return found


def main(arguments: list[str]) -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.matrix.run")
    parser.add_argument("--row", type=int, nargs="+", help="numbers of rows; all of them without it")
    parser.add_argument("--door", choices=list(DOORS), nargs="+", help="instead of the rows' own")
    parser.add_argument("--first", type=int, default=0, help="number of the first row")
    parser.add_argument("--step", type=int, default=1, help="2: every other row")
    parser.add_argument("--json", metavar="FILE", help="for the results")
    options = parser.parse_args(arguments)
    rows = list(enumerate(matrix()))
    rows = rows[options.first :: options.step] if options.row is None else [rows[number] for number in options.row]
    package, results = extension(), []
    coarsen(package)
    for number, row, door in [(*one, door) for one in rows for door in options.door or [one[1]["door"]]]:
        begin = time.perf_counter(), time.process_time()
        with tempfile.TemporaryDirectory(prefix="matrix-") as folder:
            faults = faults_of(row, door, package, Path(folder))
        spent = [round(now - then, 3) for now, then in zip((time.perf_counter(), time.process_time()), begin)]
        results.append(dict(row=number, values=row, door=door, faults=faults, seconds=spent))
        values = ", ".join(f"{name}: {value}" for name, value in row.items() if name != "door")
        print(f"row {number} --door {door!r} ({values}): {'; '.join(faults) or 'good'} {spent}", flush=True)
    faulty = sum(bool(result["faults"]) for result in results)
    print(f"{faulty} of {len(results)} have faults, Blender {bpy.app.version_string}", flush=True)
    if options.json:
        Path(options.json).write_text(json.dumps(results))
    return int(faulty > 0)


if __name__ == "__main__":
    # A Blender program leaves the script what follows two dashes.
    status = main(sys.argv[sys.argv.index("--") + 1 :] if bpy.app.binary_path else sys.argv[1:])
    sys.stdout.flush()
    # The bpy module may hang at the end of a process in which something refers to its types.
    os._exit(status)
