# SPDX-License-Identifier: GPL-3.0-or-later
"""Which image a comparison renders next, from those that are finished and its budget."""

from collections.abc import Collection, Iterable, Iterator
from dataclasses import dataclass

from ...evaluation.error_vs_time import cost
from ..cycles.choices import CHOICES, CYCLES, DENOISED, LADDERS, REFERENCE, USUAL
from ..cycles.pass_store import Job, Pass

# Ratio of successive sample counts of Cycles.
STEP = 4
# Samples per pixel in the reference's first passes; after so many passes of each half, they grow by STEP. A reference
# of any size is then a few dozen images, the first of them soon finished.
PASS_SAMPLES, PASSES_PER_SIZE = 16, 8


@dataclass
class Request:
    """What to render.

    layers: jobs of networks and baselines; the first is the judged image. samples: per pixel in each half of the
    reference, at most. largest: highest sample count of Cycles' ladders, at most; 0 for none. methods: of LADDERS,
    whose ladders are rendered. usual: jobs of Cycles as artists set it. seconds: limit for Cycles in this run, 0 for
    none. given: whether the reference exists already.
    """

    layers: tuple[Job, ...]
    samples: int = 32
    largest: int = 64
    methods: tuple[str, ...] = (CYCLES, DENOISED)
    usual: tuple[Job, ...] = ()
    seconds: float = 0.0
    given: bool = False

    def reference_jobs(self) -> list:
        """Passes of both halves: even seeds are one half, odd seeds the other.

        Independent of their number, so that a larger reference continues a smaller one.
        """
        jobs: list[Job] = []
        half = 0
        while half < self.samples and not self.given:
            size = min(PASS_SAMPLES * STEP ** (len(jobs) // (2 * PASSES_PER_SIZE)), self.samples - half)
            jobs += [Job(REFERENCE, size, len(jobs) + number) for number in range(2)]
            half += size
        return jobs

    def ladder_jobs(self) -> list:
        """Cycles as a candidate: ladders, cheapest first, then as artists set it."""
        jobs: list[Job] = []
        samples = 1
        while samples <= self.largest:
            jobs += [Job(method, samples) for method in self.methods]
            samples *= STEP
        return jobs + list(self.usual)

    def cycles_jobs(self) -> list:
        return [*self.reference_jobs(), *self.ladder_jobs()]


def next_job(request: Request, done: dict[Job, Pass], failed: Collection[Job] = (), spent: float = 0.0) -> Job | None:
    """The next image to render; None at the end.

    done, failed: jobs of this and earlier runs. spent: seconds of Cycles in this run.

    Two passes of the reference and the lowest rung are rendered whatever the budget, then the ladder within half of
    what is left, then the rest of the reference.
    """

    def missing(jobs: Iterable[Job]) -> Iterator[Job]:
        return (job for job in jobs if job not in done and job not in failed)

    for job in missing(request.layers):
        return job
    reference, ladder = request.reference_jobs(), request.ladder_jobs()
    for job in missing([*reference[:2], *(job for job in ladder if job.samples == 1)]):
        return job
    left = request.seconds - spent if request.seconds else float("inf")
    for job in missing(ladder):
        if expected_seconds(job, done) <= left / 2:
            return job
    for job in missing(reference):
        if expected_seconds(job, done) <= left:
            return job
    return None


def ladders(denoised: bool, null: bool) -> tuple[str, ...]:
    """The methods whose ladders are measured: with denoising, if wanted, and null scattering, if Cycles has it."""
    return tuple(name for name in LADDERS if CHOICES[name].denoised <= denoised and CHOICES[name].null <= null)


def usual_jobs(null: bool) -> tuple[Job, ...]:
    """Cycles as artists set it. null: whether Cycles has null scattering."""
    return tuple(Job(choice.name, samples) for choice, samples in USUAL if choice.null <= null)


def remaining_seconds(
    request: Request, done: dict[Job, Pass], failed: Collection[Job] = (), spent: float = 0.0
) -> float:
    """Estimated seconds that Cycles still takes."""
    missing = [job for job in request.cycles_jobs() if job not in done and job not in failed]
    expected = sum(expected_seconds(job, done) for job in missing)
    return min(expected, max(request.seconds - spent, 0.0)) if request.seconds else expected


def expected_seconds(job: Job, done: dict[Job, Pass]) -> float:
    """Estimated seconds of a Cycles job, from those that go the same way through volumes; 0 before the first."""
    null = CHOICES[job.method].null
    known = [
        (other.samples, made.seconds)
        for other, made in done.items()
        if other.by_cycles and CHOICES[other.method].null == null
    ]
    start, each = cost(*zip(*known)) if known else (0.0, 0.0)
    return start + each * job.samples
