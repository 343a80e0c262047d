# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of Cycles with baked light, bake included, and of Cycles with 1024 bounces at the same error.

    python -m benchmarks.cycles.baked_speed [VIEW] [--size 96]

Prints errors against the view's independent reference, with and without OpenImageDenoise, and for each row with baked
light the processor seconds that bounces take to its error. Of the denoiser's input only colours are used: in volumes
albedo and normals say nothing, and take six times as long. Images larger than the reference have smaller pixels and
are compared where the rays through pixel centres are those of the reference. Needs bpy.
"""

import argparse
import tempfile
import time
from pathlib import Path

import numpy as np

from evaluation.error import relative_bias, relative_rmse

from ..fidelity.views import MASK_ALPHA, View, independent_views
from ..support.provenance import made_by
from .baked_light import stage

PROGRAM = "benchmarks.cycles.baked_speed"
VIEW = "cumulus-100-side-g0.857"
BOUNCES = 1024
# Samples per pixel, whether denoised, and step rate of volumes: with baked light, and with bounces. Fewer samples in
# large images.
BAKED = (4, True, 1.0), (16, False, 1.0), (64, False, 1.0)
BOUNCED = (16, True, 1.0), (64, True, 1.0), (64, False, 1.0)
LARGE = 256
BAKED_LARGE = (1, True, 1.0), (1, True, 4.0), (4, True, 4.0), (16, False, 4.0)
BOUNCED_LARGE = (4, True, 1.0), (8, True, 1.0), (4, True, 4.0), (8, True, 4.0), (16, True, 4.0), (4, False, 4.0)
# Bakes and images of baked light are quick: the least of so many times.
REPEATS = 3


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
    print(f"{name}, {size} x {size} pixels", flush=True)
    with tempfile.TemporaryDirectory() as folder:
        scene = stage(view, Path(folder))
        same = enlarge(scene, view, size)

        def show(what: str, row: tuple[int, bool, float], bounces: int) -> tuple[float, float]:
            """Error and processor seconds of one row."""
            samples, denoised, rate = row
            scenes.set_up_cycles(scene, samples, bounces)
            scene.cycles.volume_step_rate, scene.cycles.use_denoising = rate, denoised
            scene.cycles.denoising_input_passes = "RGB"
            scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
            image, seconds = timed(
                lambda: scenes.rendered(scene, Path(folder))[same, same, :3] * mask[..., None],
                1 if bounces else REPEATS,
            )
            error, bias = relative_rmse(image, a, b, mask).value, relative_bias(image, a, b, mask).value
            kind = ", denoised" if denoised else ""
            figures = f"{error:.3f} | {100 * bias:+.1f} % | {seconds:.1f}"
            print(f"| {what}{kind} | {samples} | {rate:g} | {figures} |", flush=True)
            return error, seconds

        _, bake = timed(lambda: bpy.ops.mrpnn.bake_light(folder=folder, directional=False, everything=True), REPEATS)
        print("| | samples | step rate | error | bias | processor seconds |\n|---|---|---|---|---|---|")
        print(f"| bake, without other directions | | | | | {bake:.1f} |", flush=True)
        large = size >= LARGE
        baked = {row: show("baked light", row, 0) for row in (BAKED_LARGE if large else BAKED)}
        bpy.ops.mrpnn.bake_light_remove()
        bounced = {row: show(f"{BOUNCES} bounces", row, BOUNCES) for row in (BOUNCED_LARGE if large else BOUNCED)}
        for row, (error, seconds) in baked.items():
            for rate in sorted({other[2] for other in bounced}):
                rows = [found for other, found in bounced.items() if other[1:] == (row[1], rate)]
                if rows:
                    same_error = seconds_to(error, rows, row[1])
                    print(
                        f"{row}: error {error:.3f} in {bake + seconds:.1f} s; {BOUNCES} bounces at step rate {rate:g} "
                        f"take {same_error:.0f} s, {same_error / (bake + seconds):.1f} times as long",
                        flush=True,
                    )


def timed(work, repeats: int):
    """What some work gives, and the least of its processor seconds in so many tries."""
    least = np.inf
    for _ in range(repeats):
        start = time.process_time()
        found = work()
        least = min(least, time.process_time() - start)
    return found, least


def seconds_to(error: float, rows: list[tuple[float, float]], denoised: bool) -> float:
    """Processor seconds to an error, from the errors and seconds of other numbers of samples.

    Straight lines in logarithms; noise falls with the square root of the seconds where nothing is denoised.
    """
    rows = sorted(rows, key=lambda row: row[1])
    if not denoised or len(rows) < 2:
        return rows[-1][1] * (rows[-1][0] / error) ** 2
    errors, seconds = np.log(np.array(rows)).T
    # The two rows about the error, or the two nearest to it.
    last = int(np.clip(np.searchsorted(-errors, -np.log(error)), 1, len(rows) - 1))
    slope = (seconds[last] - seconds[last - 1]) / (errors[last] - errors[last - 1])
    return float(np.exp(seconds[last] + slope * (np.log(error) - errors[last])))


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("view", nargs="?", default=VIEW)
    parser.add_argument("--size", type=int, default=96)
    options = parser.parse_args()
    main(options.view, options.size)
    print(made_by(PROGRAM))
