# SPDX-License-Identifier: GPL-3.0-or-later
"""The matrix in Blender's Python module, and that its rows hold every pair."""

import itertools
import subprocess
import sys

import pytest

from tests.matrix.covering import covering_rows
from tests.support.paths import ROOT


def test_rows_hold_every_pair():
    dimensions = {"a": list("pqrst"), "b": list("uvw"), "c": list("xy"), "d": list("klmn")}
    rows = covering_rows(dimensions)
    for one, other in itertools.combinations(dimensions, 2):
        met = {(row[one], row[other]) for row in rows}
        assert met == set(itertools.product(dimensions[one], dimensions[other]))
    # 20 is the least, of every a with every d; all of them are 120.
    assert 20 <= len(rows) <= 26
    assert covering_rows(dimensions) == rows


def run_matrix(*arguments: str) -> None:
    pytest.importorskip("bpy")
    command = [sys.executable, "-m", "tests.matrix.run", *arguments]
    run = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=3600)
    assert run.returncode == 0, run.stdout[-20000:] + run.stderr[-3000:]


@pytest.mark.slow
def test_the_first_row_comes_through_quick_doors():
    run_matrix("--row", "0", "--door", "viewport", "render volumes", "command render")


@pytest.mark.slow(seconds=450)
def test_every_door_opens_for_every_feature():
    """Half of the rows; the others' doors are opened in Blender 5, by tests/package/test_matrix.py."""
    run_matrix("--first", "0", "--step", "2")
