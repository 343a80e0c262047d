"""Seconds that a render takes, by what it has to do and by what renders before took; no bpy.

A render marches camera rays, asks the network at points along them and prepares the fields of each volume and light.
`Workload` counts that from boxes around the volumes; constants tell the seconds. What a box does not tell (how much of it
is empty, how much of the image is opaque) is learned from the last render of the same volumes, and the speed of the
machine from the last render of any.
"""

import math
from dataclasses import dataclass, field
from typing import Dict, FrozenSet, Optional

import numpy as np

from ..objects.workload import Workload

# Seconds on two cores of a desktop of 2020. Of a step that is evaluated, by itself and for each light and volume; the
# second of each where voxels are so thick that light is integrated in them, and of the first where steps are cut again.
STEP, STEP_THICK, STEP_STIFF = 3.0e-7, 4.0e-7, 1.1e-6
STEP_LIGHT, STEP_LIGHT_THICK = 1.0e-7, 4.0e-7
# Of a pixel and of a point, for each light.
PIXEL, POINT = 2.3e-6, 3.6e-6
# Of each volume, and of each volume and light.
VOLUME, FIELD = 0.25, 0.3
# Optical thickness of a voxel above which light is integrated.
THICK = 0.35
CORES = 2
# More cores help a little less than in proportion.
SCALING = 0.9
# Shares before any render or reading has told them: of steps that are evaluated, of pixels in a box that show density.
LOOKED_AT, MEETING = 0.25, 0.5
# Share of points at which the network is asked, for one depth sample and so many pixels that meet density; others take
# their neighbours' answer, the more the finer the image is, and the fewer samples each pixel has.
ASKED, ASKED_PIXELS, ASKED_BY_PIXELS, ASKED_BY_SAMPLES = 0.5, 20_000, -0.25, 0.2
# Stages below this many seconds tell nothing about the machine.
TELLING = 0.1
STAGES = ("march", "network", "fields")


@dataclass
class Shares:
    """Of one set of volumes, as a render has told: steps evaluated of all, pixels that meet density of all, the mean square
    root of those pixels' opacity, and points asked for, over what the constants say."""

    evaluated: float = LOOKED_AT
    meeting: float = MEETING
    opacity: Optional[float] = None
    asked: float = 1.0


@dataclass
class Experience:
    """What renders have told.

    shares: by the names of the volumes. rates: seconds by stage over what the constants say; empty before the first
    render. threads: of the render that told them.
    """

    shares: Dict[FrozenSet[str], Shares] = field(default_factory=dict)
    rates: Dict[str, float] = field(default_factory=dict)
    threads: int = CORES


def seconds_of(asked: Workload, threads: int, known: Experience) -> float:
    """Seconds by the clock, roughly."""
    shares = _shares(asked, known)
    evaluated = asked.steps * shares.evaluated * asked.channels
    taken = _seconds(asked, evaluated, *_points(asked, shares))
    total = sum(seconds * known.rates.get(stage, 1.0) for stage, seconds in taken.items())
    return total * (known.threads / max(threads, 1)) ** SCALING


def learn(known: Experience, asked: Workload, report, alpha: np.ndarray) -> None:
    """Keep what a render tells. asked: what it had to do; report: what it did; alpha: (H, W), its opacity."""
    count = report.counts.get
    lights, evaluated = max(count("suns", 0), 1), count("steps evaluated", 0)
    if not evaluated or not asked.steps or not asked.lights:
        return
    opaque, channels = alpha[alpha > 0.0], asked.channels
    shares = Shares(
        evaluated=min(evaluated / (asked.steps * channels), 1.0),
        meeting=count("rays that meet density", 0) / channels / max(asked.pixels, 1.0),
        opacity=float(np.sqrt(opaque).mean()) if opaque.size else None)
    pixels, points = _points(asked, shares)
    if count("network points", 0) and points:
        shares.asked = count("network points", 0) / (points * lights)
    known.shares[asked.names] = shares
    expected = _seconds(asked, evaluated, pixels, points * shares.asked)
    took = {stage: report.seconds.get(stage, 0.0) for stage in STAGES}
    took["fields"] += report.seconds.get("shadows", 0.0)
    scale = (known.threads / max(report.threads, 1)) ** SCALING
    # What this one does not tell holds for the number of threads that it was told for.
    known.rates = {stage: rate * scale for stage, rate in known.rates.items()}
    known.threads = max(report.threads, 1)
    for stage, seconds in took.items():
        if seconds > TELLING:
            known.rates[stage] = seconds / expected[stage]


def _shares(asked: Workload, known: Experience) -> Shares:
    """Of these volumes; else the means of the constants and of all that are known. Steps are evaluated where voxels are
    filled, about."""
    if asked.names in known.shares:
        return known.shares[asked.names]
    all_known = [Shares(), *known.shares.values()]
    evaluated, meeting = (float(np.mean([getattr(one, name) for one in all_known])) for name in ("evaluated", "meeting"))
    return Shares(evaluated if asked.filled is None else asked.filled, meeting)


def is_rough(asked: Workload, known: Experience) -> bool:
    """Whether neither a render nor a reading has told how dense the volumes are."""
    return asked.filled is None and asked.names not in known.shares


def _points(asked: Workload, shares: Shares):
    """Pixels that meet density, and points at which the network is asked for each light."""
    pixels = asked.pixels * shares.meeting * asked.channels
    opacity = asked.opacity if shares.opacity is None else shares.opacity
    # Faint rays have fewer samples, rounded up, but two at least.
    points = pixels * min(max(asked.samples * opacity + 0.5, 2.0), asked.samples)
    share = ASKED * max(pixels / ASKED_PIXELS, 1e-3) ** ASKED_BY_PIXELS * asked.samples ** ASKED_BY_SAMPLES
    return pixels, points * min(share, 1.0) * shares.asked


def _seconds(asked: Workload, evaluated: float, pixels: float, points: float) -> Dict[str, float]:
    """By stage, by the constants."""
    thick, each = asked.thickness > THICK, asked.lights * max(asked.volumes, 1)
    step = STEP_STIFF if asked.stiff else STEP_THICK if thick else STEP
    light = STEP_LIGHT_THICK if thick else STEP_LIGHT
    return {
        "march": evaluated * (step * math.sqrt(max(asked.volumes, 1)) + light * each),
        "network": asked.lights * (PIXEL * pixels + POINT * points),
        "fields": VOLUME * asked.volumes + FIELD * each,
    }
