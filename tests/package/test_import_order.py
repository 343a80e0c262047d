# SPDX-License-Identifier: GPL-3.0-or-later
"""Which package may import which: data goes one way, between packages and within them."""

import ast
import re
from collections.abc import Iterator

import pytest

from tests.support.paths import ROOT

# What each package may import of the others. Benchmarks render real Blender scenes through the add-on, take procedural
# volumes and the reference path tracer from training, and the scene of the soak from the tests' support.
PACKAGES = {
    "inference": (),
    "evaluation": (),
    "mrpnn_addon": ("evaluation", "inference"),
    "operators": ("mrpnn_addon", "inference"),
    "panels": ("operators", "mrpnn_addon", "inference"),
    "training": ("evaluation", "inference"),
    "benchmarks": ("tests", "training", "mrpnn_addon", "evaluation", "inference"),
    "gallery": ("benchmarks", "packages", "training", "mrpnn_addon", "evaluation"),
}
# Modules that exist only inside Blender.
BLENDER = {"bpy", "bpy_extras", "bmesh", "gpu", "gpu_extras", "mathutils", "openvdb", "pyopenvdb"}
# Inside a package, each room may import those before it.
ROOMS = {
    "inference": (
        "numerics",
        "runtime",
        "scene",
        "kernels",
        "blur",
        "onnx",
        "models",
        "occluders",
        "plan",
        "grids",
        "transport",
        "source_terms",
        "environments",
        "marching",
        "features",
        "network",
        "paper",
        "deep",
        "render_cache",
        "image",
        "outputs",
        "render",
        "points",
        "baking",
        "predict_multiple",
    ),
    "mrpnn_addon": (
        "runtime",
        "settings",
        "textures",
        "nodes",
        "vdb",
        "objects",
        "world",
        "volumes",
        "scene",
        "output",
        "baking",
        "status",
        "engine",
        "cycles",
        "comparison",
        "flipbook",
    ),
}


def imports(source: str, module: tuple[str, ...]) -> Iterator[tuple[int, tuple[str, ...]]]:
    """Line and dotted path, from the repository's root, of each name that a module imports, in functions too.

    The root itself is package `mrpnn` where Blender loads it.
    """
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            for name in node.names:
                yield node.lineno, tuple(name.name.split("."))
        elif isinstance(node, ast.ImportFrom):
            path = tuple(node.module.split(".")) if node.module else ()
            if node.level:
                path = module[: len(module) - node.level] + path
            elif path[0] == "mrpnn":
                path = path[1:]
            for name in node.names:
                yield node.lineno, (*path, name.name)


def package_imports(package: str) -> list[tuple[str, tuple[str, ...], tuple[str, ...]]]:
    """(place, importing module, imported path) of each import in a package."""
    found = []
    for file in sorted((ROOT / package).rglob("*.py")):
        name = file.relative_to(ROOT)
        module = name.with_suffix("").parts
        found += [(f"{name}:{line}", module, path) for line, path in imports(file.read_text(), module)]
    return found


def test_imports_are_found_wherever_they_stand():
    source = "from . import a\nfrom ..b.c import d\ndef f():\n    import e.f\n    from inference import g\n"
    assert [path for _, path in sorted(imports(source, ("x", "y", "z")))] == [
        ("x", "y", "a"),
        ("x", "b", "c", "d"),
        ("e", "f"),
        ("inference", "g"),
    ]


@pytest.mark.parametrize("package", PACKAGES)
def test_packages_import_only_those_below(package):
    known = {*PACKAGES, "tests"}
    found = package_imports(package)
    assert found
    assert [
        (place, ".".join(path)) for place, _, path in found if path[0] in known - {package, *PACKAGES[package]}
    ] == []


def test_no_test_imports_a_test():
    # The matrix is a program of its own.
    assert [
        (place, ".".join(path))
        for place, _, path in package_imports("tests")
        if path[0] == "tests" and (path[1] not in ("support", "matrix", "reference") or path[2].startswith("test_"))
    ] == []


@pytest.mark.parametrize("package", ["inference", "evaluation", "training"])
def test_renderer_and_training_do_without_blender(package):
    assert [place for place, _, path in package_imports(package) if path[0] in BLENDER] == []


@pytest.mark.parametrize("package", ROOMS)
def test_rooms_import_only_those_before_them(package):
    order = ROOMS[package]
    here = {path.stem for path in (ROOT / package).iterdir() if path.is_dir() or path.suffix == ".py"}
    assert here - {"__init__", "__pycache__", "weights"} == set(order)
    backwards = []
    for place, module, path in package_imports(package):
        if path[0] != package or module[1] == "__init__":
            continue
        # A name of the package itself is what its __init__ collects from all rooms.
        if path[1] not in order or order.index(path[1]) > order.index(module[1]):
            backwards.append((place, ".".join(path)))
    assert backwards == []


def test_nothing_else_knows_the_papers_networks():
    """They register with `network`; the package's `__init__` calls for that."""
    names = ("mrpnn-paper", "mrpnn-narrow", "mrpnn-wide")
    knowing = []
    for package in ("inference", "mrpnn_addon", "operators", "panels"):
        for place, module, path in package_imports(package):
            if path[:2] == ("inference", "paper") and module[:2] not in (path[:2], ("inference", "__init__")):
                knowing.append(place)
        files = [file for file in (ROOT / package).rglob("*.py") if file.parent.name != "paper"]
        knowing += [file for file in files if any(name in file.read_text() for name in names)]
    assert knowing == []


def test_the_add_on_states_its_order():
    text = ast.get_docstring(ast.parse((ROOT / "mrpnn_addon" / "__init__.py").read_text()))
    assert tuple(re.findall(r"^    (\w+) ", text, re.MULTILINE)) == ROOMS["mrpnn_addon"]
