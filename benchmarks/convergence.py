"""How training converged: error on held-back volumes against the rows seen.

    python -m benchmarks.convergence runs/* --csv docs/convergence.csv --png docs/images/convergence.png

Reads what training.train wrote to each run. The error is the root mean square relative to the
prediction at points, without the targets' noise.
"""

import argparse
import csv
import json
import pathlib

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402


def read_run(folder: pathlib.Path):
    """Name, volumes and rows of training, and (rows seen, error, bias) of each report of a run."""
    configuration = json.loads((folder / "configuration.json").read_text())
    lines = [json.loads(line) for line in (folder / "progress.jsonl").read_text().splitlines()]
    points = [(line["step"] * configuration["batch"], line["held_rmse"], line["held_bias"]) for line in lines]
    return configuration["network"], configuration["volumes"], configuration["rows"], points


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", type=pathlib.Path)
    parser.add_argument("--csv", type=pathlib.Path, required=True)
    parser.add_argument("--png", type=pathlib.Path, required=True)
    arguments = parser.parse_args(options)
    figure, axes = plt.subplots(figsize=(7, 4.5), dpi=120)
    with open(arguments.csv, "w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(["network", "volumes", "rows", "rows_seen", "held_rmse", "held_bias"])
        for network, volumes, rows, points in map(read_run, arguments.runs):
            writer.writerows([network, volumes, rows, seen, f"{e:.4f}", f"{b:.4f}"] for seen, e, b in points)
            seen, errors, _ = zip(*points)
            axes.plot(seen, errors, label=f"{network}, {volumes} volumes")
    axes.set(xscale="log", yscale="log", xlabel="rows seen", ylabel="relative RMSE at held-back points")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend()
    figure.tight_layout()
    figure.savefig(arguments.png)


if __name__ == "__main__":
    main()
