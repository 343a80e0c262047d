"""What a comparison renders, in which order, within its budget: decided from what is done so far."""

from dataclasses import dataclass
from typing import Dict, Optional, Tuple

from ...inference.evaluation.error_vs_time import cost
from ..cycles.pass_store import CYCLES, DENOISED, REFERENCE, Job, Pass

# Cycles' sample counts: each four times the last.
STEP = 4
# Samples a pixel in the reference's first passes; each half's next so many passes have STEP times as many, so that
# a reference of any size is a few dozen images, the first of them soon there.
PASS_SAMPLES, PASSES_A_SIZE = 16, 8


@dataclass
class Request:
    """What is wanted.

    layers: jobs of networks and baselines; the first is the image that is judged. samples: a pixel in each half
    of the reference, at most. largest: sample count of Cycles' highest rung, at most; 0 for no ladder.
    denoised: whether to render the ladder with denoising too. seconds: that Cycles may take in this run, 0 for any.
    given: whether the reference is there already.
    """

    layers: Tuple[Job, ...]
    samples: int = 32
    largest: int = 64
    denoised: bool = True
    seconds: float = 0.0
    given: bool = False


    def reference_jobs(self) -> list:
        """Passes of both halves: even seeds are one half, odd seeds the other.

        The same whatever their number, so that a larger reference continues a smaller one.
        """
        jobs, half = [], 0
        while half < self.samples and not self.given:
            size = min(PASS_SAMPLES * STEP ** (len(jobs) // (2 * PASSES_A_SIZE)), self.samples - half)
            jobs += [Job(REFERENCE, size, len(jobs) + number) for number in range(2)]
            half += size
        return jobs

    def ladder_jobs(self) -> list:
        """Cycles as candidate, cheapest first."""
        jobs, samples = [], 1
        while samples <= self.largest:
            jobs.append(Job(CYCLES, samples))
            if self.denoised:
                jobs.append(Job(DENOISED, samples))
            samples *= STEP
        return jobs

    def cycles_jobs(self) -> list:
        return [*self.reference_jobs(), *self.ladder_jobs()]


def next_job(request: Request, done: Dict[Job, Pass], failed=(), spent: float = 0.0) -> Optional[Job]:
    """The next image to make, None at the end.

    done, failed: jobs so far, whatever run made them. spent: seconds of Cycles in this run.

    Two passes of reference and the lowest rung are made whatever the budget, then the ladder within half of
    what is left, then the rest of the reference.
    """
    def missing(jobs):
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


def remaining_seconds(request: Request, done: Dict[Job, Pass], failed=(), spent: float = 0.0) -> float:
    """What Cycles will still take, as far as can be told."""
    missing = [job for job in request.cycles_jobs() if job not in done and job not in failed]
    start, each = _cost(done)
    expected = start * len(missing) + each * sum(job.samples for job in missing)
    return min(expected, max(request.seconds - spent, 0.0)) if request.seconds else expected


def expected_seconds(job: Job, done: Dict[Job, Pass]) -> float:
    """Of a Cycles job, from those that are done; 0 where there are none."""
    start, each = _cost(done)
    return start + each * job.samples


def _cost(done: Dict[Job, Pass]):
    known = [(job.samples, made.seconds) for job, made in done.items() if job.by_cycles]
    return cost(*zip(*known)) if known else (0.0, 0.0)
