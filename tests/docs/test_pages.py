# SPDX-License-Identifier: GPL-3.0-or-later
"""The docs name every setting, option and button as Blender shows it, in pages and sentences that are short."""

import argparse
import ast
import re
import subprocess

import pytest

from tests.support.paths import ROOT

bpy = pytest.importorskip("bpy")

from benchmarks import lists


def page(name):
    return " ".join((ROOT / name).read_text().split())


def pages_of(part):
    return " ".join(page(path) for path in sorted((ROOT / "docs" / part).glob("*.md")))


def named(properties):
    """UI names of a class's own properties."""
    keywords = [getattr(made, "keywords", {}) for made in properties.__annotations__.values()]
    return [named["name"] for named in keywords if "name" in named]


# Words of a page of use or trust, of a sentence of README, docs/use and the interface, and of any other.
PAGE_WORDS, SHORT, LONGEST = 900, 25, 35


def prose(text):
    """Paragraphs, headings and list items of a page, without code, tables, pictures and targets of links."""
    text = re.sub(r"(?ms)^```.*?^```$|^\$\$.*?\$\$$|<!--.*?-->", "\n\n", text)
    text = re.sub(r"(?m)^(?: {4,}(?![-*\d]).*|\s*\|.*)$", "", text)
    text = re.sub(r"!\[[^\]]*\]\([^)]*\)", "", text)
    text = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text)
    text = re.sub(r"`[^`]*`|\$[^$\n]+\$", "code", text)
    return [" ".join(part.split()) for part in re.split(r"\n\s*\n|\n(?=\s*(?:[-*]|\d+\.) )|\n(?=#)|(?<=#)\n", text)]


def words(text):
    return [word for word in text.split() if re.search(r"\w", word)]


def too_long(text, most):
    """Sentences of more than so many words. A quoted message is one word."""
    found = []
    for paragraph in prose(text):
        paragraph = re.sub(r'"[^"]*"|“[^”]*”', "quote", paragraph)
        found += [part for part in re.split(r"(?<=[.:;?!])[)*\"]*\s", paragraph) if len(words(part)) > most]
    return found


def checked_pages():
    """Pages with the number of words that a sentence may have."""
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True)
    pages = set(listed.stdout.split())
    assert {"README.md", "CONTRIBUTING.md", "docs/use/install.md"} < pages
    return {name: SHORT if name == "README.md" or name.startswith("docs/use/") else LONGEST for name in sorted(pages)}


@pytest.mark.parametrize("name, most", checked_pages().items())
def test_sentences_are_short(name, most):
    assert too_long((ROOT / name).read_text(), most) == []


@pytest.mark.parametrize("part", ["use", "trust"])
def test_pages_are_short(part):
    counts = {}
    for path in (ROOT / "docs" / part).rglob("*.md"):
        text = re.sub(r"!\[[^\]]*\]\([^)]*\)|<!--.*?-->", "", path.read_text())
        counts[path.name] = len(words(re.sub(r"\]\([^)]*\)", "]", text)))
    assert counts and {name: count for name, count in counts.items() if count > PAGE_WORDS} == {}


def texts_of_the_interface(addon):
    """Tooltips by class, property and choice."""
    texts = {}
    for cls in everything(addon):
        texts[f"{cls.__name__}"] = getattr(cls, "bl_description", "") or (cls.__doc__ or "")
        for name, made in getattr(cls, "__annotations__", {}).items():
            keywords = getattr(made, "keywords", {})
            texts[f"{cls.__name__}.{name}"] = keywords.get("description", "")
            items = keywords.get("items", ())
            for item in items if isinstance(items, (list, tuple)) else ():
                texts[f"{cls.__name__}.{name}: {item[0]}"] = item[2]
    assert len(texts) > 30
    return {name: text for name, text in texts.items() if isinstance(text, str)}


def test_sentences_of_the_interface_are_short(addon):
    found = {name: too_long(text, SHORT) for name, text in texts_of_the_interface(addon).items()}
    assert {name: sentences for name, sentences in found.items() if sentences} == {}


def british(text):
    """Words of a text that Blender spells the American way."""
    likewise = re.compile(r"noise|precise|otherwise|likewise|raise|exercise|rise|wise", re.IGNORECASE)
    spelling = r"colour|\bgrey|\bcentre|\bmetre|\bmatt\b|neighbour|behaviour|[a-z]ise\b|[a-z]isation"
    return re.findall(spelling, likewise.sub("", text), re.IGNORECASE)


