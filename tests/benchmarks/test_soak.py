# SPDX-License-Identifier: GPL-3.0-or-later
"""Many renders in one Blender process leave nothing behind: a short run of benchmarks/stability/soak."""

import subprocess
import sys

import pytest

from benchmarks.support.pages import read_csv
from tests.support.paths import ROOT

pytest.importorskip("bpy")
pytestmark = pytest.mark.blender


@pytest.mark.slow
def test_forty_renders_need_no_more_memory_than_twenty(tmp_path):
    run = subprocess.run(
        [sys.executable, "-m", "benchmarks.stability.soak", "--renders", "40", "--figures", tmp_path / "soak.csv"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=900,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert len(read_csv(tmp_path / "soak.csv")) == 40
