"""The extension from the repository, without building and installing its zip."""

import atexit
import functools
import importlib
import importlib.util
import sys
from importlib.abc import Loader, MetaPathFinder
from importlib.machinery import ModuleSpec
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


class _SharedInference(MetaPathFinder, Loader):
    """Imports `mrpnn.inference` and all below it as the very modules of `inference`.

    Otherwise a process that uses both would hold two copies, with two SceneErrors and two registries of networks.
    """

    def find_spec(self, name, path=None, target=None):
        return ModuleSpec(name, self) if f"{name}.".startswith("mrpnn.inference.") else None

    def create_module(self, spec):
        module = importlib.import_module(spec.name.removeprefix("mrpnn."))
        spec.loader_state = module.__spec__
        return module

    def exec_module(self, module):
        # The import system has just given the module the alias's spec; its own comes back.
        module.__spec__ = module.__spec__.loader_state


def load_extension():
    """Import the repository's root as package `mrpnn` and register it, as Blender does with an extension.

    Its `mrpnn.inference` is the `inference` that is imported from the root. Needs bpy. Returns the
    package; unregister it before the process ends: classes still registered keep the bpy module from ending.
    """
    spec = importlib.util.spec_from_file_location(
        "mrpnn", ROOT / "__init__.py", submodule_search_locations=[str(ROOT)])
    package = importlib.util.module_from_spec(spec)
    sys.modules["mrpnn"] = package
    sys.meta_path.insert(0, _SharedInference())
    spec.loader.exec_module(package)
    package.register()
    return package


@functools.cache
def extension():
    """The package `mrpnn` for the rest of the process, whoever asks."""
    package = load_extension()
    atexit.register(package.unregister)
    return package
