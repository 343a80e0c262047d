# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light by both ways that Cycles 5 has through volumes: ray marching and null scattering.

    python -m benchmarks.cycles.baked_ways [VIEW]

Prints errors against the view's independent reference, and processor seconds. Needs bpy 5.
"""

import sys
import tempfile
import time
from pathlib import Path

from inference.evaluation.error import relative_bias, relative_rmse

from ..fidelity.views import MASK_ALPHA, independent_views
from ..support.provenance import made_by
from .baked_light import stage

PROGRAM = "benchmarks.cycles.baked_ways"
VIEW, SAMPLES = "cumulus-100-side-g0.857", 16


def main(name: str = VIEW) -> None:
    from ..support.extension import extension

    extension()
    import bpy

    from tests.support import blender_scenes as scenes

    [view] = [found for found in independent_views() if found.name == name]
    halves = view.halves()
    mask = halves[..., 3].mean(axis=0) > MASK_ALPHA
    a, b = halves[..., :3] * mask[..., None]
    print("| | error | bias | processor seconds |\n|---|---|---|---|")
    with tempfile.TemporaryDirectory() as folder:
        scene = stage(view, Path(folder))
        bpy.ops.mrpnn.bake_light(folder=folder, directional=False)
        scenes.set_up_cycles(scene, SAMPLES, 0)
        scene.cycles.volume_step_rate = 1.0
        scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
        for way, biased in (("ray marching", True), ("null scattering", False)):
            scene.cycles.volume_biased = biased
            start = time.process_time()
            image = scenes.rendered(scene, Path(folder))[..., :3] * mask[..., None]
            seconds = time.process_time() - start
            error, bias = relative_rmse(image, a, b, mask).value, relative_bias(image, a, b, mask).value
            print(f"| {way} | {error:.3f} | {100 * bias:+.1f} % | {seconds:.1f} |", flush=True)
    print(made_by(PROGRAM))


if __name__ == "__main__":
    main(*sys.argv[1:])
