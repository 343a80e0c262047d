# SPDX-License-Identifier: GPL-3.0-or-later
"""The benchmark of error against time: its cases, and its tables for planted figures."""

from dataclasses import asdict

import pytest

pytest.importorskip("bpy")
pytestmark = pytest.mark.blender

from benchmarks.error_vs_time.cases import Case, cases
from benchmarks.error_vs_time.page import csv_table, filtered, headline, scenes, tables, times_as_long
from benchmarks.error_vs_time.plots import save_headline, save_ladders


def rung(method, samples, seconds, error, spread=0.1, once=0.0):
    interval = {"value": error, "low": error * (1 - spread), "high": error * (1 + spread)}
    return {
        "method": method,
        "samples": samples,
        "seconds": 3 * seconds,
        "cpu_seconds": seconds,
        "once": 3 * once,
        "once_cpu": once,
        "rmse": interval,
        "bias": {"value": 0.01, "low": 0.0, "high": 0.02},
        "flip": None,
    }


def result(error=0.1, spread=0.1, **case):
    """A case whose path tracer has variance 10 and takes 1 + 0.5 seconds per sample; denoised error 0.2 at best."""
    judged = rung("mrpnn", 8, 2.0, error, spread, once=1.5)
    rungs = [
        judged,
        rung("single-scattering", 1, 0.1, 0.9),
        rung("cycles", 4, 3.0, 1.58),
        rung("cycles denoised", 1, 1.5, 0.4),
        rung("cycles denoised", 4, 3.0, 0.2),
    ]
    law = {"start": 1.0, "each": 0.5, "variance": 10.0, "largest": 4}
    equal = [
        {
            "method": method,
            "clock": "cpu_seconds",
            "seconds": 2.0,
            "frame_seconds": 0.5,
            "needed": {"value": 501.0, "how": "extrapolated"},
            "error": {"value": 2.2, "how": "measured"},
        }
        for method in ("cycles", "cycles denoised")
    ]
    return {
        "case": asdict(Case(**case)),
        "judged": judged,
        "rungs": rungs,
        "path_tracing": {"cycles": {"cpu_seconds": law}},
        "equal": equal,
        "verdict": {"good": True, "more": 1.0, "seconds": 1.0},
        "cycles": "4.5 LTS",
        "bounces": 1024,
    }


def test_ratios_follow_from_noise_and_cost():
    # 10 / 0.1^2 = 1000 samples.
    assert times_as_long(result(), "cycles", per_frame=False) == pytest.approx(501 / 2)
    assert times_as_long(result(), "cycles", per_frame=True) == pytest.approx(501 / 0.5)
    # Twice as good as the last of 4 samples: 16 of them, at least.
    assert times_as_long(result(), "cycles denoised", per_frame=False) == pytest.approx(9 / 2)
    assert times_as_long(result(error=0.0), "cycles", per_frame=False) is None


@pytest.mark.parametrize(
    "error, spread, said",
    [(0.05, 0.1, "300: yes"), (0.1, 0.1, "300: no"), (0.07, 2.0, "300: not certain"), (0.07, 0.0, "300: yes")],
)
def test_a_goal_is_reached_where_upper_bounds_reach_it(error, spread, said):
    assert said in headline([result(error, spread)], [result(error, spread)]).splitlines()[4]


def test_larger_images_use_their_own_seconds_and_the_small_ones_samples():
    large = result(error=0.5, growth="image", size=512)
    large["judged"].update(cpu_seconds=10.0, once_cpu=2.0)
    large["path_tracing"]["cycles"]["cpu_seconds"] = {"start": 0.0, "each": 32.0, "variance": 7.0, "largest": 4}
    small = result()
    assert times_as_long(small, "cycles", False, None, large) == pytest.approx(1000 * 32 / 10)
    assert times_as_long(small, "cycles", True, None, large) == pytest.approx(1000 * 32 / 8)
    rows = [line for line in headline([small], [small, large]).splitlines() if line.startswith("| 512² | Cycles 4.5 |")]
    assert ["3.2e+03" in rows[0], "4e+03" in rows[1]] == [True, True]


