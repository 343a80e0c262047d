# SPDX-License-Identifier: GPL-3.0-or-later
"""Rules of Blender's platform for extensions that the source shows; docs/contribute/publishing.md lists all."""

import ast
import re

import pytest

from tests.support.paths import ROOT

SHIPPED = [
    ROOT / "__init__.py",
    *(
        path
        for name in ("inference", "evaluation", "mrpnn_addon", "operators", "panels")
        for path in (ROOT / name).rglob("*.py")
    ),
]
# What changes a list or a dictionary.
CHANGES = {"append", "extend", "insert", "remove", "pop", "clear", "update", "setdefault", "__setitem__"}
NETWORK = {"ftplib", "http", "requests", "smtplib", "socket", "ssl", "urllib", "xmlrpc"}


def is_of_sys(node: ast.AST) -> bool:
    """Whether an expression is sys.path or sys.modules, or a part of them."""
    node = node.value if isinstance(node, ast.Subscript) else node
    return (
        isinstance(node, ast.Attribute)
        and isinstance(node.value, ast.Name)
        and node.value.id == "sys"
        and node.attr in ("path", "modules")
    )


def changes(source: str) -> list[int]:
    """Lines that change sys.path or sys.modules."""
    found = []
    for node in ast.walk(ast.parse(source)):
        targets = getattr(node, "targets", None) or [getattr(node, "target", None)]
        if isinstance(node, ast.Assign | ast.AugAssign | ast.Delete) and any(map(is_of_sys, targets)):
            found.append(node.lineno)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) and node.func.attr in CHANGES:
            if is_of_sys(node.func.value):
                found.append(node.lineno)
    return found


@pytest.mark.parametrize(
    "source",
    ["sys.path += a", "sys.path[:] = a", "sys.modules['a'] = b", "del sys.modules['a']", "sys.path.append(a)"],
)
def test_changes_are_found(source):
    assert changes(f"import sys\n{source}") == [2]


def test_searching_and_loaded_modules_are_left_alone():
    assert changes("import sys\nsys.modules.get('a')\nprint(sys.path)") == []
    assert not {str(path): found for path in SHIPPED if (found := changes(path.read_text()))}


def test_nothing_uses_the_network():
    for path in SHIPPED:
        for node in ast.walk(ast.parse(path.read_text())):
            names = [name.name for name in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            assert not {name.partition(".")[0] for name in names} & NETWORK, path


def test_data_is_kept_where_blender_says():
    """Of Blender's folders for users' data, the extension writes into its own alone."""
    for path in SHIPPED:
        source = path.read_text()
        asks = "user_resource(" in source or "script_path_user(" in source
        # The second reads what other extensions bring.
        assert not asks or path.name in ("calibration.py", "onnxruntime_version.py"), path


def test_threads_start_in_the_files_that_the_page_on_threads_names():
    page = (ROOT / "docs" / "understand" / "threads.md").read_text()
    named = {path for path in SHIPPED if f"`{path.relative_to(ROOT).as_posix()}`" in page}
    starts = re.compile(r"\b(Thread|Timer|ThreadPoolExecutor|ThreadPool|start_new_thread)\(")
    # Workers are processes of their own.
    found = {path for path in SHIPPED if path.name != "worker.py" and starts.search(path.read_text())}
    assert found and found <= named
