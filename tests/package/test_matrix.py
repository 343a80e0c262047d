# SPDX-License-Identifier: GPL-3.0-or-later
"""The matrix of doors and features in a whole Blender program, with the installed extension."""

import re
import shutil
from pathlib import Path

import pytest

from tests.support.paths import ROOT
from tests.support.programs import BLENDERS, MARKS

pytestmark = MARKS


# The last one named, of Blender 5; the Python module's is 4.5.
@pytest.mark.slow(seconds=500)
@pytest.mark.parametrize("program", BLENDERS[-1:], indirect=True, ids=lambda path: Path(path).name)
def test_every_door_opens_for_every_feature(program):
    """Half of the rows; the others' doors are opened in Blender 4.5, by tests/matrix/test_matrix.py."""
    # What a Blender program sees, which may not see the repository.
    tests = program.folder / "tests"
    shutil.copytree(ROOT / "tests" / "matrix", tests / "matrix")
    (tests / "support").mkdir()
    shutil.copy(ROOT / "tests" / "support" / "blender_scenes.py", tests / "support")
    for folder in (tests, tests / "support"):
        (folder / "__init__.py").touch()
    process = program.start("-b", "--python", tests / "matrix" / "run.py", "--", "--first", "1", "--step", "2")
    out, error = process.communicate(timeout=3600)
    told = re.sub(r"^row .*: good \[[\d., ]+\]\n", "", out, flags=re.MULTILINE)
    assert process.returncode == 0, told[-20000:] + error[-3000:]
