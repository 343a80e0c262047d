# SPDX-License-Identifier: GPL-3.0-or-later
"""Build the extension: zips per platform in build/, built and validated by Blender's own tool.

    .venv/bin/python build_extension.py [--tag v1.2.3]

Downloads the wheels of onnxruntime that blender_manifest.toml names into wheels/, checks them against
requirements-wheels.txt, compiles the wheels of the kernels beside them, builds, validates, and prints what the
megabytes of each zip are for. For Linux there is a second zip, for a Blender of a distribution with a Python of its
own: it has no onnxruntime. The bytes of all depend on the sources alone. With --tag, refuses to build unless the tag is
the manifest's version.
"""

import argparse
import hashlib
import importlib.util
import os
import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from pathlib import Path

from packages.archives import write_zip
from packages.kernels import MODULE, build_wheel, load_build, wheel_name

ROOT = Path(__file__).resolve().parent
BUILD, WHEELS = ROOT / "build", ROOT / "wheels"
LOCK = ROOT / "requirements-wheels.txt"
# How the second zip of a platform ends, for every Python 3.
ANY_PYTHON = "any_python"


def manifest() -> dict:
    """blender_manifest.toml, parsed."""
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text())


def download(wheel: Path) -> None:
    """Download one wheel by its file name."""
    package, version, python, _, platforms = wheel.stem.split("-")
    command = [
        sys.executable,
        "-m",
        "pip",
        "download",
        "--quiet",
        "--quiet",
        "--no-deps",
        "--only-binary=:all:",
        f"{package}=={version}",
        "--dest",
        wheel.parent,
        "--python-version",
        python.removeprefix("cp"),
        "--implementation",
        "cp",
    ]
    for platform in platforms.split("."):
        command += ["--platform", platform]
    subprocess.run(command, check=True)


def fetch(wheel: Path, lock: Path) -> Path:
    """Download a wheel unless it is there; returns it. Raises SystemExit unless `lock` lists its hash."""
    if not wheel.exists():
        wheel.parent.mkdir(parents=True, exist_ok=True)
        download(wheel)
    if hashlib.sha256(wheel.read_bytes()).hexdigest() not in re.findall(r"sha256:([0-9a-f]{64})", lock.read_text()):
        raise SystemExit(f"{wheel.name} is not the file that {lock.name} lists; delete it and build again")
    return wheel


def blender_tool(*arguments) -> None:
    """Run Blender's extension tool, as `blender --command extension ...` would."""
    bpy = Path(importlib.util.find_spec("bpy").origin).parent
    (tool,) = bpy.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
    subprocess.run([sys.executable, tool, *arguments], check=True)


def build() -> list[Path]:
    """The validated zips, in the manifest's order of platforms.

    Each appears in build/ once it is whole, so that several processes may build at the same time.
    """
    facts = manifest()
    for name in facts["wheels"]:
        if not Path(name).name.startswith(MODULE):
            fetch(ROOT / name, LOCK)
    build_kernels(facts["platforms"])
    zips = []
    BUILD.mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir=BUILD) as folder:
        blender_tool("build", "--source-dir", ROOT, "--output-dir", folder, "--split-platforms")
        for platform in facts["platforms"]:
            made = Path(folder) / f"{facts['id']}-{facts['version']}-{platform.replace('-', '_')}.zip"
            zips.append(made)
            with zipfile.ZipFile(made) as archive:
                files = {name: archive.read(name) for name in sorted(archive.namelist())}
            write_zip(made, files)
            if platform.startswith("linux"):
                zips.append(write_zip(made.with_stem(f"{made.stem}-{ANY_PYTHON}"), without_onnxruntime(files)))
        for number, made in enumerate(zips):
            blender_tool("validate", made)
            zips[number] = BUILD / made.name
            os.replace(made, zips[number])
    return zips


def build_kernels(platforms: list[str]) -> None:
    """Put the wheels of the kernels into wheels/; raises SystemExit where they cannot be compiled."""
    build = load_build()
    with tempfile.TemporaryDirectory(dir=WHEELS) as folder:
        for platform in platforms:
            try:
                wheel = build_wheel(platform, Path(folder))
            except build.BuildError as error:
                raise SystemExit(f"the kernels for {platform} cannot be compiled: {error}") from error
            os.replace(wheel, WHEELS / wheel_name(platform))


def without_onnxruntime(files: dict[str, bytes]) -> dict[str, bytes]:
    """The files of a zip without the wheels of onnxruntime, which fit one Python each."""
    files = {name: content for name, content in files.items() if not name.startswith("wheels/onnxruntime")}
    lines = files["blender_manifest.toml"].decode()
    lines = re.sub(r'^ *"[^"]*/onnxruntime[^"]*",\n', "", lines, flags=re.MULTILINE)
    return files | {"blender_manifest.toml": re.sub(r'"[^"]*/onnxruntime[^"]*"(, )?', "", lines).encode()}


def contents(path: Path) -> dict[str, int]:
    """Packed bytes of a zip by purpose, largest first."""
    sizes: dict[str, int] = {}
    with zipfile.ZipFile(path) as archive:
        for item in archive.infolist():
            if item.filename.endswith(".whl"):
                package, version, python = Path(item.filename).name.split("-")[:3]
                purpose = "kernels" if package == MODULE else f"{package} {version} for {python}"
            elif item.filename.startswith("inference/weights/"):
                purpose = "networks and stencils"
            else:
                purpose = "code"
            sizes[purpose] = sizes.get(purpose, 0) + item.compress_size
    return dict(sorted(sizes.items(), key=lambda item: -item[1]))


def check_tag(tag: str) -> None:
    """Raise SystemExit unless `tag` is "v" and the manifest's version."""
    version = manifest()["version"]
    if tag != f"v{version}":
        raise SystemExit(
            f"the tag is {tag}, but blender_manifest.toml has version {version}: tag v{version}, or change that"
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Build and validate the zips in build/.")
    parser.add_argument("--tag", help="the release's tag, which must be v<version of blender_manifest.toml>")
    options = parser.parse_args()
    if options.tag is not None:
        check_tag(options.tag)
    for path in build():
        print(f"\n{path.relative_to(ROOT)}  {path.stat().st_size / 1e6:.1f} MB")
        for purpose, size in contents(path).items():
            print(f"  {size / 1e6:7.2f} MB  {purpose}")
