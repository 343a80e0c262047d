# SPDX-License-Identifier: GPL-3.0-or-later
"""The onnxruntime that Blender imports: its version, who brought it, and whether it loads."""

import importlib.metadata
import importlib.util
import platform
import re
import sys
import tomllib
from functools import cache
from pathlib import Path

import bpy

from ...inference.network.provider import OLDEST, PROVIDERS, is_recent
from .onnxruntime_fault import import_fault

MANIFEST = Path(__file__).resolve().parents[2] / "blender_manifest.toml"
# How the names of wheels call `sys.platform`.
SYSTEMS = {"linux": "manylinux", "win32": "win", "darwin": "macosx"}
# Packages that contain the module onnxruntime, with different providers.
PACKAGES = ("onnxruntime", "onnxruntime-gpu", "onnxruntime-directml", "onnxruntime-openvino")
# Extensions have a folder for each repository, with a folder for each extension. Blender installs their packages into
# one more.
EXTENSIONS = Path(bpy.utils.user_resource("EXTENSIONS"))
SHARED_FOLDER = EXTENSIONS / ".local"


@cache
def shipped_version(
    system: str = sys.platform,
    machine: str = platform.machine(),
    python: tuple[int, int] = sys.version_info[:2],
) -> str | None:
    """Version of the extension's wheel for a platform and a Python; None where it has none for them."""
    for wheel in tomllib.loads(MANIFEST.read_text())["wheels"]:
        package, version, tag, _, built_for = Path(wheel).stem.split("-")
        fits = (
            package == "onnxruntime"
            and built_for.startswith(SYSTEMS.get(system, "?"))
            and built_for.endswith(machine.lower())
        )
        if fits and tag == "cp{}{}".format(*python):
            return version
    return None


def runtime_version() -> str | None:
    """Version of the onnxruntime that `import` would find; None without one."""
    return _version(PACKAGES, runtime_folder())


def runtime_folder() -> str:
    """Folder that onnxruntime would be imported from; "" without one."""
    return _folder("onnxruntime")


def runtime_problem() -> str:
    """Why there is no onnxruntime that runs networks, and what helps; "" where there is one.

    Networks then run without it, at about the same speed.
    """
    version, folder = runtime_version(), runtime_folder()
    if not folder:
        return _missing()
    if version and not is_recent(version):
        oldest = ".".join(map(str, OLDEST))
        return f"onnxruntime {version} is too old: {oldest} or later is needed. {_remedy(version, folder)}"
    fault = import_fault(folder, version)
    return _explained(*fault, version, folder) if fault else ""


def check_runtime() -> list[str]:
    """Import onnxruntime; returns warnings about one that loads in the place of the shipped one.

    All extensions share one folder of packages, where the highest version wins.
    """
    version, folder, shipped = runtime_version(), runtime_folder(), shipped_version()
    if runtime_problem() or version is None or shipped in (None, version):
        return []
    return [
        f"onnxruntime {version}{_brought(version, folder)} is used; {shipped} is what this extension was tested with"
    ]


def missing_provider(provider: str) -> list[str]:
    """A warning where the loaded onnxruntime lacks a provider of `inference.network.provider.PROVIDERS`; nothing before
    it is loaded.
    """
    loaded = sys.modules.get("onnxruntime")
    if loaded is None or PROVIDERS[provider] in loaded.get_available_providers():
        return []
    return [f"this onnxruntime has no {PROVIDERS[provider]}: the processor runs the network"]


def _folder(module: str) -> str:
    spec = importlib.util.find_spec(module)
    return str(Path(spec.origin).parent) if spec is not None and spec.origin else ""


def _version(packages: tuple[str, ...], folder: str) -> str | None:
    for package in packages if folder else ():
        for found in importlib.metadata.distributions(name=package, path=[str(Path(folder).parent)]):
            return found.version
    return None


def _missing() -> str:
    if shipped_version() is None:
        python = "{}.{}".format(*sys.version_info[:2])
        return f"This zip of MRPNN Volumes brings no onnxruntime for Python {python}"
    return f"onnxruntime, which MRPNN Volumes brings, is missing. {_reinstall()}"


def _explained(kind: str, name: str, version: str | None, folder: str) -> str:
    """The sentences for a fault of `import_fault`: what is wrong, then what helps."""
    what, redistributable = f"onnxruntime {version or ''}".strip(), "Microsoft's Visual C++ Redistributable (x64)"
    replace = _remedy(version, folder)
    if kind == "runtime":
        if version == shipped_version():
            replace = f"Install {redistributable} or a newer Blender, and restart"
        return f"{what} needs a newer Visual C++ runtime than this Blender loads. {replace}"
    if kind == "library" and sys.platform == "win32":
        return f"A Windows library that {what} needs is missing. Install {redistributable}, and restart Blender"
    if kind == "library" and name:
        return f"The system library {name}, which {what} needs, is missing. Install it, and restart Blender"
    if kind == "glibc":
        return f"This Linux is too old for {what}. {_newer_system(version, 'Linux with glibc 2.28 or later', replace)}"
    if kind == "macos":
        return f"This macOS is too old for {what}. {_newer_system(version, 'macOS 14 or later', replace)}"
    if kind == "platform":
        return f"The files of {what} are for another system or another Python. {replace}"
    if kind == "numpy":
        numpy = _folder("numpy")
        number = _version(("numpy",), numpy)
        if _in_shared_folder(numpy):
            replace = _remedy(number, numpy, "numpy")
        return f"{what} does not work with numpy {number} of this Blender. {replace}"
    if kind == "package":
        return f"{what} needs the Python package {name}, which is missing. {replace}"
    return f"The files of {what} are damaged or incomplete. {replace}"


def _newer_system(version: str | None, system: str, replace: str) -> str:
    return f"Use {system}" if version == shipped_version() else replace


def _reinstall() -> str:
    return "Uninstall MRPNN Volumes, restart Blender, and install the zip for your system"


def _remedy(version: str | None, folder: str, package: str = "onnxruntime") -> str:
    """What replaces a package that does not work, by who brought it."""
    if not _in_shared_folder(folder):
        # Such as Python's user packages. Where Blender is a Python module, there is no folder of extensions.
        return f"It lies in {folder}, outside of Blender's extensions: remove it there, and restart Blender"
    if package == "onnxruntime" and version == shipped_version():
        return _reinstall()
    names = _extensions_with(package, version)
    who = " or ".join(f'"{name}"' for name in names) or "the extension"
    return f"Another extension brought it: disable {who} in Preferences > Add-ons, and restart Blender"


def _brought(version: str, folder: str) -> str:
    names = _extensions_with("onnxruntime", version)
    return f' of extension "{names[0]}"' if names and _in_shared_folder(folder) else f" in {folder}"


def _in_shared_folder(folder: str) -> bool:
    return Path(folder).is_relative_to(SHARED_FOLDER)


def _extensions_with(package: str, version: str | None) -> list[str]:
    """Names of the other extensions whose wheels are of a package and version, by their manifests."""
    wheel = re.compile(rf"{package}(_\w+)?-{re.escape(str(version))}-")
    names = []
    for path in sorted(EXTENSIONS.glob("*/*/blender_manifest.toml")):
        try:
            manifest = tomllib.loads(path.read_text(encoding="utf-8"))
            brings = any(wheel.match(Path(name).name) for name in manifest.get("wheels", ()))
        except (OSError, ValueError, TypeError):
            continue
        if brings and path.resolve() != MANIFEST:
            names.append(str(manifest.get("name", path.parent.name)))
    return names
