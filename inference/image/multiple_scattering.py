# SPDX-License-Identifier: GPL-3.0-or-later
"""Adds the predicted multiple scattering of each group of volumes and each sun, at the depth samples of camera rays."""

from collections.abc import Sequence

import numpy as np

from ..marching.depth_samples import DepthSamples
from ..network.predictor import POINTS_PER_TASK
from ..network.ray_points import RayPoints
from .adaptive_evaluation import (
    distance_guide,
    evaluate_adaptively,
    pixels_per_voxel,
    sample_batches,
    scattered_shares,
)
from .adaptive_interpolation import Guide
from .context import RenderContext, Tile
from .framebuffer import add_at
from .predicted_error import MODELS, SparseDeviation
from .prediction_sources import Source


def add_multiple_scattering(
    context: RenderContext, sources: Sequence[Source], tile: Tile, samples: DepthSamples
) -> None:
    """Add the predicted multiple scattering of every source to the tile, and its uncertainty. Raises Cancelled."""
    with tile.report.stage("network"):
        for source in sources:
            some = samples if source.needs_detail else samples.nodes
            inside = np.flatnonzero(some.share(source.members))
            if not len(inside):
                continue
            tile.report.count("network points wanted", len(inside))
            estimate = _Estimate(context, some, tile, source)
            if "shared_pixels" not in context.settings.leave_out:
                estimate.evaluate(inside)
            else:
                single = tile.framebuffer.single[:, source.indices].T / source.suns
                evaluate_adaptively(estimate, inside, tile.camera.window, single)
            for channels, radiance in zip(source.alike, estimate.radiance):
                tile.framebuffer.multiple[:, channels] += radiance[:, None]
            tile.framebuffer.uncertainty += estimate.error
            tile.framebuffer.deviation += estimate.network_error()


