# SPDX-License-Identifier: GPL-3.0-or-later
"""The lists in docs that the code knows: nodes, settings, buttons and options of the command line.

    python -m benchmarks.lists

Each goes between the marks <!-- name --> and <!-- end --> of its page. A test compares the pages with the code.
"""

import argparse
import sys
from collections.abc import Callable, Iterable
from types import ModuleType

import bpy

from .support.extension import ROOT, extension
from .support.pages import between_marks, replace


def _node_names(identifiers: Iterable[str]) -> str:
    """Blender's names of shader nodes, in alphabetical order."""
    # A node of another version has no type here.
    types = [getattr(bpy.types, identifier, None) for identifier in identifiers]
    return ", ".join(sorted({kind.bl_rna.name for kind in types if kind is not None}))


def _nodes(addon: ModuleType) -> str:
    nodes = addon.mrpnn_addon.nodes
    functions, textures = nodes.functions.FUNCTIONS, nodes.texture_nodes.TEXTURES
    shaders = [*nodes.material.CLOSURES, "ShaderNodeAddShader", "ShaderNodeMixShader"]
    rows = {
        "shaders": shaders,
        "textures": textures,
        "other nodes": [identifier for identifier in functions if identifier not in textures],
    }
    return "\n".join(["| | |", "|---|---|", *(f"| {kind} | {_node_names(names)} |" for kind, names in rows.items())])


def _sentence(text: str) -> str:
    """A tooltip on one line, with its full stop."""
    text = " ".join(text.split())
    return text if text.endswith(".") else f"{text}."


def _rows(owners: Iterable[type]) -> list[str]:
    """A row for each property with a name: its name and tooltip, and the choices of a fixed list."""
    rows = []
    for owner in owners:
        for made in owner.__annotations__.values():
            keywords = made.keywords
            if "name" not in keywords or "HIDDEN" in keywords.get("options", ()):
                continue
            choices = keywords.get("items", ())
            said = [_sentence(keywords["description"])]
            # Flags have a page of their own.
            if not callable(choices) and "ENUM_FLAG" not in keywords.get("options", ()):
                said += [f"*{item[1]}*: {_sentence(item[2])}" for item in choices]
            rows.append(f"| {keywords['name']} | {' '.join(said)} |")
    return rows


def _settings(addon: ModuleType) -> str:
    own = addon.mrpnn_addon.settings
    return "\n".join(["| setting | |", "|---|---|", *_rows([own.properties.MRPNN_PG_scene])])


def _preferences(addon: ModuleType) -> str:
    own = addon.mrpnn_addon.settings
    return "\n".join(["| preference | |", "|---|---|", *_rows([own.preferences.PreferenceProperties])])


def _buttons(addon: ModuleType) -> str:
    types = [
        getattr(bpy.ops.mrpnn, button.bl_idname.split(".")[1]).get_rna_type() for button in addon.operators.CLASSES
    ]
    rows = [f"| {button.name} | {_sentence(button.description)} |" for button in types]
    return "\n".join(["| button | |", "|---|---|", *rows])


def _options(addon: ModuleType) -> str:
    parser = addon.operators.command._parser()
    (commands,) = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    known: dict[tuple[str, str], list[str]] = {}
    for command, options in commands.choices.items():
        for option in options._actions:
            if "--help" in option.option_strings or option.help == argparse.SUPPRESS:
                continue
            metavar = option.metavar or (f"{{{','.join(map(str, option.choices))}}}" if option.choices else "")
            value = f" {metavar or option.dest.upper()}" if option.nargs != 0 else ""
            names = ", ".join(f"`{name}{value}`" for name in option.option_strings)
            known.setdefault((names, option.help), []).append(command)
    rows = [
        f"| {names} | {'all' if len(of) == len(commands.choices) else ', '.join(of)} | {_sentence(said)} |"
        for (names, said), of in known.items()
    ]
    return "\n".join(["| option | of | |", "|---|---|---|", *rows])


#: Of each page its lists by name.
LISTS: dict[str, dict[str, Callable[[ModuleType], str]]] = {
    "docs/use/nodes.md": {"evaluated nodes": _nodes},
    "docs/use/settings.md": {
        "buttons": _buttons,
        "settings": _settings,
    },
    "docs/use/preferences.md": {"preferences": _preferences},
    "docs/use/command-line.md": {"options": _options},
}


def with_lists(page: str, text: str) -> str:
    """The text of a page, its lists made anew from the code of this process's Blender."""
    for name, made in LISTS[page].items():
        text = between_marks(text, name, made(extension()))
    return text


def main() -> int:
    for page in LISTS:
        path = ROOT / page
        replace(path, with_lists(page, path.read_text()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
