# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates render time from a render's work and from earlier renders; imports no bpy.

A render marches camera rays, evaluates the network at points along them, and prepares fields of each volume and light.
`Workload` counts these from bounding boxes; constants convert them to seconds. What boxes do not show (how much of them
is empty, how much of the image is opaque) is calibrated by the last render of the same volumes, and the machine's speed
by the last render of any.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from ...inference.runtime.report import Report
from ..objects.workload import Workload

# Seconds on two cores of a 2020 desktop. Per step evaluated, and per step, light and volume; the second value applies
# where light is integrated within optically thick voxels.
STEP, STEP_LIGHT, STEP_LIGHT_THICK = 2.0e-8, 1.0e-8, 2.5e-8
# Seconds per pixel and per point, for each light.
PIXEL, POINT = 0.9e-6, 1.6e-6
# Seconds per volume, and per volume and light.
VOLUME, FIELD = 0.25, 0.3
# Optical thickness of a voxel above which light is integrated within it.
THICK = 0.35
CORES = 2
# Speed-up grows with this power of the number of cores.
SCALING = 0.9
# Shares before any render or reading: of steps that are evaluated, of pixels in a box that show density.
EVALUATED, VISIBLE = 0.25, 0.5
# Share of points at which the network is evaluated, for one depth sample and so many pixels with density. The others
# are interpolated: more of them in larger images and at fewer depth samples.
QUERIED, QUERIED_PIXELS, QUERIED_BY_PIXELS, QUERIED_BY_SAMPLES = 0.5, 20_000, -0.4, 0.2
# Stages shorter than this do not calibrate the machine's speed.
SHORTEST = 0.1
STAGES = ("march", "network", "fields")


@dataclass
class Shares:
    """Of one set of volumes, from a render: share of steps evaluated, share of pixels with density, mean square root of
    their opacity, and evaluations of the network relative to the constants.
    """

    evaluated: float = EVALUATED
    visible: float = VISIBLE
    opacity: float | None = None
    queried: float = 1.0


@dataclass
class Calibration:
    """Results of earlier renders.

    shares: by the names of the volumes. rates: measured over modelled seconds by stage; empty before the first render.
    threads: of the render that set the rates.
    """

    shares: dict[frozenset[str], Shares] = field(default_factory=dict)
    rates: dict[str, float] = field(default_factory=dict)
    threads: int = CORES


def estimate_seconds(workload: Workload, threads: int, known: Calibration) -> float:
    """Estimated wall-clock seconds."""
    shares = _shares(workload, known)
    evaluated = (workload.steps * shares.evaluated + workload.fine) * workload.channels
    taken = _seconds(workload, evaluated, *_points(workload, shares))
    total = sum(seconds * known.rates.get(stage, 1.0) for stage, seconds in taken.items())
    return total * (known.threads / max(threads, 1)) ** SCALING


def calibrate(known: Calibration, workload: Workload, report: Report, alpha: np.ndarray) -> None:
    """Update a calibration. workload: the render's work. report: its report. alpha: (H, W), its opacity."""
    count = report.counts.get
    lights, evaluated = max(count("suns", 0) + count("environments", 0), 1), count("steps evaluated", 0)
    if not evaluated or not workload.steps or not workload.lights:
        return
    opaque, channels = alpha[alpha > 0.0], workload.channels
    shares = Shares(
        evaluated=float(np.clip((evaluated / channels - workload.fine) / workload.steps, 0.0, 1.0)),
        visible=count("rays that meet density", 0) / channels / max(workload.pixels, 1.0),
        opacity=float(np.sqrt(opaque).mean()) if opaque.size else None,
    )
    pixels, points = _points(workload, shares)
    # Small pictures, of which every pixel is evaluated, do not tell how many of a larger one's are.
    if 0 < count("network points", 0) < count("network points wanted", 0) and points:
        shares.queried = count("network points", 0) / (points * lights)
    known.shares[workload.names] = shares
    expected = _seconds(workload, evaluated, pixels, points * shares.queried)
    took = {stage: report.seconds.get(stage, 0.0) for stage in STAGES}
    took["fields"] += report.seconds.get("shadows", 0.0)
    scale = (known.threads / max(report.threads, 1)) ** SCALING
    # Rates that this render does not update still apply, rescaled to its number of threads.
    known.rates = {stage: rate * scale for stage, rate in known.rates.items()}
    known.threads = max(report.threads, 1)
    for stage, seconds in took.items():
        if seconds > SHORTEST:
            known.rates[stage] = seconds / expected[stage]


def _shares(workload: Workload, known: Calibration) -> Shares:
    """Of these volumes; otherwise means of the constants and of all known volumes. The share of steps evaluated is
    about that of voxels with density.
    """
    if workload.names in known.shares:
        return known.shares[workload.names]
    all_known = [Shares(), *known.shares.values()]
    evaluated, visible = (
        float(np.mean([getattr(one, name) for one in all_known])) for name in ("evaluated", "visible")
    )
    return Shares(evaluated if workload.filled is None else workload.filled, visible)


def is_rough(workload: Workload, known: Calibration) -> bool:
    """Whether neither a render nor a reading has revealed the density of the volumes."""
    return workload.filled is None and workload.names not in known.shares


def _points(workload: Workload, shares: Shares) -> tuple[float, float]:
    """Pixels with density, and points at which the network is evaluated for each light."""
    pixels = workload.pixels * shares.visible * workload.channels
    opacity = workload.opacity if shares.opacity is None else shares.opacity
    # Transparent rays have fewer samples, rounded up, but at least two.
    points = pixels * min(max(workload.samples * opacity + 0.5, 2.0), workload.samples)
    share = QUERIED * max(pixels / QUERIED_PIXELS, 1e-3) ** QUERIED_BY_PIXELS * workload.samples**QUERIED_BY_SAMPLES
    return pixels, points * min(share, 1.0) * shares.queried


def _seconds(workload: Workload, evaluated: float, pixels: float, points: float) -> dict[str, float]:
    """Modelled seconds by stage."""
    thick, each = workload.thickness > THICK, workload.lights * max(workload.volumes, 1)
    light = STEP_LIGHT_THICK if thick else STEP_LIGHT
    return {
        "march": evaluated * (STEP * math.sqrt(max(workload.volumes, 1)) + light * each),
        "network": workload.lights * (PIXEL * pixels + POINT * points),
        "fields": VOLUME * workload.volumes + FIELD * each,
    }
