# SPDX-License-Identifier: GPL-3.0-or-later
"""The README's example runs as printed, and its figures are those of the tables."""

import re

from benchmarks.support.pages import read_csv
from tests.support.paths import ROOT


def test_the_example_runs(capsys):
    text = (ROOT / "README.md").read_text()
    (code,) = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    scope = {}
    exec(code, scope)
    layer = scope["layer"]
    assert layer.rgb.shape == (90, 160, 3) and 0.9 < layer.alpha.max() <= 1.0
    assert layer.multiple.sum() > 0.0
    assert "(90, 160, 3)" in capsys.readouterr().out


def test_figures_of_artists_settings_are_those_of_the_table():
    rows = read_csv(ROOT / "docs" / "cycles-settings.csv")
    settings = "Cycles, 12 volume bounces, clamped at 10, denoised"
    cycles = [row for row in rows if row["settings"] == settings and row["samples"] == "128"]
    layer = [row for row in rows if row["settings"] == "MRPNN layer, first frame"]

    def span(key, digits, factor=1.0):
        found = sorted(factor * float(row[key]) for row in cycles)
        return f"{found[0]:.{digits}f} to {found[-1]:.{digits}f}"

    text = " ".join((ROOT / "README.md").read_text().split())
    assert f"{span('bias', 0, -100.0)} % too dark" in text
    assert f"an error of {span('error', 2)} after {span('seconds', 0)} processor seconds" in text
    assert {f"{float(row['error']):.2f}" for row in layer} == {"0.07"} and "the layer errs by 0.07 after 1" in text
    assert max(float(row["seconds"]) for row in layer) < 1.5
