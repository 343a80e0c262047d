# SPDX-License-Identifier: GPL-3.0-or-later
"""The docs name every setting, option and button as Blender shows it."""

import argparse
import re

import pytest

from tests.support.paths import ROOT

bpy = pytest.importorskip("bpy")

from benchmarks import lists


def page(name):
    return " ".join((ROOT / name).read_text().split())


def named(properties):
    """UI names of a class's own properties."""
    keywords = [getattr(made, "keywords", {}) for made in properties.__annotations__.values()]
    return [named["name"] for named in keywords if "name" in named]


def test_every_setting_has_a_row(addon):
    own = addon.mrpnn_addon
    settings, comparison = page("docs/settings.md"), page("docs/comparison.md")
    wanted = [
        *named(own.settings.properties.MRPNN_PG_scene),
        *named(own.settings.view_layer.MRPNN_PG_view_layer),
        *named(own.settings.preferences.PreferenceProperties),
        *named(addon.operators.composite.MRPNN_OT_composite),
    ]
    assert len(wanted) > 15 and [name for name in wanted if name not in settings] == []
    wanted = named(addon.operators.compare.MRPNN_OT_compare)
    assert len(wanted) > 5 and [name for name in wanted if f"| {name} |" not in comparison] == []
    # Choices, too.
    presets = [label for _, label, _ in own.settings.properties._PRESET_ITEMS]
    providers = [label for _, label, *_ in own.settings.preferences._PROVIDER_ITEMS]
    assert [name for name in (*presets, *providers) if name not in settings] == []


def test_every_button_and_panel_is_named(addon):
    pages = "".join(map(page, ("README.md", "docs/settings.md", "docs/install.md", "docs/baked-light.md")))
    buttons = [tool.bl_label for tool in addon.operators.CLASSES]
    panels = [
        panel.bl_label for panel in addon.panels.CLASSES if hasattr(panel, "bl_label") and panel.bl_label != "Data"
    ]
    assert len(buttons) > 4 and [name for name in (*buttons, *panels) if name not in pages] == []


def test_exactly_the_commands_options_are_listed(addon):
    pages = page("docs/command-line.md") + page("docs/comparison.md")
    parser = addon.operators.command._parser()
    (actions,) = [action for action in parser._actions if isinstance(action, argparse._SubParsersAction)]
    options = {
        name
        for action in actions.choices.values()
        for known in action._actions
        if known.help != argparse.SUPPRESS
        for name in known.option_strings
        if name.startswith("--")
    } - {"--help"}
    listed = set(re.findall(r"`(--[a-z-]+)", page("docs/command-line.md"))) - {"--command"}
    assert options and [name for name in options if f"`{name}" not in pages] == []
    assert listed <= options


@pytest.mark.parametrize("name", lists.LISTS)
def test_lists_are_those_of_the_code(addon, name, monkeypatch):
    # Where the path tracer was imported before, it is among the networks.
    monkeypatch.delitem(addon.inference.network.network._systems, "reference", raising=False)
    text = (ROOT / name).read_text()
    assert "<!-- end -->" in text
    assert lists.with_lists(name, text) == text, "python -m benchmarks.lists makes them anew"


def test_messages_quoted_on_the_troubleshooting_page_exist(addon):
    code = " ".join(
        path.read_text()
        for folder in ("inference", "mrpnn_addon", "operators", "panels")
        for path in (ROOT / folder).rglob("*.py")
    )
    # Literals that go on in the next line are one.
    code = re.sub(r'"\s*\n?\s*f?"', "", code)
    quoted = re.findall(r'"([^"]+)"', " ".join(re.findall(r"\*\*(.+?)\*\*", page("docs/troubleshooting.md"))))
    parts = [part.strip() for sentence in quoted for part in sentence.split("…") if part.strip()]
    assert len(parts) > 8 and [part for part in parts if part not in code] == []
