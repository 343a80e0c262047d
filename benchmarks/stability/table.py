# SPDX-License-Identifier: GPL-3.0-or-later
"""The outcomes as CSV, and as one picture."""

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from ..support import pages

COLUMNS = ("group", "case", "against", "quantity", "error", "bound")


def rows(found):
    """(group, case, against, quantity, error, bound) of every bounded quantity, errors to three digits."""
    for case, outcome in found:
        for quantity, bound in case.bounds.items():
            error = float(f"{outcome.errors.get(quantity, np.nan):.3g}")
            yield case.group, case.name, case.against, quantity, error, bound


def read_csv(path):
    """Errors {(group, case): {quantity: error}} of an earlier run; empty where there was none."""
    errors = {}
    for row in pages.read_csv(path) if path.exists() else ():
        errors.setdefault((row["group"], row["case"]), {})[row["quantity"]] = float(row["error"])
    return errors


def write_csv(path, found, sources):
    """sources: sentences on what made the figures, one for each run that some of them are from."""
    formatted = ([*row[:4], f"{row[4]:g}", f"{row[5]:g}"] for row in rows(found))
    pages.replace(path, pages.csv_text(sources, COLUMNS, formatted))


def write_pictures(path, found):
    """A contact sheet of every case that has a picture, each relative to its brightest pixel."""
    shown = [(case, outcome.picture) for case, outcome in found if outcome.picture is not None]
    columns = 12
    lines = -(-len(shown) // columns)
    figure, axes = plt.subplots(lines, columns, figsize=(1.1 * columns, 1.35 * lines))
    for axis in axes.flat:
        axis.axis("off")
    for axis, (case, picture) in zip(axes.flat, shown):
        axis.imshow(np.clip(picture, 0.0, 1.0) ** (1 / 2.2), interpolation="nearest", vmin=0.0, vmax=1.0)
        axis.set_title(case.name.replace(", ", ",\n", 1)[:44], fontsize=4)
    figure.tight_layout()
    figure.savefig(path, dpi=110)
    plt.close(figure)
