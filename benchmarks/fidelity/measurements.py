# SPDX-License-Identifier: GPL-3.0-or-later
"""Systems measured on views, and their figures as CSV."""

import json
import pathlib
from dataclasses import asdict, dataclass

import numpy as np

from evaluation.error import paper_metric, relative_bias, relative_rmse
from inference import Settings
from inference.network.network import load_network
from inference.scene.optimizations import ALL

from ..support.data import REFERENCES
from ..support.pages import csv_text, replace
from . import pictures
from .references import relative_variance, seconds_per_sample
from .views import MASK_ALPHA, View


@dataclass
class Measurement:
    """One system on one view.

    rmse, bias: relative, with bootstrap 95 % intervals; paper: the paper's metric, RMSE x 100.
    seconds: a frame; reference_seconds: what the path tracer would take for as small an error, all of it noise.
    """

    view: str
    volume: str
    light: str
    sigma_hat: float
    anisotropy: float
    albedo: tuple
    system: str
    rmse: float
    rmse_low: float
    rmse_high: float
    bias: float
    bias_low: float
    bias_high: float
    paper: float
    seconds: float
    reference_seconds: float


def applies(system: str, view: View) -> bool:
    """Whether a system was made for the view's anisotropy and albedo."""
    made_for = load_network(system)
    low, high = made_for.albedo_range
    within = made_for.anisotropy_range[0] <= view.spec.anisotropy <= made_for.anisotropy_range[1]
    return within and all(low <= albedo <= high for albedo in view.spec.albedo)


def measure(view: View, systems, depth_samples: int):
    """Measurements of the systems that apply to a view, the picture of them all."""
    spec, halves = view.spec, view.halves()
    mask = halves[..., 3].mean(axis=0) > MASK_ALPHA
    # A grey view keeps its radiance in every channel. Pixels outside the mask are nobody's.
    a, b = halves[..., :3] * mask[..., None]
    sample = seconds_per_sample(view)
    measured, images = [], {}
    for system in systems:
        layer = view.render(Settings(depth_samples=depth_samples, model=system, optimizations=ALL - {"shared_pixels"}))
        rgb = images[system] = layer.rgb * mask[..., None]
        rmse, bias = relative_rmse(rgb, a, b, mask), relative_bias(rgb, a, b, mask)
        # Where the error is too small to be told from 0, the interval's end stands for it.
        error = rmse.value or rmse.high
        needed = relative_variance(a, b, mask, view.spec.samples) / error**2 if error else np.inf
        measured.append(
            Measurement(
                view.name,
                spec.volume,
                spec.light,
                spec.sigma_hat,
                spec.anisotropy,
                spec.albedo,
                system,
                rmse.value,
                rmse.low,
                rmse.high,
                bias.value,
                bias.low,
                bias.high,
                paper_metric(rgb, a, b),
                layer.report.seconds["total"],
                needed * sample,
            )
        )
    return measured, pictures.picture(images, a, b)


def published_network() -> dict:
    """The published network's figures by view, in the names used here."""
    figures = json.loads((REFERENCES / "published_network.json").read_text())
    return {view: {"rmse": f["rel_rmse"], "bias": f["rel_bias"], "paper": f["paper"]} for view, f in figures.items()}


def write_csv(path: pathlib.Path, measured, made_by: str) -> None:
    """A row for each measurement."""
    rows = [{**asdict(one), "albedo": " ".join(f"{value:g}" for value in one.albedo)} for one in measured]
    replace(path, csv_text([made_by], list(rows[0]), [row.values() for row in rows]))
