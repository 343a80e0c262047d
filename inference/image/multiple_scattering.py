# SPDX-License-Identifier: GPL-3.0-or-later
"""Adds the predicted multiple scattering of each group of volumes and each sun, at the depth samples of camera rays."""

import functools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from ..marching.depth_samples import DepthSamples
from ..marching.extended_lights import EquivalentDirections
from ..network.albedos import Albedos
from ..network.predictor import POINTS_PER_TASK, Bounds, VolumePredictor
from ..network.prepared_predictors import LampLight, PreparedLampPredictor, PreparedPredictor
from ..network.uncertainty import UncertaintyNetwork
from ..plan.plan import Channels, last_albedo
from ..runtime.report import Report
from ..scene.camera import Camera
from ..scene.camera_rays import pixel_size
from ..transport.scattered_fluence import ScatteredFluence
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
from .context import ChannelPass, PreparedScene, RenderContext, Tile
from .framebuffer import add_at
from .lamp_pass import lamps_of_group
from .predicted_error import MODELS, SparseDeviation


def solve_transport(
    context: RenderContext, scene: PreparedScene, channels: Channels, suns: list[int]
) -> list[ScatteredFluence | None] | None:
    """Scattered fluence of each group in which multiple scattering is predicted, of some suns.

    None for networks that need no ray features, without suns and without multiple scattering. Raises Cancelled.
    """
    network = scene.network
    wanted = context.settings.multiple and scene.plan.suns
    if network is None or not network.needs_ray_features or not wanted:
        return None
    joined = scene.plan.predicted_suns(suns)
    directions = [one.sun.direction for one in joined]
    of_part = {part: number for number, one in enumerate(joined) for part in one.parts}
    found: list[ScatteredFluence | None] = [None] * len(scene.groups)
    with context.report.stage("fields"):
        for g, group in scene.predicted(channels):
            sigma_t = float(group.medium.sigma_t[channels.indices[0]])
            with context.progress.stage("transport", len(directions)):
                fluence = group.predictor.fluence(sigma_t, directions, scene.occluders, context.tasks)
            found[g] = fluence and fluence.of_parts([of_part[place] for place in range(len(suns))])
    return found


def prepare_prediction(
    context: RenderContext,
    scene: PreparedScene,
    channel_pass: ChannelPass,
    view: Sequence[DepthSamples],
) -> list["Source"]:
    """What predicts the multiple scattering of every group and sun of a pass, and every lamp. Raises Cancelled.

    view: depth samples of all tiles, where lookup lattices are to be built for these alone; empty for those that serve
    any view.
    """
    if not context.settings.multiple:
        return []
    plan, indices = scene.plan, channel_pass.channels.indices
    sources: list[Source] = []
    places = [channel_pass.scattering_place(c) if c in indices else 0 for c in range(3)]
    prepared: PreparedPredictor | PreparedLampPredictor
    for g, group in scene.predicted(channel_pass.channels):
        members, medium = plan.groups[g], group.medium
        sigma_t = float(medium.sigma_t[indices[0]])
        last = np.array([last_albedo(*plan.volumes[v]) for v in members])
        with context.report.stage("fields"):
            bounds = lattice_bounds(context, members, group.predictor, view)
            for one in plan.predicted_suns(channel_pass.suns):
                sun = one.sun
                if not plan.lights_group(sun, g):
                    continue
                with context.progress.stage("lattices", 1):
                    prepared = group.predictor.prepare(sigma_t, sun.direction, bounds, scene.occluders, context.tasks)
                context.report.count("cells of lookup fields", prepared.lattice_cells)
                context.cancel.check()
                source = Source(
                    group=g,
                    lights=one.parts,
                    shares=one.shares,
                    members=members,
                    indices=indices,
                    albedos=group.predictor.albedos(
                        medium,
                        sigma_t,
                        indices,
                        sun.direction,
                        scene.occluders,
                        context.tasks,
                        plan.optimizations,
                    ),
                    last_albedo=last,
                    scattered=(last * sun.irradiance).astype(np.float32),
                    places=places,
                    varies=group.volume.scattering is not None,
                    suns=len(plan.suns) + len(plan.lamps),
                    voxel=min(scene.grids[v].voxel for v in members),
                    prepared=prepared,
                    directions=EquivalentDirections(scene.camera, sun, medium.anisotropy, context.cancel),
                    uncertainty=scene.uncertainty_network,
                )
                sources.append(source)
            if not (channel_pass.lamps and plan.predicts_lamps):
                continue
            for cluster, lamp in zip(plan.lamp_clusters[g], lamps_of_group(scene, g)):
                if not plan.lights_group(plan.lamps[cluster[0]], g):
                    continue
                with context.progress.stage("lattices", 1):
                    albedos = group.predictor.albedos(
                        medium, sigma_t, indices, lamp, scene.occluders, context.tasks, plan.optimizations
                    )
                    light = LampLight(lamp, scene.lamp_radius, albedos.values)
                    prepared = group.predictor.prepare_lamp(sigma_t, light, bounds, scene.occluders, context.tasks)
                context.report.count("cells of lookup fields", prepared.lattice_cells)
                context.cancel.check()
                source = Source(
                    group=g,
                    lights=cluster,
                    shares=lamp.shares,
                    members=members,
                    indices=indices,
                    albedos=albedos,
                    last_albedo=last,
                    scattered=(last * lamp.power).astype(np.float32),
                    places=places,
                    varies=group.volume.scattering is not None,
                    suns=len(plan.suns) + len(plan.lamps),
                    voxel=min(scene.grids[v].voxel for v in members),
                    prepared=prepared,
                    uncertainty=scene.uncertainty_network,
                )
                sources.append(source)
    return sources


