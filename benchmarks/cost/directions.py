# SPDX-License-Identifier: GPL-3.0-or-later
"""How many directions a World needs: error and cost against their number.

    python -m benchmarks.cost.directions [--size 48]

Renders two of the shared views in light from all around, from few directions and from many, and writes the table of
docs/performance.md. Errors are relative RMSE beside MANY directions, over pixels of alpha above 0.02.
"""

import argparse
import time

import numpy as np

from inference import Settings, render

from ..fidelity.views import independent_views
from ..support.extension import ROOT, extension
from ..support.pages import replace, with_table
from ..support.provenance import made_by

PROGRAM = "benchmarks.cost.directions"
PAGE = ROOT / "docs" / "performance.md"
VIEWS = ("cumulus-100-side-g0.857", "smoke-100-side-g0.857")
COUNTS, MANY = (4, 6, 12, 24), 60
DEPTH_SAMPLES = 4


def worlds(directions):
    """Radiance (n, 3) of each World at directions (n, 3)."""

    def glow(axis, narrow, strength):
        axis = np.array(axis) / np.linalg.norm(axis)
        return strength * np.exp(narrow * (directions @ axis - 1.0))

    height = directions[:, 2]
    sky = np.where(height > 0.0, 1.0 + 1.5 * np.exp(-6.0 * np.abs(height)), 0.15) + glow((1.0, 0.4, 0.5), 8.0, 4.0)
    found = {"even": np.ones(len(directions)), "sky": sky, "bright spot": 0.1 + glow((0.3, -0.8, 0.5), 40.0, 30.0)}
    return {name: np.repeat(radiance[:, None], 3, axis=1) for name, radiance in found.items()}


def rows(view, size: int):
    """Lines of the table."""
    environment = extension().mrpnn_addon.world.quadrature
    sphere = environment.Sphere()
    camera, volumes = view.camera(size), view.volumes()
    for name, radiance in worlds(sphere.directions).items():
        layers, seconds = {}, {}
        for count in (*COUNTS, MANY):
            suns = environment.quadrature(sphere, radiance, count)
            start = time.process_time()
            layers[count] = render(volumes, suns, camera, Settings(DEPTH_SAMPLES))
            seconds[count] = time.process_time() - start
        truth = layers[MANY]
        seen = truth.alpha > 0.02
        mean = truth.rgb[seen].mean()
        for count in COUNTS:
            errors = [
                np.sqrt(((getattr(layers[count], part) - getattr(truth, part))[seen] ** 2).mean()) / mean
                for part in ("single", "multiple", "rgb")
            ]
            cells = " | ".join(f"{error:.3f}" for error in errors)
            yield f"| {view.name} | {name} | {count} | {cells} | {seconds[count]:.1f} |"


def main(options=None):
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--size", type=int, default=48)
    arguments = parser.parse_args(options)
    lines = ["| view | World | directions | single | multiple | together | processor seconds |", "|---" * 7 + "|"]
    for view in independent_views():
        if view.name in VIEWS:
            for line in rows(view, arguments.size):
                lines.append(line)
                print(line, flush=True)
    replace(PAGE, with_table(PAGE.read_text(), "directions", "\n".join(lines), made_by(PROGRAM, options)))


if __name__ == "__main__":
    main()
