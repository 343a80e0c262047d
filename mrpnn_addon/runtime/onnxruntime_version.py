# SPDX-License-Identifier: GPL-3.0-or-later
"""The onnxruntime that Blender would import, found without importing it."""

import importlib.metadata
import importlib.util
import platform
import sys
import tomllib
from functools import cache
from pathlib import Path

from ...inference.network.provider import PROVIDERS
from ...inference.scene import SceneError

MANIFEST = Path(__file__).resolve().parents[2] / "blender_manifest.toml"
# How the names of wheels call `sys.platform`.
SYSTEMS = {"linux": "manylinux", "win32": "win", "darwin": "macosx"}
# The oldest release that runs the networks' ONNX opset 17.
OLDEST = (1, 12)
# Packages that contain the module onnxruntime, with different providers.
PACKAGES = ("onnxruntime", "onnxruntime-gpu", "onnxruntime-directml", "onnxruntime-openvino")


@cache
def shipped_version(
    system: str = sys.platform,
    machine: str = platform.machine(),
    python: tuple[int, int] = sys.version_info[:2],
) -> str | None:
    """Version of the extension's wheel for a platform and a Python; None where it has none for them."""
    for wheel in tomllib.loads(MANIFEST.read_text())["wheels"]:
        _, version, tag, _, built_for = Path(wheel).stem.split("-")
        fits = built_for.startswith(SYSTEMS.get(system, "?")) and built_for.endswith(machine.lower())
        if fits and tag == "cp{}{}".format(*python):
            return version
    return None


def runtime_version() -> str | None:
    """Version of the onnxruntime that `import` would find; None without one."""
    folder = runtime_folder()
    for package in PACKAGES if folder else ():
        for found in importlib.metadata.distributions(name=package, path=[str(Path(folder).parent)]):
            return found.version
    return None


def runtime_folder() -> str:
    """Folder that onnxruntime would be imported from; "" without one."""
    spec = importlib.util.find_spec("onnxruntime")
    return str(Path(spec.origin).parent) if spec is not None and spec.origin else ""


def check_runtime() -> list:
    """Warnings about an onnxruntime other than the shipped one.

    All extensions share one folder of packages, where the highest version wins.

    Raises SceneError where onnxruntime is missing or too old.
    """
    version, folder = runtime_version(), runtime_folder()
    if not folder:
        raise SceneError(
            "the package onnxruntime, which the extension ships, is missing; disable and enable the "
            "extension, or install it again"
        )
    if version is None or version == shipped_version():
        return []
    if tuple(int(number) for number in version.split(".")[:2]) < OLDEST:
        raise SceneError(
            f"onnxruntime {version} in {folder} is too old, {OLDEST[0]}.{OLDEST[1]} or later is needed; "
            "another extension or Python's user packages brought it: remove it there"
        )
    return [
        f"onnxruntime {version} in {folder} is used, which another extension brought; "
        f"{shipped_version()} is what this one was tested with"
    ]


def missing_provider(provider: str) -> list:
    """A warning where the loaded onnxruntime lacks a provider of `inference.network.provider.PROVIDERS`; nothing before
    it is loaded.
    """
    loaded = sys.modules.get("onnxruntime")
    if loaded is None or PROVIDERS[provider] in loaded.get_available_providers():
        return []
    return [f"this onnxruntime has no {PROVIDERS[provider]}: the processor runs the network"]
