# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light by both ways that Cycles 5 has through volumes: ray marching, at several step rates, and null scattering.

    python -m benchmarks.cycles.baked_ways [VIEW ...]

Prints errors against the view's independent reference, and processor seconds. Needs bpy 5.
"""

import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path

from evaluation.error import relative_bias, relative_rmse

from ..fidelity.views import MASK_ALPHA, View, independent_views
from ..support.provenance import made_by
from .baked_light import stage

PROGRAM = "benchmarks.cycles.baked_ways"
VIEWS, SAMPLES = ("cumulus-100-side-g0.857", "cumulus-100-back-g0"), 16
# Whether Cycles marches, which is biased, and its step rate, which null scattering has none of.
WAYS = {
    "ray marching": (True, 1.0),
    "ray marching, step rate 0.5": (True, 0.5),
    "ray marching, step rate 0.1": (True, 0.1),
    "null scattering": (False, 1.0),
}


def main(names: Sequence[str]) -> None:
    from ..support.extension import extension

    extension()
    print("| view | | error | bias | processor seconds |\n|---|---|---|---|---|")
    for view in independent_views():
        if view.name in (names or VIEWS):
            measure(view)
    print(made_by(PROGRAM, names))


def measure(view: View) -> None:
    """Print the rows of one view."""
    import bpy

    from tests.support import blender_scenes as scenes

    halves = view.halves()
    mask = halves[..., 3].mean(axis=0) > MASK_ALPHA
    a, b = halves[..., :3] * mask[..., None]
    with tempfile.TemporaryDirectory() as folder:
        scene = stage(view, Path(folder))
        bpy.ops.mrpnn.bake_light(folder=folder, directional=False)
        scenes.set_up_cycles(scene, SAMPLES, 0)
        scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
        for way, (biased, rate) in WAYS.items():
            scene.cycles.volume_biased, scene.cycles.volume_step_rate = biased, rate
            start = time.process_time()
            image = scenes.rendered(scene, Path(folder))[..., :3] * mask[..., None]
            seconds = time.process_time() - start
            error, bias = relative_rmse(image, a, b, mask).value, relative_bias(image, a, b, mask).value
            print(f"| {view.name} | {way} | {error:.3f} | {100 * bias:+.1f} % | {seconds:.1f} |", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
