# SPDX-License-Identifier: GPL-3.0-or-later
"""Figures of a comparison: errors, times, and equal-error and equal-time comparisons."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from ...evaluation.error import Estimate, paper_metric, relative_bias, relative_rmse
from ...evaluation.error_vs_time import (
    MEASURED,
    PathTracing,
    Reached,
    Rung,
    Verdict,
    cost,
    error_on_ladder,
    judge,
    seconds_on_ladder,
    variance_at_one,
    variance_on_ladder,
)
from ...inference.scene import SceneError
from ..cycles.choices import CHOICES, CYCLES, LADDERS, REFERENCE
from ..cycles.pass_store import Job, Pass
from ..runtime.json_file import write_json
from .perceptual import flip
from .plan import Request

# Below this alpha a pixel shows so little of the volume that ratios are noise.
MASK_ALPHA = 0.02
# Beyond this the two images show different volumes.
ALPHA_TOLERANCE = 0.05
CLOCKS = ("seconds", "cpu_seconds")
# Rungs of Cycles from which the cost of samples is fitted; with fewer, the reference's passes are included.
MIN_RUNGS = 3
# A layer keeps at least one processor busy; below this share, other programs slowed it down.
BUSY_SHARE = 0.7


@dataclass
class Equal:
    """The judged image against one method of Cycles, by one clock.

    seconds: of the judged image. frame_seconds: without what further frames do not repeat. needed: seconds that Cycles
    takes to reach its error. error: of Cycles in its time.
    """

    method: str
    clock: str
    seconds: float
    frame_seconds: float
    needed: Reached
    error: Reached

    @property
    def ratio(self) -> float:
        return self.needed.value / self.seconds

    @property
    def frame_ratio(self) -> float:
        return self.needed.value / self.frame_seconds

    def __str__(self) -> str:
        clock = "s" if self.clock == "seconds" else "processor seconds"
        method = self.method.capitalize()
        if not np.isfinite(self.ratio):
            return f"{method}: how long it takes to reach MRPNN's error is unknown"
        return (
            f"{method} needs {_quantity(self.needed, clock)} for MRPNN's error: {rounded(self.ratio)} times as "
            f"long as MRPNN, and {rounded(self.frame_ratio)} times as long as its next frame. In MRPNN's "
            f"{rounded(self.seconds)} {clock}, its error is {_quantity(self.error)}"
        )


@dataclass
class Comparison:
    """Figures of all candidates.

    rmse, bias, alpha_bias: of the judged image, relative, with 95 % intervals, where its alpha exceeds MASK_ALPHA.
    paper: the paper's metric over the whole image.
    noise: relative standard deviation of the reference per pixel, both halves together.
    layer_seconds: of the judged image. cycles_seconds: of the reference. Wall-clock.
    resolution: (width, height). pixels: those in the mask.
    samples: per pixel in each half. bounces: most scattering events. cycles: Blender's version.
    rungs: every candidate. equal: against each ladder of Cycles. path_tracing: convergence law by method and clock.
    marks: caveats about fairness or certainty. warnings: what the layer leaves out.
    """

    rmse: Estimate
    bias: Estimate
    alpha_bias: Estimate
    paper: float
    noise: float
    layer_seconds: float
    cycles_seconds: float
    resolution: tuple[int, int]
    pixels: int
    samples: int
    bounces: int
    cycles: str
    rungs: list[Rung]
    judged: Rung
    verdict: Verdict
    equal: list[Equal] = field(default_factory=list)
    path_tracing: dict[str, dict[str, PathTracing]] = field(default_factory=dict)
    marks: list[str] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)

    def table(self) -> str:
        """The figures as lines of text."""
        rows = [
            ("relative RMSE", f"{self.rmse.value:8.3f}", _interval(self.rmse, "{:.3f}")),
            ("relative bias", f"{100 * self.bias.value:+7.1f} %", _interval(self.bias, "{:+.1f} %", 100)),
            ("alpha bias", f"{100 * self.alpha_bias.value:+7.2f} %", _interval(self.alpha_bias, "{:+.2f} %", 100)),
            ("paper's metric", f"{self.paper:8.2f}", ""),
            ("seconds, layer", f"{self.layer_seconds:8.1f}", f"{self.judged.once:.1f} of them once per volume and sun"),
            (
                "seconds, Cycles",
                f"{self.cycles_seconds:8.1f}",
                f"2 x {self.samples} samples, {self.bounces} bounces, noise left {self.noise:.2f}",
            ),
        ]
        width, height = self.resolution
        head = f"Layer against Cycles {self.cycles}: {width} x {height}, {self.pixels} pixels show the volume"
        lines = [head] + [f"  {name:<16}{value:<10} {note}".rstrip() for name, value, note in rows]
        lines += [f"  reference {self.verdict}", *(f"  {line}" for line in self.sentences())]
        return "\n".join(lines + [f"  note: {mark}" for mark in self.marks])

    def sentences(self) -> list[str]:
        """Equal error and equal time, as sentences; of Cycles' two ways through volumes the quicker one first."""
        own = [one for one in self.equal if one.clock == self.clock]
        return [str(one) for one in sorted(own, key=lambda one: (CHOICES[one.method].denoised, one.ratio))]

    @property
    def clock(self) -> str:
        """The more reliable of CLOCKS: processor time where other programs slowed the layer down."""
        return "cpu_seconds" if self.judged.cpu_seconds < BUSY_SHARE * self.judged.seconds else "seconds"

    def figures(self) -> dict:
        """Everything as plain types; None for infinite figures."""
        return _finite(asdict(self))

    def write_json(self, path: str) -> None:
        """Write all figures to `path` atomically."""
        write_json(path, self.figures())


