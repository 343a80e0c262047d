"""The extension from the repository, without building and installing its zip."""

import atexit
import functools
import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


def load_extension():
    """Import the repository's root as package `mrpnn` and register it, as Blender does with an extension.

    Needs bpy. Returns the package; unregister it before the process ends: classes still registered
    keep the bpy module from ending.
    """
    spec = importlib.util.spec_from_file_location(
        "mrpnn", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules["mrpnn"] = package
    spec.loader.exec_module(package)
    package.register()
    return package


@functools.cache
def extension():
    """The package `mrpnn` for the rest of the process, whoever asks."""
    package = load_extension()
    atexit.register(package.unregister)
    return package
