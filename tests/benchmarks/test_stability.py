# SPDX-License-Identifier: GPL-3.0-or-later
"""The quick cases of the stability benchmark, each within its bound; docs/trust/stability.md lists all of them."""

import numpy as np
import pytest

from benchmarks.stability import files
from benchmarks.stability.__main__ import CASES, measure
from benchmarks.stability.case import Case, Outcome, violations
from benchmarks.support import pages
from tests.support.paths import ROOT

DOCS = ROOT / "docs"
QUICK = [case for case in CASES if case.quick]
FIRST = {case.group: case.name for case in reversed(QUICK)}


@pytest.mark.parametrize(
    "case",
    [
        pytest.param(
            case, id=f"{case.group}: {case.name}", marks=() if case.name == FIRST[case.group] else pytest.mark.slow
        )
        for case in QUICK
    ],
)
def test_an_extreme_case_stays_within_its_bounds(case):
    if case in files.CASES:
        pytest.importorskip("bpy")
    assert violations(case, measure(case)) == []


def test_violated_bounds_and_missing_results_are_reported():
    case = Case("group", "name", "itself", None, {"error": 0.1})
    assert violations(case, Outcome({"error": 0.1})) == []
    for wrong in ({"error": 0.11}, {"error": np.nan}, {}):
        (sentence,) = violations(case, Outcome(wrong))
        assert "group, name: error" in sentence and "0.1 is allowed" in sentence


def test_the_published_table_lists_these_cases():
    published = {
        (row["group"], row["case"], row["quantity"]): row for row in pages.read_csv(DOCS / "tables" / "stability.csv")
    }
    wanted = {(case.group, case.name, quantity): bound for case in CASES for quantity, bound in case.bounds.items()}
    assert set(published) == set(wanted)
    for key, bound in wanted.items():
        assert float(published[key]["bound"]) == pytest.approx(bound)
        assert float(published[key]["error"]) <= float(published[key]["bound"])
