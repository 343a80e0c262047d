# SPDX-License-Identifier: GPL-3.0-or-later
"""Prepare a release: version, changelog, zips, wheels, and a list of their checksums.

    python3.11 run.py release [0.2.0]

With a version, enters it wherever it is stated, and gives it and today's date to the changelog's section of unreleased
changes. Then builds the zips into build/, the gallery's templates included, and the wheels and source distribution of
mrpnn-kernels into wheels/, and writes build/SHA256SUMS. The same sources give the same bytes, but for the gallery:
.blend files hold addresses of memory. Publishing them is left to a person: see docs/contribute/publishing.md.
"""

import argparse
import datetime
import hashlib
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

import build_extension

from .kernels import MODULE, build_sdist
from .metadata import ROOT, version

#: Files that state the version, and what stands around it.
STATED = {
    "blender_manifest.toml": (r'^version = "{}"$', rf"{MODULE}-{{}}-py3"),
    "CITATION.cff": (r"^version: {}$",),
    "docs/use/install.md": (r"mrpnn-{}-linux",),
    "docs/use/farm.md": (r"mrpnn-{}-linux",),
}
UNRELEASED = re.compile(r"^## Unreleased.*$", re.MULTILINE)
SUMS = ROOT / "build" / "SHA256SUMS"


def set_version(new: str, root: Path = ROOT) -> None:
    """State a new version in every file of STATED below a folder. Raises SystemExit where one states another."""
    if not re.fullmatch(r"\d+\.\d+\.\d+", new):
        raise SystemExit(f"{new} is no version: write three numbers, such as 0.2.0")
    old = re.escape(version())
    for name, patterns in STATED.items():
        text = (root / name).read_text()
        for pattern in patterns:
            found = re.compile(pattern.format(old), re.MULTILINE)
            if not found.search(text):
                raise SystemExit(f"{name} does not state the version of blender_manifest.toml, {version()}")
            text = found.sub(lambda match: match[0].replace(version(), new), text)
        (root / name).write_text(text)


def date_changelog(new: str, day: datetime.date, root: Path = ROOT) -> None:
    """Give the unreleased changes a version and a day. Raises SystemExit where there are none."""
    path = root / "CHANGELOG.md"
    text, count = UNRELEASED.subn(f"## {new} ({day.isoformat()})", path.read_text(), count=1)
    if not count:
        raise SystemExit('CHANGELOG.md has no section "## Unreleased": write what the release changes')
    path.write_text(text)


def checksums(paths: list[Path]) -> str:
    """Lines as `sha256sum --check` reads them in the repository's root."""
    return "".join(f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.relative_to(ROOT)}\n" for path in paths)


def build_gallery(number: str, arguments: Sequence[str] = (), folder: Path = ROOT / "build") -> Path:
    """FOLDER/mrpnn-gallery-NUMBER.zip, the gallery's scenes as templates; in a process of its own, for bpy."""
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "gallery", "--templates", "--out", out, *arguments]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        made = folder / f"mrpnn-gallery-{number}.zip"
        return Path(shutil.move(Path(out) / "mrpnn-gallery.zip", made))


def main() -> int:
    parser = argparse.ArgumentParser(prog="python3.11 run.py release", description="Prepare a release.")
    parser.add_argument("version", nargs="?", help="the new version; that of blender_manifest.toml by default")
    new = parser.parse_args().version
    if new is not None:
        if new != version():
            set_version(new)
        date_changelog(new, datetime.date.today())
    zips = build_extension.build()
    zips.append(build_gallery(new or version()))
    wheels = [ROOT / name for name in build_extension.manifest()["wheels"] if f"/{MODULE}-" in name]
    SUMS.write_text(checksums([*zips, *wheels, build_sdist(ROOT / "wheels")]))
    print(f"\n{SUMS.relative_to(ROOT)}:\n{SUMS.read_text()}")
    if new is not None:
        print(f"Look at the changes with git diff, commit them, and tag the commit v{new}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
