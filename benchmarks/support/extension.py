# SPDX-License-Identifier: GPL-3.0-or-later
"""The extension from the repository, without building and installing its zip."""

import atexit
import functools
import importlib
import importlib.util
import sys
from pathlib import Path

import inference

ROOT = Path(__file__).resolve().parents[2]


def share_inference() -> None:
    """Let `mrpnn.inference` and all below it be the very modules of `inference`.

    Otherwise a process that uses both would hold two copies, with two SceneErrors and two registries of networks. The
    aliases are entered in sys.modules rather than found by the import system, which would set each module as an
    attribute of its package, and so put the module `inference.render` in place of the function.
    """
    for path in sorted((ROOT / "inference").rglob("*.py")):
        parts = path.relative_to(ROOT).with_suffix("").parts
        names = [".".join(parts[:count]) for count in range(1, len(parts) + (parts[-1] != "__init__"))]
        sys.modules.update({f"mrpnn.{name}": importlib.import_module(name) for name in names})


def load_extension():
    """Import the repository's root as package `mrpnn` and register it, as Blender does with an extension.

    Its `mrpnn.inference` is the `inference` that is imported from the root. Needs bpy. Returns the
    package; unregister it before the process ends: classes still registered keep the bpy module from ending.
    """
    spec = importlib.util.spec_from_file_location("mrpnn", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules["mrpnn"] = package
    share_inference()
    package.inference = inference
    spec.loader.exec_module(package)
    package.register()
    return package


@functools.cache
def extension():
    """The package `mrpnn` for the rest of the process, whoever asks."""
    package = load_extension()
    atexit.register(package.unregister)
    return package
