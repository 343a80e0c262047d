# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates of a tile, evaluated where neighbouring pixels disagree and interpolated where they agree."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from ..marching.depth_samples import DepthSamples
from ..network.predictor import POINTS_PER_TASK
from ..runtime.report import Report
from ..scene.camera import Camera
from ..scene.camera_rays import pixel_size
from .adaptive_interpolation import (
    CENTRE_ERROR,
    DISTANCE_VOXELS,
    LEAST_VOXEL,
    LEVELS,
    VOXEL_DIFFERENCE,
    Guide,
    Squares,
    interpolable,
)
from .context import RenderContext

# Most times by which other light raises what is tolerated.
MOST_MASKED = 4.0


def sample_batches(points: np.ndarray) -> list[np.ndarray]:
    """Points in batches of one network call each."""
    return [points[i : i + POINTS_PER_TASK] for i in range(0, len(points), POINTS_PER_TASK)]


class Estimate(Protocol):
    """What `evaluate_adaptively` evaluates, over P pixels.

    radiance: float64 (C, P), of C different quantities. quantities: how many these stand for, alike ones included.
    error: float32 (P,), standard error of the sum of all of them, over 3. pixel: int (M,), of each sample. share: (M,),
    of the members in the extinction there.
    """

    context: RenderContext
    samples: DepthSamples
    report: Report
    camera: Camera
    share: np.ndarray
    pixel: np.ndarray
    radiance: np.ndarray
    quantities: int
    error: np.ndarray

    def evaluate(self, points: np.ndarray) -> None:
        """Predict at some samples and add their radiance."""

    def opacity(self) -> tuple[np.ndarray, Guide]:
        """Opacity float32 (P,), and what tells where light may vary between pixels."""

    def pixels_per_voxel(self) -> np.ndarray:
        """Width (P,) of the smallest voxels in pixels, where the light of each pixel is scattered; 0 if none is."""

    def scattered(self) -> np.ndarray | None:
        """What of the light that each pixel takes it scatters, (C, P); None where that is the same in all of them."""

    def smooth_parts(self, mean: np.ndarray) -> list[np.ndarray]:
        """What has to be smooth where pixels are interpolated, (P,) each; mean: (C, P), over the opacity, or over what
        pixels scatter."""


def scattered_shares(
    estimate: Estimate, members: Sequence[int], factors: np.ndarray, places: Sequence[int]
) -> np.ndarray:
    """What of the light that each pixel takes some volumes scatter, (C, P).

    members, factors, places: as for `DepthSamples.scattered`.
    """
    samples, pixels = estimate.samples, len(estimate.error)
    weight = samples.scattered(slice(None), members, factors, places)
    return np.stack([np.bincount(estimate.pixel, column, pixels) for column in weight.T])


def distance_guide(estimate: Estimate, opacity: np.ndarray, voxel: float) -> Guide:
    """The distance at which light scatters, as a mean over the opacity (P,), in voxels of an edge."""
    samples = estimate.samples
    moment = np.bincount(estimate.pixel, samples.weight * estimate.share * samples.distance, len(opacity))
    return Guide(moment / (np.maximum(opacity, np.float32(1e-30)) * voxel), np.full(len(opacity), DISTANCE_VOXELS))


def pixels_per_voxel(estimate: Estimate, voxel: float) -> np.ndarray:
    """Width (P,) of voxels of an edge in pixels, where the light of each pixel is scattered; 0 if none is."""
    samples = estimate.samples
    weight = samples.weight * estimate.share
    opacity, moment = (
        np.bincount(estimate.pixel, values, len(estimate.error)) for values in (weight, weight * samples.distance)
    )
    width = pixel_size(estimate.camera, moment / np.maximum(opacity, 1e-30))
    return np.where(opacity > 0.0, voxel / np.maximum(width, 1e-30), 0.0)


