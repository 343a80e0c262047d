# SPDX-License-Identifier: GPL-3.0-or-later
"""Imports: the extension taken from the repository and the library that tests import are one."""

import importlib
import sys
from collections import Counter
from pathlib import Path

import inference
from tests.support.paths import ROOT


def test_the_extension_and_the_library_share_every_module(addon):
    files = [path for path in Path(inference.__file__).parent.rglob("*.py") if path.name != "__init__.py"]
    for path in files:
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        module = importlib.import_module(name)
        assert importlib.import_module(f"{addon.__name__}.{name}") is module
        assert module.__spec__.name == module.__name__ == name
    # A module that is loaded twice is two objects from one file.
    loaded = {id(module): str(getattr(module, "__file__", "")) for module in list(sys.modules.values())}
    copies = Counter(loaded.values())
    assert len(files) > 60 and {copies[str(path)] for path in files} == {1}
    # The function, not the module of its name.
    assert callable(inference.render)
    # What the extension raises is what a script catches.
    assert addon.mrpnn_addon.scene.reader.SceneError is addon.inference.SceneError is inference.SceneError
