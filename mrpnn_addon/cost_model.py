"""Seconds that a render takes, by what it has to do and by what renders before took; no bpy.

A render marches camera rays, asks the network at points along them and prepares the fields of each volume and light.
`Work` counts that from boxes around the volumes; constants tell the seconds. What a box does not tell (how much of it
is empty, how much of the image is opaque) is learned from the last render of the same volumes, and the speed of the
machine from the last render of any.
"""

import math
from dataclasses import dataclass, field
from typing import Dict, FrozenSet, List, Optional

import numpy as np

from ..inference.marching.ray_steps import MIN_VOXELS, STEPS_PER_DEPTH, STEPS_PER_EDGE, STEPS_PER_VOXEL
from ..inference.numerics.intersection import box_interval
from ..inference.scene.camera_rays import image_rays, window_around
from ..inference.scene import Camera

# Seconds on two cores of a desktop of 2020. Of a step that is evaluated, by itself and for each light and volume; the
# second of each where voxels are so thick that light is integrated in them, and of the first where steps are cut again.
STEP, STEP_THICK, STEP_STIFF = 3.0e-7, 4.0e-7, 1.1e-6
STEP_LIGHT, STEP_LIGHT_THICK = 1.0e-7, 4.0e-7
# Of a pixel and of a point, for each light.
PIXEL, POINT = 2.3e-6, 3.6e-6
# Of each volume, and of each volume and light.
VOLUME, FIELD = 0.25, 0.3
# Optical thickness of a voxel above which light is integrated, and of a step above which it is cut again.
THICK, MAX_STEP_THICKNESS = 0.35, 0.6
CORES = 2
# More cores help a little less than in proportion.
SCALING = 0.9
# Shares before any render or reading has told them: of steps that are evaluated, of pixels in a box that show density.
LOOKED_AT, MEETING = 0.25, 0.5
# Share of points at which the network is asked, for one depth sample and so many pixels that meet density; others take
# their neighbours' answer, the more the finer the image is, and the fewer samples each pixel has.
ASKED, ASKED_PIXELS, ASKED_BY_PIXELS, ASKED_BY_SAMPLES = 0.5, 20_000, -0.25, 0.2
# Share of the density's peak that a ray meets on its mean.
FILLED = 0.1
# Rays along each axis of the image that stand for all.
RAYS = 48
# Stages below this many seconds tell nothing about the machine.
TELLING = 0.1
STAGES = ("march", "network", "fields")


@dataclass
class Box:
    """Around one volume. name: of its object. matrix: (4, 4), from the box to the world; low, high: (3,), its ends.
    voxel: edge of a voxel, world units. thickness: largest optical depth of a voxel. cells: along its longest edge.
    filled: share of the voxels that hold density, None where the volume has not been read.
    """

    name: str
    matrix: np.ndarray
    low: np.ndarray
    high: np.ndarray
    voxel: float
    thickness: float
    cells: float
    filled: Optional[float] = None


@dataclass
class Work:
    """What a render has to do, as its boxes tell.

    names: of the volumes. window: pixels around their boxes; pixels: in the boxes. steps: that their rays are cut into.
    opacity: mean square root of the pixels' opacity, a guess. thickness: of a voxel; stiff: whether steps are cut
    again. volumes, lights, samples: how many. channels: colours that are marched by themselves. filled: share of voxels
    that hold density, None where some volume has not been read.
    """

    names: FrozenSet[str] = frozenset()
    window: int = 0
    pixels: float = 0.0
    steps: float = 0.0
    opacity: float = 1.0
    thickness: float = 0.0
    stiff: bool = False
    volumes: int = 0
    lights: int = 0
    samples: int = 1
    channels: int = 1
    filled: Optional[float] = None


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


def work(boxes: List[Box], camera: Camera, lights: int, samples: int, channels: int = 1) -> Work:
    """What a render has to do; boxes may overlap."""
    covered = pixels_around(boxes, camera)
    found = Work(frozenset(box.name for box in boxes), int(covered.sum()), volumes=len(boxes), lights=lights,
                 samples=samples, channels=channels)
    if not found.window:
        return found
    x0, y0 = camera.window[:2]
    across, down = (np.flatnonzero(covered.any(axis=axis)) for axis in (0, 1))
    left, right, top, bottom = across[0] + x0, across[-1] + 1 + x0, down[0] + y0, down[-1] + 1 + y0
    columns, rows = min(right - left, RAYS), min(bottom - top, RAYS)
    x, y = np.meshgrid(left + (np.arange(columns) + 0.5) * (right - left) / columns,
                       top + (np.arange(rows) + 0.5) * (bottom - top) / rows)
    origins, directions, cosine = image_rays(camera, x.ravel(), y.ravel())
    near, far, thickness = _intervals(boxes, origins, directions, camera.clip[0] / cosine, camera.clip[1] / cosine)
    hit = near < far
    share = (right - left) * (bottom - top) / len(hit)
    found.pixels = min(float(hit.sum()) * share, float(found.window))
    filled = [box.filled for box in boxes]
    found.filled = None if None in filled else float(np.mean(filled))
    found.thickness = sum(box.thickness for box in boxes)
    a_voxel = max(float(np.clip(STEPS_PER_DEPTH * found.thickness, *STEPS_PER_VOXEL)),
                  STEPS_PER_EDGE / max(max(box.cells for box in boxes), 1.0))
    found.stiff = found.thickness / a_voxel > MAX_STEP_THICKNESS
    voxels = np.maximum((far - near)[hit] / min(box.voxel for box in boxes), MIN_VOXELS)
    found.steps = float(np.ceil(voxels * a_voxel).sum()) * share
    if hit.any():
        found.opacity = float(np.sqrt(-np.expm1(-FILLED * thickness[hit])).mean())
    return found


