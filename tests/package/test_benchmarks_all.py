# SPDX-License-Identifier: GPL-3.0-or-later
"""One command makes every table of the documentation, and continues where it was stopped."""

import json
import re
import sys

from benchmarks.all import COMMANDS, COMMANDS_5, TABLES, enter, run, shipped, stamps
from tests.support.paths import ROOT


def test_every_table_with_a_stamp_is_made_by_one_of_the_commands():
    programs = {command.split()[0] for command in COMMANDS + COMMANDS_5}
    found = list(stamps())
    assert [stamp for stamp in found if stamp.program not in programs] == []
    # Each table that a program writes is among them.
    stamped = {stamp.page.name for stamp in found}
    assert {"speed.md", "film.md"} <= stamped
    unstamped = {path.name for path in (ROOT / "docs" / "tables").glob("*.csv")} - stamped
    assert unstamped == {"convergence.csv"}
    assert all(len(commit) >= 7 for stamp in found for commit in stamp.commits)


def test_every_command_is_a_program_of_the_repository():
    for command in COMMANDS + COMMANDS_5:
        path = ROOT.joinpath(*command.split()[0].split("."))
        assert (path / "__main__.py").exists() or "__main__" in path.with_suffix(".py").read_text(), command


def test_tables_between_a_commands_marks_are_made_by_that_command():
    marks = [mark for page in (ROOT / "docs").rglob("*.md") for mark in re.findall("<!-- (.*) -->", page.read_text())]
    named = {mark for mark in marks if mark.startswith(("benchmarks.", "training."))}
    assert named and named | set(TABLES) <= set(COMMANDS + COMMANDS_5)
    assert all((ROOT / "docs" / "tables" / f"{name}.csv").exists() for name in TABLES.values())


def test_a_printed_table_goes_between_its_commands_marks(tmp_path):
    page = tmp_path / "page.md"
    page.write_text("Before.\n\n<!-- a.b --size 3 -->\nold\n<!-- end -->\n\n<!-- a.b -->\nkept\n<!-- end -->\n")
    printed = "noise\n| x | y |\n|---|---|\n| 1 | 2 |\nWeights `m` 0123, commit 4567, `python -m a.b --size 3`.\n"
    enter("a.b --size 3", printed, tmp_path)
    assert page.read_text() == (
        "Before.\n\n<!-- a.b --size 3 -->\n| x | y |\n|---|---|\n| 1 | 2 |\n\n"
        "Weights `m` 0123, commit 4567, `python -m a.b --size 3`.\n<!-- end -->\n\n<!-- a.b -->\nkept\n<!-- end -->\n"
    )
    # What prints no table leaves the page alone, and a program that does not say so is named.
    enter("a.b", "nothing", tmp_path)
    assert "kept" in page.read_text()
    enter("a.b", "| z |", tmp_path)
    assert page.read_text().count("`python -m a.b`.\n<!-- end -->") == 1 and "kept" not in page.read_text()


def test_a_printed_table_goes_to_its_file(tmp_path):
    command, name = next(iter(TABLES.items()))
    (tmp_path / "tables").mkdir()
    enter(command, "noise\n| x | y |\n|---|---|\n| 1, 2 | 3 |\n", tmp_path)
    said, *rows = (tmp_path / "tables" / f"{name}.csv").read_text().splitlines()
    assert said.endswith(f"`python -m {command}`.") and rows == ["x,y", '"1, 2",3']


def test_what_is_done_for_this_code_and_these_weights_is_skipped(tmp_path, capsys):
    commands = ["this", "json.tool --help", "json.tool no-such-file"]
    assert run(commands, tmp_path) == 1
    done = json.loads((tmp_path / "done.json").read_text())
    keys = [f"{command}, Python {sys.version_info[0]}.{sys.version_info[1]}" for command in commands]
    assert set(done) == set(keys[:2]) and set(shipped()) <= set(done[keys[0]])
    assert "Beautiful is better than ugly" in (tmp_path / "this.log").read_text()
    capsys.readouterr()
    assert run(commands, tmp_path) == 1
    assert capsys.readouterr().out.count("done before: ") == 2
    # What only this machine needs is no part of what was done.
    run(["json.tool"], tmp_path, {"json.tool": "--help"})
    assert "usage" in (tmp_path / "json-tool.log").read_text()
    assert keys[1].replace(" --help", "") in json.loads((tmp_path / "done.json").read_text())
    # Other weights make all of it anew.
    (tmp_path / "done.json").write_text(json.dumps({key: ["older"] for key in keys}))
    run(commands[:1], tmp_path)
    assert "running: this" in capsys.readouterr().out
