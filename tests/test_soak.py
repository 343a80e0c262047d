"""Many renders in one Blender process leave nothing behind: a short run of benchmarks/stability/soak."""

import subprocess
import sys
from pathlib import Path

import pytest

from benchmarks.support.pages import read_csv

pytest.importorskip("bpy")

ROOT = Path(__file__).resolve().parents[1]


def test_forty_renders_need_no_more_memory_than_twenty(tmp_path):
    run = subprocess.run([sys.executable, "-m", "benchmarks.stability.soak", "--renders", "40",
                          "--figures", tmp_path / "soak.csv"],
                         cwd=ROOT, capture_output=True, text=True, timeout=900)
    assert run.returncode == 0, run.stdout + run.stderr
    assert len(read_csv(tmp_path / "soak.csv")) == 40
