# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles with the settings that artists choose, beside the layer and baked light: error, bias and processor seconds.

    python -m benchmarks.cycles.settings [VIEW ...]

Every row is measured against the view's independent reference. Rows of this version of Cycles replace those that
docs/tables/cycles-settings.csv holds: run it with bpy 4.5 and with 5.2.
Cycles 5 has two ways through volumes, ray marching and null scattering; the second is the default.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from evaluation.error import relative_bias, relative_rmse
from inference import RenderCache, Settings, render

from ..fidelity.views import MASK_ALPHA, View, independent_views
from ..support.pages import TABLES, csv_made_by, csv_text, read_csv
from ..support.pages import replace as replace_file
from ..support.provenance import made_by
from .baked_light import stage

PROGRAM = "benchmarks.cycles.settings"
VIEWS = ("cumulus-100-side-g0.857", "cumulus-100-back-g0")
ALL_BOUNCES = 1024
COLUMNS = ("view", "version", "settings", "samples", "error", "low", "high", "bias", "seconds")


def choices(null: bool) -> list:
    """(Choice, samples) to measure: as artists set it, and as it comes near the truth. null: by null scattering too."""
    from mrpnn.mrpnn_addon.cycles.choices import USUAL, Choice

    marched = [(Choice(ALL_BOUNCES, denoised), samples) for denoised in (False, True) for samples in (16, 64)]
    scattered = [(Choice(ALL_BOUNCES, denoised, null=True), 16) for denoised in (False, True)]
    found = sorted([*USUAL, *marched, *scattered], key=lambda one: one[0].null)
    return [(choice, samples) for choice, samples in found if choice.null <= null]


class Reference:
    """What the pictures of one view are measured against."""

    def __init__(self, view: View):
        halves = view.halves()
        self.mask = halves[..., 3].mean(axis=0) > MASK_ALPHA
        self.halves = halves[..., :3] * self.mask[..., None]
        self.view = view

    def row(self, settings: str, samples: int | str, image: np.ndarray, seconds: float) -> dict:
        """The figures of one picture (H, W, 3)."""
        import bpy

        arguments = image * self.mask[..., None], *self.halves, self.mask
        error, bias = relative_rmse(*arguments), relative_bias(*arguments)
        row = dict(view=self.view.name, version=bpy.app.version_string, settings=settings, samples=samples)
        row |= dict(error=error.value, low=error.low, high=error.high, bias=bias.value, seconds=seconds)
        print(
            f"{self.view.name}: {settings}, {samples}: {error.value:.3f}, {bias.value:+.3f}, {seconds:.1f} s",
            flush=True,
        )
        return row


def layers(settings: Settings) -> Iterator[tuple[str, np.ndarray, float]]:
    """The current scene's layer, its first frame and another one with the same cache: name, image (H, W, 3), seconds.

    Seconds are the processor's, with reading the scene.
    """
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    from tests.support import blender_scenes as scenes

    cache = RenderCache()
    for name in ("MRPNN layer, first frame", "MRPNN layer, next frame"):
        start = time.process_time()
        description = read_scene(scenes.depsgraph())
        layer = render(description.volumes, description.lights, description.camera, settings, cache=cache)
        yield name, layer.rgb, time.process_time() - start


def rows_of_baked_light(scene, reference: Reference, folder: Path) -> list[dict]:
    """Cycles with baked light; the bake counts."""
    import bpy
    from mrpnn.mrpnn_addon.cycles.choices import Choice

    start = time.process_time()
    bpy.ops.mrpnn.bake_light(folder=str(folder))
    bake, rows = time.process_time() - start, []
    for samples, denoised in ((4, True), (64, False)):
        image, seconds = picture(scene, folder, Choice(0, denoised), samples)
        name = f"baked light, {'denoised' if denoised else 'not denoised'}, with the bake"
        rows.append(reference.row(name, samples, image, bake + seconds))
    bpy.ops.mrpnn.bake_light_remove()
    return rows


def picture(scene, folder: Path, choice, samples: int) -> tuple[np.ndarray, float]:
    """Cycles' picture (H, W, 3) by a Choice, and processor seconds.

    On one thread those of the clock, if they are fewer: in Blender 4.5 an idle thread of TBB is busy all the while.
    """
    from tests.support import blender_scenes as scenes

    scenes.set_up_cycles(scene, samples)
    cycles = scene.cycles
    for name, value in choice.settings(ALL_BOUNCES).items():
        if hasattr(cycles, name):
            setattr(cycles, name, value)
    cycles.volume_step_rate, cycles.pixel_filter_type, cycles.filter_width = 1.0, "BLACKMAN_HARRIS", 0.01
    clock, start = time.perf_counter(), time.process_time()
    image = scenes.rendered(scene, folder)[..., :3]
    seconds, by_clock = time.process_time() - start, time.perf_counter() - clock
    single = scene.render.threads_mode == "FIXED" and scene.render.threads == 1
    return image, min(seconds, by_clock) if single else seconds


def measure(view: View) -> list[dict]:
    """The rows of one view in this version of Blender."""
    reference = Reference(view)
    with tempfile.TemporaryDirectory() as folder:
        scene = stage(view, Path(folder))
        settings = Settings()
        depths = f"{settings.depth_samples} depths"
        rows = [reference.row(name, depths, image, seconds) for name, image, seconds in layers(settings)]
        rows += rows_of_baked_light(scene, reference, Path(folder))
        for choice, samples in choices(null=hasattr(scene.cycles, "volume_biased")):
            image, seconds = picture(scene, Path(folder), choice, samples)
            words = ["Cycles", *choice.words, *([] if choice.denoised else ["not denoised"])]
            rows.append(reference.row(", ".join(words), samples, image, seconds))
    return rows


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=__doc__.split("\n\n")[0])
    parser.add_argument("views", nargs="*", default=VIEWS)
    options = parser.parse_args(arguments)
    from ..support.extension import extension

    extension()
    import bpy

    file, version = TABLES / "cycles-settings.csv", bpy.app.version_string
    for view in independent_views():
        if view.name not in options.views:
            continue
        found = measure(view)
        known, sources = (read_csv(file), csv_made_by(file)) if file.exists() else ([], [])
        rows = [row for row in known if (row["view"], row["version"]) != (view.name, version)] + found
        rows.sort(key=lambda row: (row["view"], row["version"]))
        start = f"Blender {version}: "
        sources = sorted(
            {source for source in sources if not source.startswith(start)} | {start + made_by(PROGRAM, arguments)}
        )
        replace_file(file, csv_text(sources, COLUMNS, [[row[column] for column in COLUMNS] for row in rows]))
    return 0


if __name__ == "__main__":
    sys.exit(main())
