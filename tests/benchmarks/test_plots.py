# SPDX-License-Identifier: GPL-3.0-or-later
"""The plots of the docs are drawn from the tables beside them."""

import pytest

from benchmarks import plots
from benchmarks.support import pages
from tests.support.paths import ROOT


@pytest.mark.parametrize(
    "cell, wanted",
    [
        ("0.066 (0.048–0.083)", (0.066, 0.048, 0.083)),
        ("0.065 (0.000 to 0.092)", (0.065, 0.0, 0.092)),
        ("≥ 94.4 (84.2–beyond telling)", (94.4, 94.4, 94.4)),
        ("19 000 (15 800–20 000)", (19000.0, 15800.0, 20000.0)),
        ("below 0.022", (0.022, 0.0, 0.022)),
        ("-1.3 %", (-1.3, -1.3, -1.3)),
        ("n/a", None),
    ],
)
def test_figures_and_intervals_of_cells(cell, wanted):
    assert plots.value(cell) == wanted


def test_a_text_of_several_tables_becomes_a_file_for_each(tmp_path):
    text = "First\n\n| a | b |\n|---|---|\n| 1 | 2 |\n\n| | |\n|---|---|\n| size | 3 |\n"
    first, second = pages.write_tables("name", text, ["Made by `x`."], tmp_path)
    assert first.read_text() == "# First\n# Made by `x`.\na,b\n1,2\n"
    assert second.name == "name-2.csv" and pages.read_csv(second) == [{"quantity": "size", "value": "3"}]


@pytest.mark.slow
def test_every_plot_is_drawn_from_tables_and_is_on_a_page(tmp_path, monkeypatch):
    monkeypatch.setattr(plots, "IMAGES", tmp_path)
    assert plots.main([]) == 0
    text = "".join(path.read_text() for path in (ROOT / "docs").rglob("*.md"))
    assert {path.stem for path in tmp_path.iterdir()} == set(plots.PLOTS)
    assert [name for name in plots.PLOTS if f"(../images/{name}.png)" not in text] == []
    assert [name for name in plots.PLOTS if not (pages.IMAGES / f"{name}.png").exists()] == []