def add_multiple_scattering(
    context: RenderContext, sources: Sequence["Source"], tile: Tile, samples: DepthSamples
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


def lattice_bounds(
    context: RenderContext, members: list[int], predictor: VolumePredictor, view: Sequence[DepthSamples]
) -> Bounds:
    """Lowest and highest (3,), in the cube's frame, of the points for which lookup lattices are built."""
    if "unread_fields" not in context.settings.leave_out:
        return np.full(3, -0.5), np.full(3, 0.5)
    inside = [(samples, np.flatnonzero(samples.share(members))) for samples in view]
    bounds = [predictor.bounds(samples.positions(points)) for samples, points in inside if len(points)]
    if not bounds:
        return predictor.extent()
    return np.min([low for low, _ in bounds], axis=0), np.max([high for _, high in bounds], axis=0)


def sample_batches(points: np.ndarray) -> list[np.ndarray]:
    """Points in batches of one network call each."""
    return [points[i : i + POINTS_PER_TASK] for i in range(0, len(points), POINTS_PER_TASK)]


@dataclass(frozen=True)
class Source:
    """One group of volumes in the light of one sun, of one lamp or of several at once.

    group: its number. lights: places of the sun's parts, or of the lamps, among those that are rendered together.
    shares: float32 (n,), of the light of each, or at points (N, 3) as (N, n). members: numbers of the group's volumes.
    indices: colour channels that are rendered together. albedos: of these channels. last_albedo: float64 (V, 3), as of
    `plan.last_albedo`, of each of the group's volumes. scattered: float32 (V, 3), that times irradiance, or times the
    lamps' power. places: as for `DepthSamples.scattered`. varies: whether the albedo of any of the volumes does, or
    they differ. suns: how many suns and lamps there are altogether. voxel: shortest edge of the group's voxels.
    prepared: what predicts. directions: in which it sees camera rays; None for lamps. uncertainty: what tells the error
    of predictions, or None.
    """

    group: int
    lights: list[int]
    shares: np.ndarray | Callable[[np.ndarray], np.ndarray]
    members: list[int]
    indices: list[int]
    albedos: Albedos
    last_albedo: np.ndarray
    scattered: np.ndarray
    places: list[int]
    varies: bool
    suns: int
    voxel: float
    prepared: PreparedPredictor | PreparedLampPredictor
    directions: EquivalentDirections | None = None
    uncertainty: UncertaintyNetwork | None = None

    @property
    def needs_detail(self) -> bool:
        """Whether its light varies along rays more than nodes of the depth samples tell."""
        return isinstance(self.prepared, PreparedLampPredictor) and self.prepared.alone

    @functools.cached_property
    def alike(self) -> list[list[int]]:
        """Colour channels by number, those together that scatter the same light."""
        found: dict[tuple, list[int]] = {}
        for channels in self.albedos.channels:
            for c in channels:
                found.setdefault((channels[0], self.places[c], self.scattered[:, c].tobytes()), []).append(c)
        return list(found.values())


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
            radiance = source.prepared.predict(
                positions, directions, source.albedos.values, samples.jitter(done), self._features(done)
            )
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
        relative = source.prepared.deviation(
            source.uncertainty, positions, directions, predicted, samples.jitter(points), self._features(points)
        )[[list(predicted).index(albedo) for albedo in source.albedos.values]]
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
    estimate: Estimate, inside: np.ndarray, window: tuple[int, int, int, int], single: np.ndarray
) -> None:
    """Predict where neighbouring pixels disagree, and interpolate where they agree.

    inside: samples to predict at. window: of the P pixels. single: (C, P), single scattering of the sun.
    """
    # What is interpolated is the mean over the opacity, which is known in every pixel.
    opacity, guide = estimate.opacity()
    safe = np.where(opacity > 0.0, opacity, np.float32(1.0))
    # A pixel whose rays end at different surfaces differs from its neighbours.
    split = np.bincount(estimate.samples.pixel, minlength=len(safe)) > 1
    # Where the albedo varies, what is interpolated is the mean over what is scattered, so that colours stay sharp.
    scattered = estimate.scattered()
    shown = np.broadcast_to(opacity, estimate.radiance.shape) if scattered is None else scattered
    divisor = safe if scattered is None else np.where(scattered > 0.0, scattered, 1.0)
    mean, error = estimate.radiance / divisor, estimate.error / safe
    interpolation_error = np.zeros(len(safe), np.float32)
    evaluated, interpolated = np.zeros((2, len(safe)), bool)
    report = estimate.report
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

    voxel, shows = estimate.pixels_per_voxel(), opacity > 0.0
    for stride, least in LEVELS:
        difference = np.maximum(least, VOXEL_DIFFERENCE[stride] * voxel / stride)
        squares = Squares(window, stride).of(shows).without(interpolated)
        squares = squares.some(squares.centres(voxel) >= LEAST_VOXEL)
        evaluate(squares.known_pixels() & ~evaluated)
        # Errors are those of the mean over all three channels.
        smooth, centre_error = np.ones(squares.known.shape[1], bool), np.zeros(squares.known.shape[1])
        for part, weight in zip(estimate.smooth_parts(mean), shown):
            found, part_error = interpolable(
                squares,
                part,
                error * (3.0 / estimate.quantities),
                weight,
                single.mean(axis=0),
                guide,
                difference / np.sqrt(estimate.context.settings.depth_samples),
            )
            smooth, centre_error = smooth & found, np.maximum(centre_error, part_error)
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
    report.count("pixels that share their neighbours' multiple scattering", interpolated.sum())