def test_the_interface_has_blenders_spelling(addon):
    found = {name: british(text) for name, text in texts_of_the_interface(addon).items()}
    assert {name: words for name, words in found.items() if words} == {}


@pytest.mark.parametrize("folder", ["inference", "evaluation", "mrpnn_addon", "operators", "panels"])
def test_messages_have_blenders_spelling(folder):
    found = {}
    for path in (ROOT / folder).rglob("*.py"):
        for line, text in literals(ast.parse(path.read_text())):
            # A single word is a key.
            if " " in text and (spelled := british(text)):
                found[f"{path.relative_to(ROOT)}:{line}"] = spelled
    assert found == {}


@pytest.mark.parametrize("folder", ["inference", "evaluation", "mrpnn_addon", "operators", "panels"])
def test_sentences_of_messages_are_short(folder):
    found = {}
    for path in (ROOT / folder).rglob("*.py"):
        for line, text in literals(ast.parse(path.read_text())):
            if sentences := too_long(text, SHORT):
                found[f"{path.relative_to(ROOT)}:{line}"] = sentences
    assert found == {}


def literals(tree):
    """Line and text of each string of a module but docstrings; a value in an f-string is one word."""
    nodes = list(ast.walk(tree))
    skipped = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}
    skipped |= {id(value) for node in nodes if isinstance(node, ast.JoinedStr) for value in node.values}
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else "value" for part in node.values]
            yield node.lineno, "".join(parts)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in skipped:
            yield node.lineno, node.value


def everything(addon):
    """Classes with texts that Blender shows: operators and groups of properties."""
    own = addon.mrpnn_addon.settings
    return [
        *addon.operators.CLASSES,
        own.properties.MRPNN_PG_scene,
        own.view_layer.MRPNN_PG_view_layer,
        own.preferences.PreferenceProperties,
    ]


def test_every_setting_has_a_row(addon):
    own = addon.mrpnn_addon
    settings, comparison = pages_of("use"), page("docs/use/comparison.md")
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
    pages = page("README.md") + pages_of("use")
    buttons = [tool.bl_label for tool in addon.operators.CLASSES]
    panels = [
        panel.bl_label for panel in addon.panels.CLASSES if hasattr(panel, "bl_label") and panel.bl_label != "Data"
    ]
    assert len(buttons) > 4 and [name for name in (*buttons, *panels) if name not in pages] == []


def test_every_optimization_is_named_as_in_the_panel(addon):
    text, known = page("docs/understand/optimizations.md"), addon.inference.scene.optimizations.OPTIMIZATIONS
    assert known and [name for name, made in known.items() if f"| *{made.title}*, {name} |" not in text] == []


def test_exactly_the_commands_options_are_listed(addon):
    pages = page("docs/use/command-line.md") + page("docs/use/comparison.md")
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
    listed = set(re.findall(r"`(--[a-z-]+)", page("docs/use/command-line.md"))) - {"--command"}
    assert options and [name for name in options if f"`{name}" not in pages] == []
    assert listed <= options


@pytest.mark.parametrize("name", lists.LISTS)
def test_lists_are_those_of_the_code(addon, name, monkeypatch):
    # Where systems of the training were imported before, they are among the networks.
    network = addon.inference.network.network
    for system in network.IN_TRAINING:
        monkeypatch.delitem(network._systems, system, raising=False)
    text = (ROOT / name).read_text()
    assert "<!-- end -->" in text
    assert lists.with_lists(name, text) == text, "python -m benchmarks.lists makes them anew"


def test_messages_quoted_on_the_troubleshooting_page_exist(addon):
    code = " ".join(
        path.read_text()
        for folder in ("inference", "evaluation", "mrpnn_addon", "operators", "panels")
        for path in (ROOT / folder).rglob("*.py")
    )
    # Literals that go on in the next line are one.
    code = re.sub(r'"\s*\n?\s*f?"', "", code)
    quoted = re.findall(r'"([^"]+)"', " ".join(re.findall(r"\*\*(.+?)\*\*", page("docs/use/troubleshooting.md"))))
    parts = [part.strip() for sentence in quoted for part in sentence.split("…") if part.strip()]
    assert len(parts) > 8 and [part for part in parts if part not in code] == []
