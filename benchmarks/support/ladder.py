# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows of error against processor seconds: pictures of Cycles with ever more samples, and a layer's, beside them."""

import importlib
import time
from collections.abc import Iterable, Iterator, Sequence

import bpy
import numpy as np

from evaluation.error import relative_rmse

SHOWN = 0.02
HEAD = "scene", "picture", "relative RMSE", "processor seconds"
#: Name, picture (H, W, 3) and processor seconds.
Timed = tuple[str, np.ndarray, float]


def cycles_pictures(scene: bpy.types.Scene, counts: Sequence[int]) -> Iterator[Timed]:
    """Those of Cycles with some samples per pixel each, then denoised by OpenImageDenoise."""
    reference, objects = _reference(), _shown(scene)
    view_scene = importlib.import_module("mrpnn.mrpnn_addon.cycles.reference_scene").view_scene
    for denoised in (False, True):
        for count in counts:
            with view_scene(scene, objects, reference.PathTracing(samples=count), scene.world) as own:
                own.cycles.use_denoising, own.cycles.seed = denoised, 7
                start = time.process_time()
                picture = reference._render(own)
                seconds = time.process_time() - start
            yield f"Cycles{', denoised' if denoised else ''}, {count} samples", picture, seconds


def rows(name: str, scene: bpy.types.Scene, samples: int, pictures: Iterable[Timed]) -> Iterator[list[str]]:
    """Rows of HEAD: errors inside the picture of the volumes, against a reference of two halves of so many samples."""
    reference = _reference()
    halves = reference.render_reference(scene, _shown(scene), reference.PathTracing(samples=samples), scene.world)
    mask = 0.5 * (halves.a + halves.b)[..., 3] > SHOWN
    for picture, image, seconds in pictures:
        masked = (values[..., :3] * mask[..., None] for values in (image, halves.a, halves.b))
        yield [name, picture, f"{relative_rmse(*masked, mask).value:.3f}", f"{seconds:.2f}"]


def print_rows(rows: Iterable[Sequence[str]]) -> None:
    """As a table, as soon as each is known."""
    print("| " + " | ".join(HEAD) + " |\n|" + "---|" * len(HEAD))
    for cells in rows:
        print("| " + " | ".join(cells) + " |", flush=True)


def _reference():
    return importlib.import_module("mrpnn.mrpnn_addon.cycles.reference")


def _shown(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    return [shown for shown in scene.objects if shown.type in ("VOLUME", "LIGHT")]
