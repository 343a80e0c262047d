# SPDX-License-Identifier: GPL-3.0-or-later
"""Adds the light that each group of volumes scatters in each light, at the depth samples of camera rays."""

from collections.abc import Sequence

import numpy as np

from ..marching.depth_samples import DepthSamples
from .adaptive_evaluation import evaluate_adaptively
from .context import RenderContext, Tile
from .sources import Source
from .tile_estimate import TileEstimate

# Part of the light of earlier sources that masks what the interpolation of a source misses.
MASKING = 0.3


def add_scattered_light(
    context: RenderContext, sources: Sequence[Source], tile: Tile, samples: DepthSamples, moments: int = 1
) -> list[TileEstimate]:
    """Add the light of every source to the tile, and its uncertainty; moments: as of TileEstimate. Raises Cancelled."""
    estimates = []
    with tile.report.stage("network"):
        for source in sources:
            source = source.within(samples.volumes)
            if not source.members or not samples.meets(source.members):
                continue
            asked = samples if source.needs_detail else samples.nodes
            inside = np.flatnonzero(asked.share(source.members))
            if not len(inside):
                continue
            estimate = TileEstimate(context, asked, tile, source, moments)
            estimates.append(estimate)
            if source.estimator.answers:
                tile.report.count("network points wanted", len(inside))
            if "shared_pixels" in context.settings.optimizations:
                evaluate_adaptively(estimate, inside, _single(source, tile), _masking(source, tile))
            else:
                estimate.evaluate(inside)
            for row, radiance in zip(source.rows, estimate.radiance):
                if row.once:
                    tile.framebuffer.single[:, row.channels] += radiance[:, None]
                elif context.settings.multiple:
                    tile.framebuffer.multiple[:, row.channels] += radiance[:, None]
            tile.framebuffer.uncertainty += estimate.error
            tile.framebuffer.deviation += estimate.deviation()
    return estimates


def _single(source: Source, tile: Tile) -> np.ndarray:
    """Single scattering (C, P) of a source, about, where it tells how its light varies; else 0."""
    if not source.lights:
        return np.zeros((1, len(tile.framebuffer.alpha)))
    channels = sorted(c for row in source.rows for c in row.channels)
    return tile.framebuffer.single[:, channels].T / source.lights


def _masking(source: Source, tile: Tile) -> np.ndarray | None:
    """Light (P,), mean of its channels, that masks errors of a source; None where it is judged by its own."""
    if not source.masked:
        return None
    return MASKING * tile.framebuffer.multiple[:, sorted(c for row in source.rows for c in row.channels)].mean(axis=1)
