# SPDX-License-Identifier: GPL-3.0-or-later
"""Error against run time: candidates at several sample counts, and the error that a given time buys.

The error of a path tracer is noise: error^2 = variance / samples. Its variance is estimated from the two halves of the
reference and its seconds per sample from rendered images, so that the error at other sample counts is extrapolated, and
marked as such.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from .error import Estimate, tile_sums

MEASURED, EXTRAPOLATED, AT_MOST, AT_LEAST = "measured", "extrapolated", "at most", "at least"
# A reference is good if its noise changes the RMSE of a candidate by less than this fraction.
ACCURACY = 0.1


@dataclass
class Rung:
    """One candidate's image against the reference.

    method: name of the renderer. samples: per pixel, or depth samples. seconds: wall clock of the frame. cpu_seconds:
    of all threads. once, once_cpu: the part of these that further frames of the same volume and sun do not repeat.
    rmse, bias: relative. flip: NVIDIA's perceptual difference, None if it was not computed.
    """

    method: str
    samples: int
    seconds: float
    cpu_seconds: float
    once: float
    once_cpu: float
    rmse: Estimate
    bias: Estimate
    flip: float | None = None

    @property
    def error(self) -> float:
        """The RMSE, or the upper end of its interval where the reference cannot tell it from 0."""
        return self.rmse.value or self.rmse.high


@dataclass
class Reached:
    """A value; how: MEASURED, EXTRAPOLATED, AT_MOST or AT_LEAST."""

    value: float
    how: str

    def __str__(self) -> str:
        return f"{self.value:.3g}" + ("" if self.how == MEASURED else f" ({self.how})")


@dataclass
class PathTracing:
    """Cost and noise of a path tracer: seconds = start + each * samples, error = sqrt(variance / samples).

    variance: of a pixel at one sample, over the squared mean. largest: largest number of samples that was rendered.
    """

    start: float
    each: float
    variance: float
    largest: int

    def seconds(self, samples: float) -> float:
        """Time for a number of samples per pixel."""
        return self.start + self.each * samples

    def seconds_for(self, error: float) -> Reached:
        """Time until the noise falls to `error`."""
        samples = self.variance / error**2 if error > 0.0 else np.inf
        return Reached(self.seconds(samples), MEASURED if 1 <= samples <= self.largest else EXTRAPOLATED)

    def error_after(self, seconds: float) -> Reached:
        """Error after a time in seconds; that of a single sample if the time is too short for it."""
        samples = (seconds - self.start) / self.each
        if samples < 1.0:
            return Reached(float(np.sqrt(self.variance)), AT_LEAST)
        return Reached(float(np.sqrt(self.variance / samples)), MEASURED if samples <= self.largest else EXTRAPOLATED)


def cost(samples: ArrayLike, seconds: ArrayLike) -> tuple[float, float]:
    """Fit (start, per_sample) of seconds = start + per_sample * samples by relative error; neither is negative."""
    x, y = np.asarray(samples, float), np.asarray(seconds, float)
    if len(np.unique(x)) < 2:
        return 0.0, float((y / x).mean())
    per_sample, start = np.polyfit(x, y, 1, w=1.0 / np.maximum(y, 1e-9))
    if per_sample <= 0.0 or start < 0.0:
        return 0.0, float(y.sum() / x.sum())
    return float(start), float(per_sample)


def variance_at_one(a: np.ndarray, b: np.ndarray, mask: np.ndarray, samples: float) -> float:
    """Variance of a pixel at one sample over the squared mean; a, b: (H, W, C) halves of `samples` each."""
    return float(0.5 * np.mean((a - b)[mask] ** 2) * samples / (0.5 * np.mean((a + b)[mask])) ** 2)


def variance_on_ladder(rungs: Sequence[Rung]) -> float:
    """As `variance_at_one`, from the errors of a ladder without bias; larger numbers of samples weigh more."""
    return float(sum((r.samples * r.rmse.value) ** 2 for r in rungs) / sum(r.samples for r in rungs))


def seconds_on_ladder(rungs: Sequence[Rung], error: float, clock: str = "seconds") -> Reached:
    """Time in which a ladder of one method, by ascending samples, reaches `error`.

    Log-log interpolation between rungs. Beyond the last rung the error is assumed to fall with 1 / sqrt(samples), which
    a biased filter cannot exceed: AT_LEAST. clock: attribute of Rung to read.
    """
    times, errors = [getattr(r, clock) for r in rungs], [r.error for r in rungs]
    for i, (time, reached) in enumerate(zip(times, errors)):
        if reached <= error:
            if i == 0:
                return Reached(time, AT_MOST)
            exponent = np.log(errors[i - 1] / error) / max(np.log(errors[i - 1] / max(reached, 1e-12)), 1e-12)
            return Reached(float(times[i - 1] * (time / times[i - 1]) ** min(exponent, 1.0)), MEASURED)
    if error <= 0.0:
        return Reached(np.inf, AT_LEAST)
    best = int(np.argmin(errors))
    start, per_sample = cost([r.samples for r in rungs], times)
    return Reached(start + per_sample * rungs[best].samples * (errors[best] / error) ** 2, AT_LEAST)


def error_on_ladder(rungs: Sequence[Rung], seconds: float, clock: str = "seconds") -> Reached:
    """Error of a ladder of one method after a time in seconds: that of the best rung finished by then."""
    done = [r.error for r in rungs if getattr(r, clock) <= seconds]
    return Reached(min(done), MEASURED) if done else Reached(rungs[0].error, AT_LEAST)


@dataclass
class Verdict:
    """Whether a reference is good enough to judge a candidate.

    more: factor of its samples that a good reference has, at least 1. seconds: that a good reference takes.
    """

    good: bool
    more: float
    seconds: float

    def __str__(self) -> str:
        if self.good:
            return f"good: its noise moves the error by less than {ACCURACY:.0%}"
        if not np.isfinite(self.more):
            return "too noisy to judge: the error cannot be told from 0"
        return (
            f"too noisy to judge the error to {ACCURACY:.0%}; compare again with {self.more:.1f} times the Samples "
            f"(about {self.seconds:.0f} s)"
        )


def judge(rung: Rung, a: np.ndarray, b: np.ndarray, mask: np.ndarray, seconds: float) -> Verdict:
    """Whether halves a, b (H, W, C), rendered in `seconds`, determine the rung's RMSE to ACCURACY.

    The mean of (d - e_a)(d - e_b) over P pixels, with independent noise e of variance v, has the variance
    (2 d^2 v + v^2) / P.
    """
    mean = 0.5 * np.mean((a + b)[mask])
    variance = 0.5 * (((a - b) / mean) ** 2).reshape(*mask.shape, -1).mean(axis=-1) * mask
    pixels = mask.sum()
    tiles, counts = tile_sums(variance), tile_sums(mask.astype(float))
    first = variance.sum() / pixels
    second = float((tiles[counts > 0] ** 2 / counts[counts > 0]).sum() / pixels)
    square = rung.error**2
    if square == 0.0 and second > 0.0:
        return Verdict(False, np.inf, np.inf)
    if second == 0.0:  # a reference without noise
        return Verdict(True, 1.0, seconds)
    # The variance may grow by a factor u until the standard error of the squared error reaches 2 ACCURACY of it.
    wanted = pixels * (2 * ACCURACY * square) ** 2
    u = (np.sqrt((square * first) ** 2 + second * wanted) - square * first) / second
    more = 1.0 / u
    return Verdict(bool(more <= 1.0), float(max(more, 1.0)), float(max(more, 1.0) * seconds))