def rounded(value: float) -> str:
    """Two digits, without an exponent for large values."""
    return f"{float(f'{value:.2g}'):g}"


def _quantity(reached: Reached, unit: str = "") -> str:
    """A value with its unit, and how it is known where it is not measured."""
    return f"{rounded(reached.value)} {unit}".rstrip() + ("" if reached.how == MEASURED else f" ({reached.how})")


def _finite(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def halves(passes: dict[Job, Pass]) -> tuple[np.ndarray, ...] | None:
    """The two halves of the reference, float64 (H, W, 4), from its passes of even and odd seeds; None where one is
    missing.
    """
    found = []
    for half in range(2):
        jobs = [job for job in passes if job.method == REFERENCE and job.seed % 2 == half]
        if not jobs:
            return None
        total: Any = sum(job.samples * passes[job].image.astype(np.float64) for job in jobs)
        found.append(total / sum(job.samples for job in jobs))
    return tuple(found)


def compare(
    passes: dict[Job, Pass],
    request: Request,
    bounces: int,
    version: str,
    given: np.ndarray | None = None,
    marks: Sequence[str] = (),
) -> Comparison:
    """Measure every candidate among `passes` against their reference, or against a `given` one (H, W, 4).

    Raises SceneError where there is no reference yet, images differ in size or show different volumes, no volume is in
    view, or the reference is black.
    """
    judged_job = request.layers[0]
    layer = passes[judged_job]
    a, b = (given, given) if given is not None else halves(passes) or (None, None)
    if a is None:
        raise SceneError("there is no reference yet: Cycles was stopped before it finished two passes")
    if a.shape[:2] != layer.image.shape[:2]:
        raise SceneError(f"MRPNN's picture has {_size(layer.image)} pixels and the reference {_size(a)}")
    mask = layer.image[..., 3] > MASK_ALPHA
    references = [(job, done) for job, done in passes.items() if job.method == REFERENCE]
    reference_seconds = sum(done.seconds for _, done in references)
    samples = sum(job.samples for job, _ in references) // 2
    colour_a, colour_b = a[..., :3], b[..., :3]
    try:
        alpha_bias = relative_bias(layer.image[..., 3], a[..., 3], b[..., 3], mask)
        rungs = [
            _rung(job, done, colour_a, colour_b, mask)
            for job, done in sorted(passes.items(), key=_order(request))
            if job.method != REFERENCE
        ]
    except ValueError as error:
        raise SceneError(f"nothing to compare: {error}") from None
    marks = [*marks, *_marks(bounces, alpha_bias, given is not None)]
    judged = next(r for r in rungs if (r.method, r.samples) == (judged_job.method, judged_job.samples))
    mean = ((a + b) / 2)[mask][:, :3].mean()
    height, width = mask.shape
    result = Comparison(
        rmse=judged.rmse,
        bias=judged.bias,
        alpha_bias=alpha_bias,
        paper=paper_metric(layer.image[..., :3], colour_a, colour_b),
        # Half the difference of two independent halves has the variance of their mean.
        noise=float(np.sqrt(np.mean(((a - b) / 2)[mask][:, :3] ** 2)) / mean),
        layer_seconds=layer.seconds,
        cycles_seconds=reference_seconds,
        resolution=(width, height),
        pixels=int(mask.sum()),
        samples=samples,
        bounces=bounces,
        cycles=version,
        rungs=rungs,
        judged=judged,
        verdict=judge(judged, colour_a, colour_b, mask, reference_seconds),
        marks=marks,
        warnings=list(layer.warnings),
    )
    if given is None:
        if result.clock != CLOCKS[0]:
            result.marks.append(
                "other programs slowed MRPNN down: it ran for "
                f"{judged.seconds:.1f} s and got {judged.cpu_seconds:.1f} processor seconds; "
                "processor time is compared"
            )
        _add_equal(result, references, variance_at_one(colour_a, colour_b, mask, samples))
    return result


def _rung(job: Job, done: Pass, a: np.ndarray, b: np.ndarray, mask: np.ndarray) -> Rung:
    image = done.image[..., :3]
    return Rung(
        job.method,
        job.samples,
        done.seconds,
        done.cpu_seconds,
        done.once,
        done.once_cpu,
        relative_rmse(image, a, b, mask),
        relative_bias(image, a, b, mask),
        flip(image, (a + b) / 2),
    )


def _add_equal(result: Comparison, references: Any, variance: float) -> None:
    """Equal-error and equal-time figures by both clocks. variance: of the references, which are marched."""
    for clock in CLOCKS:
        seconds = getattr(result.judged, clock)
        frame = seconds - (result.judged.once if clock == CLOCKS[0] else result.judged.once_cpu)
        for method in LADDERS:
            rungs = [r for r in result.rungs if r.method == method]
            if CHOICES[method].denoised and rungs:
                needed = seconds_on_ladder(rungs, result.judged.error, clock)
                error = error_on_ladder(rungs, seconds, clock)
            elif method == CYCLES or rungs:
                known = [(r.samples, getattr(r, clock)) for r in rungs]
                # The references may be older, rendered under another load.
                if method == CYCLES and len(known) < MIN_RUNGS:
                    known += [(job.samples, getattr(done, clock)) for job, done in references]
                noise = variance if method == CYCLES else variance_on_ladder(rungs)
                law = PathTracing(*cost(*zip(*known)), noise, max(n for n, _ in known))
                result.path_tracing.setdefault(method, {})[clock] = law
                needed, error = law.seconds_for(result.judged.error), law.error_after(seconds)
            else:
                continue
            result.equal.append(Equal(method, clock, seconds, frame, needed, error))


def _marks(bounces: int, alpha_bias: Estimate, given: bool) -> list[str]:
    found = []
    if bounces < 1024 and not given:
        found.append(f"the reference stops after {bounces} bounces: in dense and white volumes it is too dark")
    if given:
        found.append(
            "the reference is one image from a file: its noise counts as error, and whether it was clamped, "
            "denoised or cut off after few bounces cannot be seen"
        )
    if alpha_bias.low > ALPHA_TOLERANCE or alpha_bias.high < -ALPHA_TOLERANCE:
        text = f"the layer's alpha differs from the reference's by {alpha_bias.value:+.0%}: they show different volumes"
        if given:
            raise SceneError(f"{text}; render the file from the same camera, frame and region, on a transparent film")
        found.append(text)
    return found


def _order(request: Request) -> Callable[[tuple[Job, Pass]], tuple]:
    """Layers in the order of the request, then Cycles by samples."""
    places = {job: i for i, job in enumerate(request.layers)}
    return lambda item: (places.get(item[0], len(places)), item[0].method, item[0].samples)


def _interval(estimate: Estimate, form: str, scale: float = 1.0) -> str:
    low, high = (form.format(scale * edge) for edge in (estimate.low, estimate.high))
    # Noise hides how small it is.
    return f"95 % below {high}" if low == "0.000" else f"95 % between {low} and {high}"


def _size(image: np.ndarray) -> str:
    return f"{image.shape[1]} x {image.shape[0]}"
