# SPDX-License-Identifier: GPL-3.0-or-later
"""One command makes every table of the documentation, and continues where it was stopped."""

import json

from benchmarks.all import COMMANDS, run, shipped, stamps
from tests.support.paths import ROOT


def test_every_table_with_a_stamp_is_made_by_one_of_the_commands():
    programs = {command.split()[0] for command in COMMANDS}
    found = list(stamps())
    assert [stamp for stamp in found if stamp.program not in programs] == []
    # Each page that has figures is among them.
    assert {"README.md", "scenes.md", "fidelity.md", "performance.md", "stability.md", "film.md"} <= {
        stamp.page.name for stamp in found
    }
    assert all(len(commit) >= 7 for stamp in found for commit in stamp.commits)


def test_every_command_is_a_program_of_the_repository():
    for command in COMMANDS:
        path = ROOT.joinpath(*command.split()[0].split("."))
        assert (path / "__main__.py").exists() or "__main__" in path.with_suffix(".py").read_text(), command


def test_what_is_done_for_this_code_and_these_weights_is_skipped(tmp_path, capsys):
    commands = ["this", "json.tool --help", "json.tool no-such-file"]
    assert run(commands, tmp_path) == 1
    done = json.loads((tmp_path / "done.json").read_text())
    assert set(done) == set(commands[:2]) and set(shipped()) <= set(done["this"])
    assert "Beautiful is better than ugly" in (tmp_path / "this.log").read_text()
    capsys.readouterr()
    assert run(commands, tmp_path) == 1
    assert capsys.readouterr().out.count("done before: ") == 2
    # Other weights make all of it anew.
    (tmp_path / "done.json").write_text(json.dumps({command: ["older"] for command in commands}))
    run(commands[:1], tmp_path)
    assert "running: this" in capsys.readouterr().out