class _Estimate:
    """The network's estimate of one source's multiple scattering in a tile of P pixels.

    radiance: float64 (C, P), of the channels of `Source.alike`; in double precision it does not depend on how points
    are divided among calls. error: float32 (P,), its standard error, as a mean over all three channels.
    """

    def __init__(self, context: RenderContext, samples: DepthSamples, tile: Tile, source: Source):
        pixels = len(tile.framebuffer.alpha)
        self.context, self.samples, self.source, self.report = context, samples, source, tile.report
        self.camera = tile.camera
        self.share = samples.share(source.members)
        self.directions = samples.directions
        if source.directions is not None:
            self.directions = source.directions(tile.camera.window, samples.pixel, samples.directions)
        self.pixel = samples.pixel[samples.ray]
        self.radiance, self.quantities = np.zeros((len(source.alike), pixels)), len(source.indices)
        self.error = np.zeros(pixels, np.float32)
        self.deviation = SparseDeviation(tile.camera)
        # Samples whose error is to be told: numbers, radiance (A, N) and weight (N, C).
        self._told: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []

    def evaluate(self, points: np.ndarray) -> None:
        """Predict at some samples and add their radiance."""
        samples, source = self.samples, self.source
        # Contribution of each sample to the mean of the three channels.
        parts = np.zeros(len(self.pixel), np.float32)
        for done in sample_batches(points):
            self.context.cancel.check()
            positions, directions = samples.positions(done), self.directions[samples.ray[done]]
            asked = RayPoints(positions, directions, samples.jitter(done), self._features(done))
            radiance = source.prepared.predict(asked, source.albedos.values)
            weight = self._weight(done)
            pixel = self.pixel[done]
            mean, rows = np.zeros(len(done)), dict(source.albedos.by_channel(radiance, positions, directions))
            for number, channels in enumerate(source.alike):
                part = weight[:, number] * rows[channels[0]]
                add_at(self.radiance[number], pixel, part)
                mean += len(channels) * part
            parts[done] = mean / 3.0
            if source.uncertainty is not None:
                known = np.flatnonzero(self.deviation.known[pixel])
                self._told.append((done[known], radiance[:, known], weight[known]))
        if len(points):
            add_at(self.error, *samples.standard_error(parts, points))
        self.report.count("network points", len(points))
        self.report.count("network answers", len(points) * len(source.albedos.values))

    def _weight(self, points: np.ndarray) -> np.ndarray:
        """What of light at some samples arrives at the camera, (N, C)."""
        source, first = self.source, [channels[0] for channels in self.source.alike]
        places = [source.places[c] for c in first]
        return self.samples.scattered(points, source.members, source.scattered[:, first], places)

    def _add_deviations(self) -> None:
        """Tell the error of what was predicted, all at once."""
        points, radiance, weight = (
            np.concatenate(parts, axis=-1) for parts in zip(*((p, r, w.T) for p, r, w in self._told))
        )
        order = np.argsort(points)
        points, radiance, weight = points[order], radiance[:, order], weight.T[order]
        for start in range(0, len(points), POINTS_PER_TASK):
            some = slice(start, start + POINTS_PER_TASK)
            self._add_deviation(points[some], radiance[:, some], weight[some])

    def _add_deviation(self, points: np.ndarray, radiance: np.ndarray, weight: np.ndarray) -> None:
        """Tell the error of what was predicted at some samples: radiance (A, N), seen with weight (N, C)."""
        samples, source = self.samples, self.source
        assert source.uncertainty is not None
        positions, directions = samples.positions(points), self.directions[samples.ray[points]]
        # Several channels may have one albedo.
        predicted = dict(zip(source.albedos.values, radiance))
        asked = RayPoints(positions, directions, samples.jitter(points), self._features(points))
        found = source.prepared.deviation(source.uncertainty, asked, predicted)
        relative = found[[list(predicted).index(albedo) for albedo in source.albedos.values]]
        deviations = np.zeros(len(points))
        rows = dict(source.albedos.by_channel(relative * radiance, positions, directions))
        for number, channels in enumerate(source.alike):
            deviations += weight[:, number] * rows[channels[0]] * (len(channels) / 3.0)
        self.deviation.add(self.pixel[points], deviations)

    def network_error(self) -> np.ndarray:
        """Standard deviation float32 (P,) of the error of what predicts, mean over all three channels."""
        light, network = self._mean(self.radiance) * (self.quantities / 3.0), self.source.uncertainty
        if network is not None:
            if self._told:
                self._add_deviations()
            return self.deviation.everywhere(light, network.typical)
        return (MODELS.get(self.context.settings.model, 0.0) * light).astype(np.float32)

    def _features(self, points: np.ndarray | slice) -> np.ndarray | None:
        """Ray features of some samples, if the network needs them."""
        lamp = self.source.directions is None
        features = self.samples.lamp_features if lamp else self.samples.features
        source = self.source
        if features is None:
            return None
        if len(source.lights) == 1:
            return features.of(points, source.group, source.lights[0])
        shares = source.shares
        if not isinstance(shares, np.ndarray):
            shares = shares(self.samples.positions(points))
        return features.mean(points, source.group, source.lights, shares)

    def pixels_per_voxel(self) -> np.ndarray:
        """Width (P,) of the smallest voxels in pixels, where the light of each pixel is scattered; 0 if none is."""
        return pixels_per_voxel(self, self.source.voxel)

    def opacity(self) -> tuple[np.ndarray, Guide]:
        """Opacity float32 (P,) of the group alone; its guide is the mean over it of the scattered light ahead."""
        weight = self.samples.weight * self.share
        opacity = np.bincount(self.pixel, weight, len(self.error)).astype(np.float32)
        features = self._features(slice(None))
        if features is None:
            return opacity, distance_guide(self, opacity, self.source.voxel)
        ahead = np.bincount(self.pixel, weight * features[:, -1], len(opacity)) / np.maximum(opacity, np.float32(1e-30))
        return opacity, Guide(ahead, ahead)

    def scattered(self) -> np.ndarray | None:
        """What of the light that each pixel takes it scatters, (C, P); None where that is the same in all of them."""
        source = self.source
        if not source.varies:
            return None
        indices = [channels[0] for channels in source.alike]
        return scattered_shares(
            self, source.members, source.last_albedo[:, indices], [source.places[c] for c in indices]
        )

    def smooth_parts(self, mean: np.ndarray) -> list[np.ndarray]:
        """The mean of the channels, which one sun lights alike; mean: (C, P). Of a varying albedo, all of them."""
        return list(mean) if self.source.varies else [self._mean(mean)]

    def _mean(self, values: np.ndarray) -> np.ndarray:
        """Mean (P,) over the channels rendered together of values (C, P) of those that differ."""
        counts = [len(channels) / self.quantities for channels in self.source.alike]
        return sum(count * row for count, row in zip(counts, values))
