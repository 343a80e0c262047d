# SPDX-License-Identifier: GPL-3.0-or-later
"""The metadata of packages, from their pyproject.toml."""

import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: pyproject.toml of `mrpnn-kernels` in the repository.
KERNELS = ROOT / "packages" / "mrpnn_kernels" / "pyproject.toml"


def version() -> str:
    """The version of the extension, which all packages share."""
    return tomllib.loads((ROOT / "blender_manifest.toml").read_text())["version"]


def core_metadata(project: dict, readme: str) -> str:
    """The text of METADATA and PKG-INFO. project: of pyproject.toml, with its version. readme: the description."""
    lines = [
        "Metadata-Version: 2.4",
        f"Name: {project['name']}",
        f"Version: {project['version']}",
        f"Summary: {project['description']}",
        f"Author: {project['authors'][0]['name']}",
        f"License-Expression: {project['license']}",
        *(f"License-File: {name}" for name in project["license-files"]),
        *(f"Classifier: {name}" for name in project.get("classifiers", ())),
        f"Requires-Python: {project['requires-python']}",
        *(f"Requires-Dist: {name}" for name in project.get("dependencies", ())),
    ]
    for extra, names in project.get("optional-dependencies", {}).items():
        lines += [f"Provides-Extra: {extra}", *(f"Requires-Dist: {name} ; extra == '{extra}'" for name in names)]
    return "\n".join([*lines, "Description-Content-Type: text/markdown", "", readme])
