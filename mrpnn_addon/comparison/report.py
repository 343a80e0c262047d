# SPDX-License-Identifier: GPL-3.0-or-later
"""The files of a comparison's report, and its chart as an Image."""

import csv
import io
import os
import platform
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import bpy
import numpy as np

from ...inference.scene import SceneError
from ..cycles.choices import REFERENCE
from ..runtime.atomic_write import atomic_write, make_folder
from ..runtime.text import safe_text, text_of
from .chart_image import show_chart
from .page import ERROR_LIMIT, page
from .pictures import display_png, view_png
from .results import MASK_ALPHA, Comparison

if TYPE_CHECKING:
    from .run import ComparisonRun

TOO_DARK, TOO_BRIGHT = np.array([0.13, 0.40, 0.67]), np.array([0.70, 0.09, 0.17])
COLUMNS = (
    "method",
    "samples",
    "seconds",
    "cpu_seconds",
    "once",
    "once_cpu",
    "rmse",
    "rmse_low",
    "rmse_high",
    "bias",
    "bias_low",
    "bias_high",
    "flip",
    "version",
)


def writing(run: "ComparisonRun", comparison: Comparison) -> Iterator[Path]:
    """Write report.html, figures.csv and figures.json into the folder of a ComparisonRun, and draw the chart.

    A generator of short steps that yields the page's path. Raises SceneError where a file cannot be written.
    """
    path = run.folder / "report.html"
    make_folder(str(run.folder))
    comparison.write_json(str(run.folder / "figures.json"))
    _replace(run.folder / "figures.csv", csv_text(comparison))
    yield path
    show_chart(comparison.rungs, comparison.clock)
    yield path
    reference, pictures = f"reference, {2 * comparison.samples} samples" if comparison.samples else "reference", {}
    for caption, image in _images(run, comparison, reference).items():
        pictures[caption] = view_png(image, run.scene)
        yield path
    error = signed_error(run.layer_image(), run.reference_image())
    text = page(
        comparison,
        f"Error against run time: {text_of(run.scene, 'name')}, frame {run.description.frame}",
        pictures,
        display_png(error),
        reference,
        _facts(run, comparison),
    )
    _replace(path, text)
    yield path


def csv_text(comparison: Comparison) -> str:
    """One row per image."""
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS)
    writer.writeheader()
    for rung in comparison.rungs:
        row = {name: getattr(rung, name) for name in COLUMNS if hasattr(rung, name)} | {"version": comparison.cycles}
        for name in ("rmse", "bias"):
            estimate = getattr(rung, name)
            row.update({name: estimate.value, f"{name}_low": estimate.low, f"{name}_high": estimate.high})
        writer.writerow(row)
    return text.getvalue()


def signed_error(layer: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """float32 (H, W, 3) display colours: red too bright, blue too dark, saturated at ERROR_LIMIT of the mean."""
    shown = layer[..., 3] > MASK_ALPHA
    mean = reference[shown][:, :3].mean() if shown.any() else 1.0
    share = np.clip((layer - reference)[..., :3].mean(axis=-1) / mean / ERROR_LIMIT, -1.0, 1.0)[..., None]
    return (1.0 + np.abs(share) * (np.where(share > 0.0, TOO_BRIGHT, TOO_DARK) - 1.0)).astype(np.float32)


def _images(run: "ComparisonRun", comparison: Comparison, reference: str) -> dict:
    """Images by caption: the judged layer, the reference, every other candidate."""
    found = {}
    for job, done in run.job.passes.items():
        if job == run.request.layers[0]:
            found[f"{job.method}, {job.samples} depth samples"] = done.image
    found[reference] = run.reference_image()
    for job, done in run.job.passes.items():
        if job.by_cycles and job.method != REFERENCE:
            found[f"{job.method}, {job.samples} samples"] = done.image
        elif not job.by_cycles and job != run.request.layers[0]:
            found[f"{job.method}, {job.samples} depth samples"] = done.image
    return found


def _facts(run: "ComparisonRun", comparison: Comparison) -> dict:
    width, height = comparison.resolution
    threads = run.settings.threads or os.cpu_count()
    own = run.scene.cycles
    return {
        "Blender": bpy.app.version_string,
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} logical processors; {_processor()}",
        "image": f"{width} × {height}, {comparison.pixels} pixels with alpha above {MASK_ALPHA}",
        "reference": run.options.reference_path
        or (
            f"2 × {comparison.samples} samples in {comparison.cycles_seconds:.1f} s, noise left "
            f"{comparison.noise:.3f} per pixel; {comparison.verdict}"
        ),
        "Cycles": f"{comparison.bounces} bounces, no clamping, no adaptive sampling, no light threshold, filter of one "
        "point, where its name says nothing else; rays are marched, but for null scattering; denoised with "
        "OpenImageDenoise. In a separate process; the scene's own settings "
        f"({own.samples} samples, {own.volume_bounces} volume bounces of {own.max_bounces}, indirect light "
        f"clamped at {own.sample_clamp_indirect:g}) are neither used nor touched",
        "layer": f"{run.settings.model}, seed {run.settings.seed}, {threads} threads",
        "alpha bias": f"{comparison.alpha_bias.value:+.2%}",
        "paper's metric": f"{comparison.paper:.2f} (100 × RMSE of tone-mapped luma, whole image)",
        "extrapolated": "seconds from the measured cost per sample and 1/√N of the measured noise; at least: beyond "
        "the largest number of denoised samples, as if the error still fell with 1/√N",
    }


def _processor() -> str:
    """The processor's name, where the platform reveals it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or "unknown processor"


def _replace(path: Path, text: str) -> None:
    try:
        with atomic_write(str(path)) as file:
            file.write(safe_text(text).encode())
    except OSError as error:
        raise SceneError(str(error)) from None
