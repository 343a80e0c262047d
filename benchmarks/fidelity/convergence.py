# SPDX-License-Identifier: GPL-3.0-or-later
"""How training converged: error on held-back volumes against the rows seen.

    python -m benchmarks.fidelity.convergence runs/* --csv docs/tables/convergence.csv --png docs/images/convergence.png

Reads what training.train wrote to each run. The error is the root mean square relative to the prediction at points,
without the targets' noise. Rows of other networks stay in the CSV.
"""

import argparse
import itertools
import json
import pathlib

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from ..support import pages
from ..support.provenance import made_by

PROGRAM = "benchmarks.fidelity.convergence"
HEAD = ["network", "volumes", "rows", "rows_seen", "held_rmse", "held_bias"]


def read_run(folder: pathlib.Path):
    """Rows of HEAD, as text, one for each report of a run."""
    run = json.loads((folder / "configuration.json").read_text())
    lines = [json.loads(line) for line in (folder / "progress.jsonl").read_text().splitlines()]
    facts = [run["network"], str(run["volumes"]), str(run["rows"])]
    return [
        [*facts, str(line["step"] * run["batch"]), f"{line['held_rmse']:.4f}", f"{line['held_bias']:.4f}"]
        for line in lines
    ]


def main(options=None):
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", type=pathlib.Path)
    parser.add_argument("--csv", type=pathlib.Path, required=True)
    parser.add_argument("--png", type=pathlib.Path, required=True)
    arguments = parser.parse_args(options)
    new = [row for run in arguments.runs for row in read_run(run)]
    networks = {row[0] for row in new}
    names = ", ".join(sorted(networks))
    sources = [f"{names}: {made_by(PROGRAM, options, sorted(networks))}"]
    if arguments.csv.exists():
        others = [list(row.values()) for row in pages.read_csv(arguments.csv) if row["network"] not in networks]
        new = others + new
        sources = [line for line in pages.csv_made_by(arguments.csv) if not line.startswith(f"{names}: ")] + sources
    pages.replace(arguments.csv, pages.csv_text(sources, HEAD, new))
    figure, axes = plt.subplots(figsize=(7, 4.5), dpi=120)
    for (network, volumes), rows in itertools.groupby(new, key=lambda row: row[:2]):
        seen, errors = zip(*((int(row[3]), float(row[4])) for row in rows))
        axes.plot(seen, errors, label=f"{network}, {volumes} volumes")
    axes.set(xscale="log", yscale="log", xlabel="rows seen", ylabel="relative RMSE at held-back points")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig(arguments.png)


if __name__ == "__main__":
    main()