def evaluate_adaptively(
    estimate: Estimate,
    inside: np.ndarray,
    window: tuple[int, int, int, int],
    single: np.ndarray,
    masking: np.ndarray | None = None,
) -> None:
    """Predict where neighbouring pixels disagree, and interpolate where they agree.

    inside: samples to predict at. window: of the P pixels. single: (C, P), single scattering of the sun.
    masking: (P,), other light beside which errors are tolerated as beside its own, or None.
    """
    voxel = estimate.pixels_per_voxel()
    if voxel.max(initial=0.0) < LEAST_VOXEL:
        estimate.evaluate(inside)
        return
    # What is interpolated is the mean over the opacity, which is known in every pixel.
    opacity, guide = estimate.opacity()
    safe = np.where(opacity > 0.0, opacity, np.float32(1.0))
    # A pixel whose rays end at different surfaces differs from its neighbours.
    split = np.bincount(estimate.samples.pixel, minlength=len(safe)) > estimate.samples.rays
    # Where the albedo varies, what is interpolated is the mean over what is scattered, so that colours stay sharp.
    scattered = estimate.scattered()
    shown = np.broadcast_to(opacity, estimate.radiance.shape) if scattered is None else scattered
    divisor = safe if scattered is None else np.where(scattered > 0.0, scattered, 1.0)
    mean, error = estimate.radiance / divisor, estimate.error / safe
    interpolation_error = np.zeros(len(safe), np.float32)
    evaluated, interpolated = np.zeros((2, len(safe)), bool)
    report, settings = estimate.report, estimate.context.settings
    # Samples of a pixel follow each other.
    counts = np.bincount(estimate.pixel[inside], minlength=len(safe))
    starts, filled = np.cumsum(counts) - counts, counts > 0

    def evaluate(pixels: np.ndarray) -> None:
        evaluated[pixels] = True
        seen = np.flatnonzero(pixels & filled)
        some = counts[seen]
        first = np.repeat(starts[seen] - (np.cumsum(some) - some), some)
        estimate.evaluate(inside[first + np.arange(len(first))])
        mean[:, seen] = estimate.radiance.take(seen, axis=1) / divisor.take(seen, axis=-1)
        error[seen] = estimate.error[seen] / safe[seen]

    shows = opacity > 0.0
    # Pixels of several rays are joined afterwards, which divides their differences further.
    for stride, least in LEVELS:
        difference = settings.tolerance * np.maximum(least, VOXEL_DIFFERENCE[stride] * voxel / stride)
        squares = Squares(window, stride).of(shows).without(interpolated)
        squares = squares.some(squares.centres(voxel) >= LEAST_VOXEL)
        evaluate(squares.known_pixels() & ~evaluated)
        # Errors are those of the mean over all three channels.
        smooth, centre_error = np.ones(squares.known.shape[1], bool), np.zeros(squares.known.shape[1])
        for part, weight in zip(estimate.smooth_parts(mean), shown):
            tolerated = difference * np.sqrt(estimate.samples.rays / settings.depth_samples)
            if masking is not None:
                own = single.mean(axis=0) + part * weight
                tolerated = tolerated * np.minimum(1.0 + masking / np.maximum(own, 1e-30), MOST_MASKED)
            agreeing, part_error = interpolable(
                squares,
                part,
                error * (3.0 / estimate.quantities),
                weight,
                single.mean(axis=0),
                guide,
                tolerated,
            )
            smooth, centre_error = smooth & agreeing, np.maximum(centre_error, part_error)
        if split.any():
            smooth &= ~squares.any(split)
        interior = squares.interior(smooth) & ~evaluated & ~interpolated
        between, errors = squares.some(smooth), np.zeros_like(interpolation_error)
        for values in (*mean, error):
            between.fill(values, interior)
        errors[between.pixels] = centre_error[smooth]
        interpolation_error[interior] = errors[interior]
        interpolated |= interior
    evaluate(~(evaluated | interpolated))
    interpolated &= opacity > 0.0
    estimate.radiance[:, interpolated] = (mean * shown)[:, interpolated]
    total = error + CENTRE_ERROR * interpolation_error * (estimate.quantities / 3.0)
    estimate.error[interpolated] = (total * opacity)[interpolated]
    report.count("pixels that share their neighbors' multiple scattering", interpolated.sum())
