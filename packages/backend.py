# SPDX-License-Identifier: GPL-3.0-or-later
"""The backend that pip calls (PEP 517): `mrpnn` in the repository, `mrpnn-kernels` in its source distribution.

`mrpnn` is the package `inference` under another name, with its weights and the kernels for this machine.
"""

import tomllib
from pathlib import Path

from .archives import write_sdist, write_wheel
from .kernels import SHARED, library_wheel, load_build
from .metadata import ROOT, core_metadata, version

PACKAGE = "mrpnn"
#: Kinds of files of `inference` that are read; C is compiled.
KINDS = (".py", ".onnx", ".sha256", ".h")


def _project() -> dict:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    return project if "version" in project else project | {"version": version()}


def build_wheel(
    wheel_directory: str, config_settings: dict | None = None, metadata_directory: str | None = None
) -> str:
    """Write the wheel for this machine; returns its name."""
    project, platform = _project(), load_build().this_platform()
    if project["name"] != PACKAGE:
        texts = ROOT / "README.md", ROOT / "packages" / "mrpnn_kernels" / "__init__.py"
        return library_wheel(platform, Path(wheel_directory), project, texts).name
    build, source = load_build(), ROOT / "inference"
    library = build.build(platform)
    paths = [path for path in source.rglob("*") if path.suffix in KINDS]
    files = {f"{PACKAGE}/{path.relative_to(source).as_posix()}": path.read_bytes() for path in paths}
    files |= {
        f"{PACKAGE}/kernels/{library.name}": library.read_bytes(),
        "licenses/LICENSE": (ROOT / "LICENSE").read_bytes(),
    }
    metadata = core_metadata(project, (ROOT / "README.md").read_text())
    return write_wheel(Path(wheel_directory), metadata, f"py3-none-{build.TARGETS[platform].tag}", files).name


def build_sdist(sdist_directory: str, config_settings: dict | None = None) -> str:
    """Write the source distribution; returns its name."""
    project = _project()
    own = ("pyproject.toml", "README.md", "LICENSE", *(SHARED if project["name"] != PACKAGE else _sources()))
    files = {str(path.relative_to(ROOT)): path.read_bytes() for pattern in own for path in ROOT.glob(pattern)}
    metadata = core_metadata(project, (ROOT / "README.md").read_text())
    return write_sdist(Path(sdist_directory), metadata, files).name


def _sources() -> tuple[str, ...]:
    kinds = (*KINDS, ".c")
    return (*SHARED, "blender_manifest.toml", *(f"inference/**/*{kind}" for kind in kinds))
