# SPDX-License-Identifier: GPL-3.0-or-later
"""Extreme scenes and every stage, each against an independent result and within a bound.

    python -m benchmarks.stability                 all of them; writes docs/tables/stability.csv and a picture
    python -m benchmarks.stability --quick         a part, writes nothing
    python -m benchmarks.stability --only sun      groups by name; the figures of the others stay

The exit status is 1 where a bound is violated; each violation is printed.
"""

import argparse
import sys
import warnings

from ..support.extension import ROOT
from ..support.pages import csv_made_by
from ..support.provenance import made_by
from . import densities, files, laws, layers, lights, placements, refusals, stages
from .case import Outcome, violations
from .table import read_csv, write_csv, write_pictures

PROGRAM = "benchmarks.stability"
DOCS = ROOT / "docs"
CASES = [case for part in (densities, files, placements, lights, stages, laws, layers, refusals) for case in part.CASES]


def measure(case) -> Outcome:
    """The case's outcome; an empty one where it warns or raises."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            return case.measure()
        except Exception as error:
            print(f"{case.group}, {case.name}: {type(error).__name__}: {error}", file=sys.stderr)
            return Outcome()


def main(options=None) -> int:
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", metavar="GROUP")
    arguments = parser.parse_args(options)
    chosen = [
        case
        for case in CASES
        if (case.quick or not arguments.quick) and (not arguments.only or case.group in arguments.only)
    ]
    found = []
    for case in chosen:
        outcome = measure(case)
        found.append((case, outcome))
        print(
            f"{case.group}, {case.name}: " + ", ".join(f"{name} {value:.2g}" for name, value in outcome.errors.items()),
            flush=True,
        )
    broken = [sentence for case, outcome in found for sentence in violations(case, outcome)]
    if not arguments.quick:
        before, measured = read_csv(DOCS / "tables" / "stability.csv"), {id(case): outcome for case, outcome in found}
        every = [(case, measured.get(id(case)) or Outcome(before.get((case.group, case.name), {}))) for case in CASES]
        earlier = csv_made_by(DOCS / "tables" / "stability.csv") if arguments.only else []
        sources = [*earlier, made_by(PROGRAM, options)]
        write_csv(DOCS / "tables" / "stability.csv", every, sources)
    if not arguments.quick and not arguments.only:
        write_pictures(DOCS / "images" / "stability.png", found)
    print(f"{len(chosen)} cases, {len(broken)} violations")
    for sentence in broken:
        print(sentence)
    return int(bool(broken))


if __name__ == "__main__":
    sys.exit(main())
