# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates render time from a render's work and from earlier renders; imports no bpy.

A render reads volumes, marches camera rays, evaluates the network at points along them, and prepares fields of each
volume and light. `Workload` counts these from bounding boxes; constants convert them to seconds. What boxes do not show
(how much of them is empty, how much of the image is opaque) is calibrated by the last render of the same volumes, and
the machine's speed by the last render of any.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from ...inference.runtime.report import Report
from ..objects.workload import Workload

# All constants are processor seconds of a desktop of 2020, see `benchmarks.cost.forecast`.
# Of each step evaluated in a volume, and of each in the light of a sun and of a lamp.
STEP, STEP_SUN, STEP_LAMP = 6.0e-8, 6.0e-8, 2.0e-7
# Of each pixel and light, and of each point at which the network is evaluated for a sun, a lamp and the World.
PIXEL, POINT_SUN, POINT_LAMP, POINT_WORLD = 1.0e-6, 1.5e-5, 2.0e-5, 3.0e-5
# Of each volume, and of the coarse transport and lattices of a sun, a lamp and the World, in each volume or in all that
# overlap; of surfaces, which shadow the volumes and throw light into them.
VOLUME, FIELD_SUN, FIELD_LAMP, FIELD_WORLD, SURFACES = 0.25, 0.6, 1.4, 0.5, 1.7
# Of reading a volume, and of each voxel in it, of so many cells of its box at most.
READ, VOXEL, MOST_CELLS = 0.4, 3.0e-8, 512.0
# The parallel parts speed up with this power of the number of threads, the fields with that.
SCALING, FIELD_SCALING = 0.9, 0.6
# Shares before any render or reading: of steps that are evaluated, of pixels in a box that show density.
EVALUATED, VISIBLE = 0.4, 0.75
# Share of points at which the network is evaluated, for one depth sample and so many pixels with density. The others
# are interpolated: more of them in larger images and at fewer depth samples.
QUERIED, QUERIED_PIXELS, QUERIED_BY_PIXELS, QUERIED_BY_SAMPLES = 0.2, 20_000, -0.4, 0.2
# Stages that take less, or should take less, do not calibrate the machine's speed: in small pictures most is overhead.
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
    bakes: the same of whole bakes, by the names of the volumes.
    """

    shares: dict[frozenset[str], Shares] = field(default_factory=dict)
    rates: dict[str, float] = field(default_factory=dict)
    bakes: dict[frozenset[str], float] = field(default_factory=dict)


def estimate_seconds(workload: Workload, threads: int, known: Calibration) -> float:
    """Estimated wall-clock seconds, from reading the scene to the end; with one thread, processor seconds."""
    shares = _shares(workload, known)
    evaluated = (workload.steps * shares.evaluated + workload.fine) * workload.channels
    taken = _seconds(workload, evaluated, *_points(workload, shares), threads)
    return _reading(workload) + sum(seconds * known.rates.get(stage, 1.0) for stage, seconds in taken.items())


def calibrate(known: Calibration, workload: Workload, report: Report, alpha: np.ndarray) -> None:
    """Update a calibration. workload: the render's work. report: its report. alpha: (H, W), its opacity."""
    count = report.counts.get
    lights, evaluated = max(workload.lights, 1), count("steps evaluated", 0)
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
    expected = _seconds(workload, evaluated, pixels, points * shares.queried, report.threads)
    took = {stage: report.seconds.get(stage, 0.0) for stage in STAGES}
    took["fields"] += sum(report.seconds.get(stage, 0.0) for stage in ("shadows", "surfaces", "light paths"))
    for stage, seconds in took.items():
        if seconds > SHORTEST and expected[stage] > SHORTEST:
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


def _seconds(workload: Workload, evaluated: float, pixels: float, points: float, threads: int) -> dict[str, float]:
    """Modelled wall-clock seconds by stage."""
    volumes, groups, lamps, worlds = max(workload.volumes, 1), workload.groups, workload.lamps, workload.worlds
    suns = workload.lights - lamps - worlds
    parallel, fields = max(threads, 1) ** SCALING, max(threads, 1) ** FIELD_SCALING
    step = STEP * math.sqrt(volumes) + volumes * (STEP_SUN * suns + STEP_LAMP * lamps)
    point = POINT_SUN * suns + POINT_LAMP * lamps + POINT_WORLD * worlds
    field = FIELD_SUN * suns + FIELD_LAMP * lamps + FIELD_WORLD * worlds
    return {
        "march": evaluated * step / parallel,
        "network": (PIXEL * workload.lights * pixels + point * points) / parallel,
        "fields": (volumes * VOLUME + max(groups, 1) * field + SURFACES * workload.surfaces) / fields,
    }


def _reading(workload: Workload) -> float:
    """Seconds in which the volumes are read and filled, and Cycles renders the sky."""
    return workload.sky + sum(READ + VOXEL * min(cells, MOST_CELLS) ** 3 for cells in workload.cells)
