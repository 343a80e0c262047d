"""The quick part of the stability benchmark, each case within its bound."""

import numpy as np
import pytest

from benchmarks.stability.__main__ import CASES, measure
from benchmarks.stability.case import Case, Outcome, violations

QUICK = [case for case in CASES if case.quick]


@pytest.mark.parametrize("case", QUICK, ids=[f"{case.group}: {case.name}" for case in QUICK])
def test_an_extreme_case_keeps_its_bounds(case):
    assert violations(case, measure(case)) == []


def test_what_is_beyond_a_bound_or_missing_is_told():
    case = Case("group", "name", "itself", None, {"error": 0.1})
    assert violations(case, Outcome({"error": 0.1})) == []
    for wrong in ({"error": 0.11}, {"error": np.nan}, {}):
        (sentence,) = violations(case, Outcome(wrong))
        assert "group, name: error" in sentence and "0.1 is allowed" in sentence