def pixels_around(boxes: List[Box], camera: Camera) -> np.ndarray:
    """bool (H, W): pixels of the camera's window that may show a box, and those around them."""
    x0, y0, x1, y1 = camera.window
    covered = np.zeros((y1 - y0, x1 - x0), bool)
    for box in boxes:
        left, top, right, bottom = window_around(camera, _corners(box))
        covered[top - y0:bottom - y0, left - x0:right - x0] = True
    return covered


def _corners(box: Box) -> np.ndarray:
    """(8, 3) in the world."""
    corners = np.array(np.meshgrid(*zip(box.low, box.high), indexing="ij")).reshape(3, -1)
    return (box.matrix[:3, :3] @ corners + box.matrix[:3, 3:]).T


def _intervals(boxes, origins, directions, clip_near, clip_far):
    """Distances (N,) at which rays enter the first box and leave the last, and optical depths (N,) if all were full."""
    near, far = np.full(len(origins), np.inf), np.full(len(origins), -np.inf)
    thickness = np.zeros(len(origins))
    for box in boxes:
        try:
            inverse = np.linalg.inv(box.matrix)
        except np.linalg.LinAlgError:
            continue
        start = origins @ inverse[:3, :3].T + inverse[:3, 3]
        first, last = box_interval(start, directions @ inverse[:3, :3].T, box.low, box.high)
        first, last = np.maximum(first, clip_near), np.minimum(last, clip_far)
        met = first < last
        near[met], far[met] = np.minimum(near, first)[met], np.maximum(far, last)[met]
        thickness[met] += box.thickness * (last - first)[met] / box.voxel
    return near, far, thickness


def seconds_of(asked: Work, threads: int, known: Experience) -> float:
    """Seconds by the clock, roughly."""
    shares = _shares(asked, known)
    evaluated = asked.steps * shares.evaluated * asked.channels
    taken = _seconds(asked, evaluated, *_points(asked, shares))
    total = sum(seconds * known.rates.get(stage, 1.0) for stage, seconds in taken.items())
    return total * (known.threads / max(threads, 1)) ** SCALING


def learn(known: Experience, asked: Work, report, alpha: np.ndarray) -> None:
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


def _shares(asked: Work, known: Experience) -> Shares:
    """Of these volumes; else the means of the constants and of all that are known. Steps are evaluated where voxels are
    filled, about."""
    if asked.names in known.shares:
        return known.shares[asked.names]
    all_known = [Shares(), *known.shares.values()]
    evaluated, meeting = (float(np.mean([getattr(one, name) for one in all_known])) for name in ("evaluated", "meeting"))
    return Shares(evaluated if asked.filled is None else asked.filled, meeting)


def is_rough(asked: Work, known: Experience) -> bool:
    """Whether neither a render nor a reading has told how dense the volumes are."""
    return asked.filled is None and asked.names not in known.shares


def _points(asked: Work, shares: Shares):
    """Pixels that meet density, and points at which the network is asked for each light."""
    pixels = asked.pixels * shares.meeting * asked.channels
    opacity = asked.opacity if shares.opacity is None else shares.opacity
    # Faint rays have fewer samples, rounded up, but two at least.
    points = pixels * min(max(asked.samples * opacity + 0.5, 2.0), asked.samples)
    share = ASKED * max(pixels / ASKED_PIXELS, 1e-3) ** ASKED_BY_PIXELS * asked.samples ** ASKED_BY_SAMPLES
    return pixels, points * min(share, 1.0) * shares.asked


def _seconds(asked: Work, evaluated: float, pixels: float, points: float) -> Dict[str, float]:
    """By stage, by the constants."""
    thick, each = asked.thickness > THICK, asked.lights * max(asked.volumes, 1)
    step = STEP_STIFF if asked.stiff else STEP_THICK if thick else STEP
    light = STEP_LIGHT_THICK if thick else STEP_LIGHT
    return {
        "march": evaluated * (step * math.sqrt(max(asked.volumes, 1)) + light * each),
        "network": asked.lights * (PIXEL * pixels + POINT * points),
        "fields": VOLUME * asked.volumes + FIELD * each,
    }
