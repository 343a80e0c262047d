# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of Cycles with baked light, bake included, and of Cycles with 1024 bounces at the same error.

    python -m benchmarks.cycles.baked_speed [VIEW]

Prints errors against the view's independent reference, with and without OpenImageDenoise. Needs bpy.
"""

import sys
import tempfile
import time
from pathlib import Path

from inference.evaluation.error import relative_bias, relative_rmse

from ..fidelity.views import MASK_ALPHA, independent_views
from .baked_light import stage

VIEW = "cumulus-100-side-g0.857"
BOUNCES = 1024
# Samples per pixel: with baked light, and with bounces; plain and denoised.
BAKED, BOUNCED = ((4, True), (16, False), (64, False)), ((16, True), (64, True), (64, False))


def main(name: str = VIEW) -> None:
    from ..support.extension import extension

    extension()
    import bpy

    from tests.support import blender_scenes as scenes

    [view] = [found for found in independent_views() if found.name == name]
    halves = view.halves()
    mask = halves[..., 3].mean(axis=0) > MASK_ALPHA
    a, b = halves[..., :3] * mask[..., None]
    with tempfile.TemporaryDirectory() as folder:
        scene = stage(view, Path(folder))

        def show(what: str, samples: int, denoised: bool, bounces: int) -> None:
            scenes.set_up_cycles(scene, samples, bounces)
            scene.cycles.volume_step_rate, scene.cycles.use_denoising = 1.0, denoised
            scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
            start = time.process_time()
            image = scenes.rendered(scene, Path(folder))[..., :3] * mask[..., None]
            seconds = time.process_time() - start
            error, bias = relative_rmse(image, a, b, mask).value, relative_bias(image, a, b, mask).value
            kind = "denoised" if denoised else "plain"
            print(
                f"{what}, {samples} samples, {kind}: error {error:.3f}, bias {bias:+.3f}, {seconds:.1f} s", flush=True
            )

        for samples, denoised in BOUNCED:
            show(f"{BOUNCES} bounces", samples, denoised, BOUNCES)
        start = time.process_time()
        bpy.ops.mrpnn.bake_light(folder=folder, directional=False)
        print(f"bake: {time.process_time() - start:.1f} s", flush=True)
        for samples, denoised in BAKED:
            show("baked light", samples, denoised, 0)


if __name__ == "__main__":
    main(*sys.argv[1:])
