# SPDX-License-Identifier: GPL-3.0-or-later
"""Formatter, linter and type checker are clean, and every place that states a version states the same one."""

import re
import subprocess
import sys
import tomllib
from collections import Counter

import pytest

from tests.support.paths import ROOT

# Python files of one package.
MOST_FILES = 16


@pytest.mark.parametrize(
    "check",
    [("ruff", "check"), ("ruff", "format", "--check"), pytest.param(("mypy",), marks=pytest.mark.slow)],
    ids=" ".join,
)
def test_code_is_clean(check):
    run = subprocess.run([sys.executable, "-m", *check], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert run.returncode == 0, run.stdout[-5000:] + run.stderr[-5000:]


def test_modules_state_their_licence():
    tracked = subprocess.run(["git", "ls-files", "*.py"], cwd=ROOT, capture_output=True, text=True, check=True)
    modules = tracked.stdout.split()
    missing = [one for one in modules if "SPDX-License-Identifier: GPL-3.0-or-later" not in (ROOT / one).read_text()]
    assert len(modules) > 300 and not missing


PACKAGES = "inference", "evaluation", "mrpnn_addon", "operators", "panels", "training", "benchmarks", "gallery"


@pytest.mark.parametrize("package", PACKAGES)
def test_no_package_has_more_files_than_a_reader_overlooks(package):
    files = Counter(path.parent.relative_to(ROOT) for path in (ROOT / package).rglob("*.py"))
    assert {str(folder): count for folder, count in files.items() if count > MOST_FILES} == {}


def test_pre_commit_runs_the_versions_of_the_requirements():
    pinned = set(
        re.findall(
            r"^[\w.-]+==[\w.]+",
            "".join((ROOT / name).read_text() for name in ("requirements.txt", "requirements-dev.txt")),
            re.MULTILINE,
        )
    )
    hooks = set(re.findall(r"[\w.-]+==[\w.]+", (ROOT / ".pre-commit-config.yaml").read_text()))
    assert len(hooks) == 4 and hooks <= pinned


def test_the_version_is_that_of_the_manifest():
    version = tomllib.loads((ROOT / "blender_manifest.toml").read_text())["version"]
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    zips = {found for page in pages for found in re.findall(r"mrpnn-(\d[\d.]*\d)-\w+\.zip", page.read_text())}
    assert zips == {version}
    (cited,) = re.findall(r"^version: (.+)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE)
    assert cited == version
    oldest = tomllib.loads((ROOT / "blender_manifest.toml").read_text())["blender_version_min"].removesuffix(".0")
    assert all(f"Blender {oldest} " in (ROOT / page).read_text() for page in ("README.md", "docs/use/install.md"))
    # The newest entry of the changelog that has a number: of this version, or of the one before it.
    assert re.search(rf"^## (Unreleased|{re.escape(version)}\b)", (ROOT / "CHANGELOG.md").read_text(), re.MULTILINE)


def test_no_merge_is_half_done():
    """Nothing between the marks of a conflict is left in a file."""
    found = subprocess.run(["git", "grep", "-lE", "^(<{7}|>{7}) "], cwd=ROOT, capture_output=True, text=True)
    assert found.returncode == 1 and not found.stdout, found.stdout + found.stderr
