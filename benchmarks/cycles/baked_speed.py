# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of Cycles with baked light, bake included, and of Cycles with 1024 bounces at the same error.

    python -m benchmarks.cycles.baked_speed [VIEW] [--size 96]

Prints errors against the view's independent reference, with and without OpenImageDenoise. Images larger than the
reference have smaller pixels and are compared where the rays through pixel centres are those of the reference. Needs
bpy.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from inference.evaluation.error import relative_bias, relative_rmse

from ..fidelity.views import MASK_ALPHA, View, independent_views
from ..support.provenance import commit, weights_checksum
from .baked_light import stage

VIEW = "cumulus-100-side-g0.857"
BOUNCES = 1024
# Samples per pixel: with baked light, and with bounces; plain and denoised. Fewer in large images.
BAKED, BOUNCED = ((4, True), (16, False), (64, False)), ((16, True), (64, True), (64, False))
LARGE = 256
BAKED_LARGE, BOUNCED_LARGE = ((1, True), (4, True), (16, False)), ((1, True), (4, True), (16, True))


def enlarge(scene, view: View, size: int) -> slice:
    """Make a scene's image size^2 pixels; gives the rows and columns whose rays are those of the view's reference.

    Pixels are an odd part of the reference's, so that every so many share a centre, and the rest lies around it.
    """
    part = size // view.spec.size
    part -= 1 - part % 2
    scene.render.resolution_x = scene.render.resolution_y = size
    edge = np.tan(0.5 * np.radians(view.fov)) * size / (part * view.spec.size)
    scene.camera.data.angle = 2.0 * np.arctan(edge)
    first = (size - part * view.spec.size) // 2 + part // 2
    return slice(first, first + part * (view.spec.size - 1) + 1, part)


def main(name: str, size: int) -> None:
    from ..support.extension import extension

    extension()
    import bpy

    from tests.support import blender_scenes as scenes

    [view] = [found for found in independent_views() if found.name == name]
    halves = view.halves()
    mask = halves[..., 3].mean(axis=0) > MASK_ALPHA
    a, b = halves[..., :3] * mask[..., None]
    print(f"{name}, {size} x {size} pixels; weights {weights_checksum('mrpnn')}, {commit()}", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        scene = stage(view, Path(folder))
        same = enlarge(scene, view, size)

        def show(what: str, samples: int, denoised: bool, bounces: int) -> None:
            scenes.set_up_cycles(scene, samples, bounces)
            scene.cycles.volume_step_rate, scene.cycles.use_denoising = 1.0, denoised
            scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
            start = time.process_time()
            image = scenes.rendered(scene, Path(folder))[same, same, :3] * mask[..., None]
            seconds = time.process_time() - start
            error, bias = relative_rmse(image, a, b, mask).value, relative_bias(image, a, b, mask).value
            kind = "denoised" if denoised else "plain"
            print(
                f"{what}, {samples} samples, {kind}: error {error:.3f}, bias {bias:+.3f}, {seconds:.1f} s", flush=True
            )

        start = time.process_time()
        bpy.ops.mrpnn.bake_light(folder=folder, directional=False)
        print(f"bake: {time.process_time() - start:.1f} s", flush=True)
        for samples, denoised in BAKED_LARGE if size >= LARGE else BAKED:
            show("baked light", samples, denoised, 0)
        bpy.ops.mrpnn.bake_light_remove()
        for samples, denoised in BOUNCED_LARGE if size >= LARGE else BOUNCED:
            show(f"{BOUNCES} bounces", samples, denoised, BOUNCES)


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("view", nargs="?", default=VIEW)
    parser.add_argument("--size", type=int, default=96)
    options = parser.parse_args()
    main(options.view, options.size)
