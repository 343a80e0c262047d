# SPDX-License-Identifier: GPL-3.0-or-later
"""What a release states: one version everywhere, the changelog's date, and checksums that tools can check."""

import datetime
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile

import pytest

from packages import archives, kernels, metadata, release
from tests.support.paths import ROOT

NEW, DAY = "12.34.56", datetime.date(2030, 1, 2)


@pytest.fixture
def copy(tmp_path):
    """A folder with the files that a release changes."""
    for name in [*release.STATED, "CHANGELOG.md"]:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


def test_a_new_version_is_stated_everywhere(copy):
    release.set_version(NEW, copy)
    assert tomllib.loads((copy / "blender_manifest.toml").read_text())["version"] == NEW
    for name in release.STATED:
        text = (copy / name).read_text()
        assert NEW in text and not re.search(rf"(?<![\d.]){re.escape(metadata.version())}(?![\d.])", text), name
    for wrong in ("1.2", "v1.2.3", "1.2.3rc1"):
        with pytest.raises(SystemExit, match="three numbers"):
            release.set_version(wrong, copy)


def test_a_file_of_another_version_is_named(copy):
    (copy / "CITATION.cff").write_text("version: 0.0.9\n")
    with pytest.raises(SystemExit, match="CITATION.cff does not state"):
        release.set_version(NEW, copy)


def test_the_changelog_gets_version_and_day(copy):
    release.date_changelog(NEW, DAY, copy)
    assert f"\n## {NEW} (2030-01-02)\n" in (copy / "CHANGELOG.md").read_text()
    with pytest.raises(SystemExit, match="Unreleased"):
        release.date_changelog(NEW, DAY, copy)


def test_checksums_can_be_checked(tmp_path):
    lines = release.checksums([ROOT / "LICENSE", ROOT / "docs" / "use" / "install.md"])
    (tmp_path / "SUMS").write_text(lines)
    subprocess.run(["sha256sum", "--check", "--quiet", tmp_path / "SUMS"], cwd=ROOT, check=True)


@pytest.mark.slow
def test_a_release_has_the_gallery_as_templates(tmp_path):
    pytest.importorskip("bpy")
    made = release.build_gallery(NEW, ["fog", "plume", "--detail", "0.2"], tmp_path)
    assert made == tmp_path / f"mrpnn-gallery-{NEW}.zip"
    with zipfile.ZipFile(made) as archive:
        names = set(archive.namelist())
    starts = {"Volumes_Smoke/startup.blend", "Volumes_Fog_in_a_church/startup.blend"}
    assert starts | {"Volumes_Smoke/__init__.py"} <= names
    assert len([name for name in names if name.startswith("Volumes_Smoke/volumes/")]) == 1


def test_the_source_distribution_has_all_that_compiles_and_the_same_bytes_each_time(tmp_path):
    (tmp_path / "again").mkdir()
    made = kernels.build_sdist(tmp_path)
    assert made.read_bytes() == kernels.build_sdist(tmp_path / "again").read_bytes()
    with tarfile.open(made) as archive:
        names = {name.partition("/")[2] for name in archive.getnames()}
        settings = archive.extractfile(f"{made.name.removesuffix('.tar.gz')}/pyproject.toml").read().decode()
    assert {str(path.relative_to(ROOT)) for path in (ROOT / "inference" / "kernels").glob("*.[ch]")} <= names
    assert {"LICENSE", "README.md", "PKG-INFO", "packages/backend.py", "inference/kernels/build.py"} <= names
    assert tomllib.loads(settings)["project"]["version"] == metadata.version()


def test_a_wheels_record_lists_every_file(tmp_path):
    text = metadata.core_metadata(
        {"name": "a-b", "version": "1.0.0", "description": "c", "authors": [{"name": "d"}], "license": "MIT",
         "license-files": [], "requires-python": ">=3.9"}, "e"
    )  # fmt: skip
    wheel = archives.write_wheel(tmp_path, text, "py3-none-any", {"a_b/__init__.py": b"value = 3\n"})
    assert wheel.name == "a_b-1.0.0-py3-none-any.whl"
    site = tmp_path / "site"
    # Pip checks names, metadata and, in RECORD, all files.
    pip = ["-m", "pip", "install", "--quiet", "--no-index", "--disable-pip-version-check", "--target", site, wheel]
    subprocess.run([sys.executable, *pip], check=True)
    assert (site / "a_b" / "__init__.py").read_text() == "value = 3\n"
