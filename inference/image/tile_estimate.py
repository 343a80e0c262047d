# SPDX-License-Identifier: GPL-3.0-or-later
"""The light of one source in one tile, as it is predicted at depth samples."""

import numpy as np

from ..marching.depth_samples import DepthSamples
from ..network.estimators import LitPoints
from ..network.predictor import POINTS_PER_TASK
from ..scene.camera_rays import pixel_size, places_in_image
from .adaptive_interpolation import DISTANCE_VOXELS, Guide
from .context import RenderContext, Tile
from .framebuffer import add_at
from .predicted_error import SparseDeviation
from .sources import Source

# Samples between two questions whether to stop: a fiftieth of a second.
SAMPLES_PER_CHECK = 1 << 17


class TileEstimate:
    """The light of one source in a tile of P pixels.

    radiance: float64 (D K, P), of the source's K rows; in double precision it does not depend on how points are divided
    among calls. Behind the first K are higher moments of it in the volumes' opacity along the ray: means with Legendre
    polynomials, 1 as at the end of the ray. error: float32 (P,), its standard error, as a mean over all three channels.
    quantities: how many the rows stand for, alike ones included. pixel: int (M,), of each sample. share: (M,), of the
    members in the extinction there.
    """

    def __init__(self, context: RenderContext, samples: DepthSamples, tile: Tile, source: Source, moments: int = 1):
        """moments: D, of the radiance."""
        pixels = len(tile.framebuffer.alpha)
        self.context, self.samples, self.source, self.report = context, samples, source, tile.report
        self.camera, self.blurred = tile.camera, samples.rays > 1
        self.share = samples.share(source.members)
        self.pixel = samples.pixel[samples.ray]
        self.radiance, self.quantities = np.zeros((moments * len(source.rows), pixels)), source.channels
        self._moments = samples.legendre_means(self.share, moments) if moments > 1 else np.ones((1, 1))
        self.error = np.zeros(pixels, np.float32)
        self._sparse = None if source.estimator.uncertainty is None else SparseDeviation(tile.camera)
        # Which of several groups each sample is in, in turn where these overlap; None for the only one.
        self._turns: list[np.ndarray | None] = [None]
        if source.frames is not None:
            self._turns = [*samples.turns(source.members)]
            self._members, self._groups = np.array(source.members), np.array(source.groups)
        # Samples whose error is to be told: numbers and what was predicted, (A, N, ...), by turn.
        self._told: list[list[tuple[np.ndarray, np.ndarray]]] = [[] for _ in self._turns]
        self._depths: np.ndarray | None = None
        if source.estimator.needs_depths:
            behind, whole = samples.optical_depths()
            self._depths = np.stack([np.maximum(whole - behind, 0.0), behind], axis=1).astype(np.float32)

    def evaluate(self, points: np.ndarray) -> None:
        """Predict at some samples and add their radiance."""
        source, estimator = self.source, self.source.estimator
        # Contribution of each sample to the mean of the three channels.
        parts = np.zeros(len(self.pixel), np.float32)
        for turn, told_of_turn in zip(self._turns, self._told):
            within, asked_at = points if turn is None else points[turn[points] >= 0], 0
            for done in self._batches(within):
                self.context.cancel.check()
                (asked, of), pixel = self._asked_together(done, turn), self.pixel[done]
                predicted, asked_at = estimator.predict(asked), asked_at + len(asked)
                weight, mean, told = self._weight(done, turn), np.zeros(len(done)), estimator.radiance(predicted, asked)
                for number, row in enumerate(source.rows):
                    if row.quantity in told:
                        added = weight[:, number] * told[row.quantity][of]
                        add_at(self.radiance[number], pixel, added)
                        for degree, mean_there in enumerate(self._moments[1:], 1):
                            add_at(self.radiance[degree * len(source.rows) + number], pixel, added * mean_there[done])
                        mean += len(row.channels) * added
                parts[done] += mean / 3.0
                if self._sparse is not None:
                    known = np.flatnonzero(self._sparse.known[pixel])
                    told_of_turn.append((done[known], predicted[:, of][:, known]))
            if estimator.answers:
                self.report.count("network points", asked_at)
                self.report.count("network answers", asked_at * estimator.answers)
        if len(points):
            add_at(self.error, *self.samples.standard_error(parts, points))

    def _batches(self, points: np.ndarray) -> list[np.ndarray]:
        """Some samples in batches of about one network call each, of whole rays where these are asked once."""
        if not self.source.once_per_ray:
            return [points[i : i + POINTS_PER_TASK] for i in range(0, len(points), POINTS_PER_TASK)]
        starts = np.flatnonzero(np.diff(self.samples.sampled[points], prepend=-1))
        return np.split(points, starts[POINTS_PER_TASK::POINTS_PER_TASK]) if len(points) else []

    def _asked_together(self, points: np.ndarray, turn: np.ndarray | None) -> tuple[LitPoints, np.ndarray | slice]:
        """Some samples as an estimator is asked at them, and of which answer each takes its light."""
        asked = self._asked(points, turn)
        if not self.source.once_per_ray:
            return asked, slice(None)
        ray = self.samples.sampled[points].astype(np.int64)
        own = ray if turn is None else ray * len(self.source.groups) + turn[points]
        of = np.unique(own, return_inverse=True)[1]
        return asked.joined(of, self.samples.weight[points] * self.share[points]), of

    def _weight(self, points: np.ndarray, turn: np.ndarray | None) -> np.ndarray:
        """What of light at some samples arrives at the camera, (N, K)."""
        source = self.source
        if turn is None:
            return self.samples.scattered(points, source.members, source.scattered, source.places)
        group = turn[points]
        return self.samples.scattered_by(points, self._members[group], source.scattered[group], source.places)

    def _asked(self, points: np.ndarray | slice, turn: np.ndarray | None) -> LitPoints:
        """Some samples, as an estimator is asked at them."""
        samples, numbers, groups = self.samples, points, np.array(self.source.groups[0])
        member = self.source.members[0] if turn is None else self._members[np.maximum(turn[points], 0)]
        positions, directions = samples.seen(points, member)
        if turn is not None:
            assert self.source.frames is not None
            numbers = np.arange(len(turn))[points]
            # Where no group is, anything is told.
            group = np.maximum(turn[points], 0)
            frame, groups = self.source.frames[group], self._groups[group]
            positions = frame[:, :1] * positions + frame[:, 1:]
        return LitPoints(
            positions=positions,
            directions=directions,
            jitter=None if isinstance(points, slice) else samples.jitter(points),
            numbers=numbers,
            group=samples.column_of_group(points, groups),
            suns=samples.features,
            lamps=samples.lamp_features,
            depths=self._depths,
            image=places_in_image(self.camera, self.pixel[points], directions, self.blurred),
        )

    def deviation(self) -> np.ndarray:
        """Standard deviation float32 (P,) of the error of what predicts, mean over all three channels."""
        source, network = self.source, self.source.estimator.uncertainty
        if network is None or self._sparse is None:
            relative = np.array([row.relative * len(row.channels) / 3.0 for row in source.rows])
            return np.einsum("k,kp->p", relative, self.radiance[: len(relative)]).astype(np.float32)
        for turn, told in zip(self._turns, self._told):
            if not told:
                continue
            points, predicted = (np.concatenate(parts, axis=-1) for parts in zip(*told))
            order = np.argsort(points)
            points, predicted = points[order], predicted[:, order]
            for start in range(0, len(points), POINTS_PER_TASK):
                span = slice(start, start + POINTS_PER_TASK)
                self._add_deviation(self._sparse, points[span], turn, predicted[:, span])
        light = source.mean(self.radiance) * (source.channels / 3.0)
        return self._sparse.everywhere(light, network.typical)

    def _add_deviation(
        self, sparse: SparseDeviation, points: np.ndarray, turn: np.ndarray | None, predicted: np.ndarray
    ) -> None:
        """Tell the error of what was predicted at some samples, (A, N, ...)."""
        source, asked, weight = self.source, self._asked(points, turn), self._weight(points, turn)
        told = source.estimator.radiance(source.estimator.deviation(predicted, asked), asked)
        deviations = np.zeros(len(points))
        for number, row in enumerate(source.rows):
            deviations += weight[:, number] * told[row.quantity] * (len(row.channels) / 3.0)
        sparse.add(self.pixel[points], deviations)

    def pixels_per_voxel(self) -> np.ndarray:
        """Width (P,) of the smallest voxels in pixels, where the light of each pixel is scattered; 0 if none is."""
        weight = self.samples.weight * self.share
        opacity, moment = (
            np.bincount(self.pixel, values, len(self.error)) for values in (weight, weight * self.samples.distance)
        )
        width = pixel_size(self.camera, moment / np.maximum(opacity, 1e-30))
        return np.where(opacity > 0.0, self.source.voxel / np.maximum(width, 1e-30), 0.0)

    def opacity(self) -> tuple[np.ndarray, Guide]:
        """Opacity float32 (P,) of the members alone, and what tells where light may vary between pixels: the mean over
        it of the scattered light ahead, or else of the distance in voxels."""
        weight = self.samples.weight * self.share
        opacity = np.bincount(self.pixel, weight, len(self.error)).astype(np.float32)
        safe, light = np.maximum(opacity, np.float32(1e-30)), self._light_ahead()
        if light is None:
            moment = np.bincount(self.pixel, weight * self.samples.distance, len(opacity))
            return opacity, Guide(moment / (safe * self.source.voxel), np.full(len(opacity), DISTANCE_VOXELS))
        ahead = np.bincount(self.pixel, weight * light, len(opacity)) / safe
        return opacity, Guide(ahead, ahead)

    def _light_ahead(self) -> np.ndarray | None:
        """As of the estimator, at all samples. Raises Cancelled."""
        ahead = []
        for start in range(0, len(self.pixel), SAMPLES_PER_CHECK):
            self.context.cancel.check()
            light = self.source.estimator.light_ahead(
                self._asked(slice(start, start + SAMPLES_PER_CHECK), self._turns[0])
            )
            if light is None:
                return None
            ahead.append(light)
        return np.concatenate(ahead)

    def scattered(self) -> np.ndarray | None:
        """What of the light that each pixel takes it scatters, (K, P); None where that is the same in all of them."""
        source = self.source
        if not source.varies:
            return None
        weight = self.samples.scattered(slice(None), source.members, source.albedos, source.places)
        shares = np.stack([np.bincount(self.pixel, column, len(self.error)) for column in weight.T])
        return np.tile(shares, (len(self._moments), 1))
