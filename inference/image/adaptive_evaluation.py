# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates of a tile, evaluated where neighbouring pixels disagree and interpolated where they agree."""

import numpy as np

from .adaptive_interpolation import CENTRE_ERROR, LEAST_VOXEL, LEVELS, VOXEL_DIFFERENCE, Squares, interpolable
from .tile_estimate import TileEstimate

# Most times by which other light raises what is tolerated.
MOST_MASKED = 4.0


def evaluate_adaptively(
    estimate: TileEstimate, inside: np.ndarray, single: np.ndarray, masking: np.ndarray | None
) -> None:
    """Predict where neighbouring pixels disagree, and interpolate where they agree.

    inside: samples to predict at. single: (C, P), single scattering of the sun. masking: (P,), other light beside which
    errors are tolerated as beside its own, or None. Raises Cancelled.
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
        squares = Squares(estimate.camera.window, stride).of(shows).without(interpolated)
        squares = squares.some(squares.centres(voxel) >= LEAST_VOXEL)
        evaluate(squares.known_pixels() & ~evaluated)
        # Errors are those of the mean over all three channels.
        smooth, centre_error = np.ones(squares.known.shape[1], bool), np.zeros(squares.known.shape[1])
        for part, weight in zip(estimate.source.combined(mean), shown):
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
