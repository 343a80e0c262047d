# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures of README, and of the pages that it names, are those of the tables.

Its example is run in tests/package/test_environments.py.
"""

import re
import statistics

from benchmarks.fidelity.measurements import published_network
from benchmarks.support.pages import read_csv
from tests.support.paths import ROOT


def page(name):
    return " ".join((ROOT / name).read_text().split())


def test_fidelity_is_that_of_the_table():
    ours = [row for row in read_csv(ROOT / "docs" / "tables" / "fidelity.csv") if row["system"] == "mrpnn"]
    published = published_network()
    assert len(ours) == len(published) == 12
    stated = re.search(
        r"RMSE\) of ([\d.]+) over (\d+) views .{0,120} authors released has ([\d.]+)",
        page("README.md"),
    ).groups()
    assert stated == (
        f"{statistics.fmean(float(row['rmse']) for row in ours):.3f}",
        "12",
        f"{statistics.fmean(one['rmse'] for one in published.values()):.3f}",
    )
    bias = f"{100 * statistics.fmean(float(row['bias']) for row in ours):+.1f}"
    assert f"**Bias.** It is {bias} % on the mean of the shared views" in page("docs/trust/accuracy.md")


def test_ratios_at_real_sizes_are_those_of_the_table():
    ratios = {
        row["against"]: row["geometric mean of times as long"]
        for row in read_csv(ROOT / "docs" / "tables" / "real-sizes-1.csv")
        if row["the layer's"] == "first frame"
    }
    (plain, plain_low), (denoised, denoised_low) = (
        re.match(r"(?:≥ )?([\d. ]+) \(([\d. ]+)–", ratios[against]).groups()
        for against in ("the quickest of these", "the quickest of these, denoised")
    )
    assert f"denoised Cycles takes at least {float(denoised):.0f} times as long to the same error" in page("README.md")
    text = page("docs/trust/error-vs-time.md")
    assert f"denoised Cycles takes at least {float(denoised):.0f} times as long" in text
    assert f"without a denoiser {plain} times" in text
    assert f"intervals reach down to {plain_low} and {denoised_low}" in text


def test_ratios_at_64_pixels_are_those_of_the_scenes_that_a_clone_can_measure():
    """Geometric means of the page's scenes, without the plume, which a clone lacks, and where noise hides the error; of
    the ways of Cycles the quickest in each.
    """
    known: dict[str, list[tuple[float, float]]] = {}
    for row in read_csv(ROOT / "docs" / "tables" / "time-scenes.csv"):
        ratios = re.search(r": ([\d.e+]+) / ([\d.e+]+) ×", row["to this error: times first / frame"])
        error = re.match(r"[\d.]+", row["mrpnn: error"])
        if not row["scene"].startswith("plume") and ratios and error and float(error[0]) > 0.0:
            known.setdefault(row["scene"], []).append(tuple(map(float, ratios.groups())))
    quickest = [tuple(map(min, zip(*ways))) for ways in known.values()]
    first, frame = (f"{float(f'{statistics.geometric_mean(one):.3g}'):.0f}" for one in zip(*quickest))
    text = page("docs/trust/error-vs-time.md")
    stated = re.search(r"takes ([\d ]+) times as long for a first image and ([\d ]+) times for a further", text)
    assert [value.replace(" ", "") for value in stated.groups()] == [first, frame]
    assert f"geometric means of {len(known)} scenes" in text


def test_figures_of_artists_settings_are_those_of_the_table():
    rows = read_csv(ROOT / "docs" / "tables" / "cycles-settings.csv")
    settings = "Cycles, 12 volume bounces, clamped at 10, denoised"
    cycles = [row for row in rows if row["settings"] == settings and row["samples"] == "128"]
    layer = [row for row in rows if row["settings"] == "MRPNN layer, first frame"]

    def span(key, digits, factor=1.0, among=cycles):
        found = sorted(factor * float(row[key]) for row in among)
        return f"{found[0]:.{digits}f} to {found[-1]:.{digits}f}"

    text = page("docs/trust/cycles-settings.md")
    for stated in (text, page("README.md")):
        assert f"{span('bias', 0, -100.0)} % too dark" in stated
    assert f"layer errs by {span('error', 2, among=layer)} in less than one." in text
    # More samples lower the noise alone: the bias stays.
    fewer = [row for row in rows if row["settings"] == settings and row["samples"] == "32"]
    assert len(fewer) == len(cycles) > 1
    for few, many in zip(fewer, cycles):
        assert abs(float(few["bias"]) - float(many["bias"])) < 0.05, few
    assert f"an error of {span('error', 2)} after {span('seconds', 0)} processor seconds" in text
    assert max(float(row["seconds"]) for row in layer) < 1.0


def test_demo_and_dense_smoke_are_those_of_the_table():
    found = {row["figure"]: row for row in read_csv(ROOT / "docs" / "tables" / "readme.csv")}
    value = {name: float(row["value"]) for name, row in found.items()}
    text, smoke, cloud = page("docs/trust/speed.md"), "smoke, processor seconds", "cloud, processor seconds"
    assert f"{100 * value['covered']:.0f} % of them covered, takes {value[smoke]:.0f} processor seconds" in text
    assert f"**The demo**: {value[cloud]:.1f} processor seconds" in text
    assert f"would take {value['cloud compared: Cycles to this error']:.0f} to the same error" in text
    assert f"the layer takes {value['cloud compared: layer']:.1f} ([figures]" in text