def test_denoised_images_count_only_where_measured():
    small, large = result(), result(growth="filter", size=256)
    large["rungs"][-1]["rmse"] = {"value": 0.05, "low": 0.04, "high": 0.06}
    rows = filtered([small, large]).splitlines()[-2:]
    assert "| 64² |" in rows[0] and "4.5 / 18 ×" in rows[0] and "1: 0.400, 4: 0.200" in rows[0]
    assert "| 256² |" in rows[1] and "4: 0.050" in rows[1]
    assert "512² | Cycles 4.5, denoised" not in headline([small], [small, result(growth="image", size=512)])
    assert filtered([small]) == ""


def of_two_ways(**case):
    """As `result`, by a Cycles that takes twice as long, and ten times as long by null scattering."""
    other = result(**case)
    other["cycles"] = "5.2"
    law = other["path_tracing"]["cycles"]["cpu_seconds"]
    for method, factor in (("cycles", 2.0), ("cycles null scattering", 10.0)):
        slower = {**law, "start": factor * law["start"], "each": factor * law["each"]}
        other["path_tracing"][method] = {"cpu_seconds": slower}
    other["rungs"].append(rung("cycles null scattering", 4, 30.0, 1.58))
    other["equal"].append({**other["equal"][0], "method": "cycles null scattering"})
    return other


def test_ratios_are_told_against_the_quickest_way_with_the_others_beside_it(tmp_path):
    several = [result(), of_two_ways(), result(volume="smoke")]
    rows = [line.split(" | ") for line in headline(several, several).splitlines() if "first" in line]
    means = {row[1]: float(row[3]) for row in rows if "denoised" not in row[1] and row[0] == "| 64²"}
    assert means["the quickest of these"] == means["Cycles 4.5"] == pytest.approx(501 / 2, rel=0.01)
    assert means["Cycles 5.2"] == pytest.approx(501, rel=0.01)
    assert means["Cycles 5.2, null scattering"] == pytest.approx(2505, rel=0.01)
    told = [line.split(" | ")[1] for line in scenes(several, "mrpnn").splitlines() if line.startswith("| cloud")]
    assert told == ["Cycles 4.5", "Cycles 5.2", "Cycles 5.2, null scattering"]
    assert list(tables(several)) == ["time-headline", "time-scenes", "time-denoised", "time-growth"]
    save_ladders(several, tmp_path / "ladders.png")
    assert (tmp_path / "ladders.png").exists()


def test_the_headline_shows_scenes_timed_at_both_sizes(tmp_path):
    small, large = result(), result(growth="image", size=512)
    save_headline([small, result(volume="smoke")], tmp_path / "none.png")
    save_headline([small, large, result(error=0.0, volume="smoke")], tmp_path / "one.png")
    assert [file.name for file in tmp_path.iterdir()] == ["one.png"]


def test_tables_show_what_is_measured_and_what_is_not():
    found = tables([result(), result(volume="smoke"), result(growth="suns", suns=2)])
    assert "smoke, side, G 0.857, density 100" in found["time-scenes"]
    assert "| suns | 2 |" in found["time-growth"] and "| albedo |" not in found["time-growth"]
    blurred = result(error=0.0)
    blurred["verdict"] = {"good": False, "more": None, "seconds": None}
    row = scenes([blurred], "mrpnn").splitlines()[-1]
    assert "n/a" in row and "too noisy: beyond telling" in row
    header, rows = csv_table([result(), result(volume="smoke")])
    assert len(rows) == 2 * 5 and all(len(row) == len(header) for row in rows)


def test_cases_differ_from_the_first_in_one_thing_and_have_unique_names():
    found = cases(64)
    assert len({case.name for case in found}) == len(found) and found[0] == Case()
    for case in found:
        different = [key for key, value in asdict(case).items() if value != asdict(found[0])[key]]
        assert len(set(different) - {"volume", "light", "growth"}) <= (2 if case.growth in ("image", "filter") else 1)
