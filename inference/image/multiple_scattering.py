# SPDX-License-Identifier: GPL-3.0-or-later
"""Adds the predicted multiple scattering of each group of volumes and each sun, at the depth samples of camera rays."""

from typing import Protocol

import numpy as np

from ..marching.depth_samples import DepthSamples
from ..marching.extended_lights import equivalent_directions
from ..network.predictor import POINTS_PER_TASK, Bounds, PreparedPredictor, VolumePredictor
from ..plan.plan import Channels, Plan, distinct_albedos
from ..render_cache import ScatteringGroup
from ..scene.description import Medium
from ..transport.scattered_fluence import ScatteredFluence
from .adaptive_interpolation import CENTRE_ERROR, LEVELS, Squares, interpolable
from .context import ChannelPass, PreparedScene, RenderContext, Tile
from .framebuffer import add_at
from .work_estimate import WorkEstimate


def solve_transport(
    context: RenderContext, scene: PreparedScene, channels: Channels
) -> list[ScatteredFluence | None] | None:
    """Scattered fluence of each group in which multiple scattering is predicted.

    None for networks that need no ray features, and without suns. Raises Cancelled.
    """
    network = scene.network
    if network is None or not network.needs_ray_features or not scene.plan.suns:
        return None
    directions = [sun.direction for sun in scene.plan.suns]
    found: list[ScatteredFluence | None] = [None] * len(scene.groups)
    with context.report.stage("fields"):
        for g, group in scene.predicted(channels):
            sigma_t = float(group.medium.sigma_t[channels.indices[0]])
            with context.progress.stage("transport", len(directions)):
                found[g] = group.predictor.fluence(sigma_t, directions, scene.occluders, context.tasks)
    return found


def add_multiple_scattering(
    context: RenderContext,
    scene: PreparedScene,
    channel_pass: ChannelPass,
    tile: Tile,
    samples: DepthSamples,
    work: WorkEstimate,
) -> None:
    """Add the predicted multiple scattering of every group and sun to the tile, and its uncertainty.

    work: is told of each prediction. Raises Cancelled.
    """
    for g, group in scene.predicted(channel_pass.channels):
        for l in range(len(scene.plan.suns)):
            source = _Source(scene.plan, g, l, channel_pass.channels.indices, group.medium)
            _add_source(context, scene, group, tile, samples, source)
            work.job_predicted(tile)


def _add_source(
    context: RenderContext,
    scene: PreparedScene,
    group: ScatteringGroup,
    tile: Tile,
    samples: DepthSamples,
    source: "_Source",
) -> None:
    """Add the multiple scattering of one group and one sun."""
    plan, report, indices = scene.plan, context.report, source.indices
    sun, members = plan.suns[source.sun], source.members
    inside = np.flatnonzero(samples.fraction[:, members].any(axis=1))
    if not len(inside):
        return
    context.progress.message(f"multiple scattering of {plan.group_name(source.group)}")
    with report.stage("fields"):
        bounds = lattice_bounds(context, scene, group.predictor, samples, inside)
        with context.progress.stage("lattices", 1):
            prepared = group.predictor.prepare(
                float(group.medium.sigma_t[indices[0]]), sun.direction, bounds, scene.occluders, context.tasks
            )
        report.count("cells of lookup fields", prepared.lattice_cells)
        context.cancel.check()
    report.count("network points wanted", len(inside))
    directions = samples.directions
    if sun.spread is not None:
        directions = equivalent_directions(tile.camera, samples.pixel, directions, sun, group.medium.anisotropy)
    estimate = _Estimate(context, samples, directions, tile, prepared, source)
    with report.stage("network"), context.progress.stage("network"):
        if "shared_pixels" not in context.settings.leave_out:
            estimate.evaluate(inside)
        else:
            single = tile.framebuffer.single[:, indices].T / len(plan.suns)
            evaluate_adaptively(estimate, inside, tile.camera.window, single)
    tile.framebuffer.multiple[:, indices] += estimate.radiance.T
    tile.framebuffer.uncertainty += estimate.error


def lattice_bounds(
    context: RenderContext, scene: PreparedScene, predictor: VolumePredictor, samples: DepthSamples, inside: np.ndarray
) -> Bounds:
    """Lowest and highest (3,), in the cube's frame, of the points for which lookup lattices are built."""
    if "unread_fields" not in context.settings.leave_out:
        return np.full(3, -0.5), np.full(3, 0.5)
    if context.cache.any_view or len(scene.plan.tiles) > 1:
        return predictor.extent()
    bounds = [predictor.bounds(samples.positions(points)) for points in sample_batches(inside)]
    return np.min([low for low, _ in bounds], axis=0), np.max([high for _, high in bounds], axis=0)


def sample_batches(points: np.ndarray) -> list[np.ndarray]:
    """Points in batches of one network call each."""
    return [points[i : i + POINTS_PER_TASK] for i in range(0, len(points), POINTS_PER_TASK)]


class _Source:
    """One group of volumes in the light of one sun.

    members: numbers of the group's volumes. indices: colour channels that are rendered together. albedos: distinct
    albedos of these channels, and the channels of each. scattered: float32 (V, 3), albedo times irradiance of each of
    the group's volumes.
    """

    def __init__(self, plan: Plan, g: int, l: int, indices: list[int], medium: Medium):
        self.group, self.sun, self.members, self.indices = g, l, plan.groups[g], indices
        self.albedos = distinct_albedos(medium, indices, plan.optimizations)
        irradiance = plan.suns[l].irradiance
        self.scattered = np.array([plan.volumes[v][1].albedo * irradiance for v in self.members], np.float32)


class Estimate(Protocol):
    """What `evaluate_adaptively` evaluates, over P pixels.

    radiance: float64 (C, P), of C quantities. error: float32 (P,), standard error of their sum, over 3. pixel: int
    (M,), of each sample.
    """

    context: RenderContext
    samples: DepthSamples
    pixel: np.ndarray
    radiance: np.ndarray
    error: np.ndarray

    def evaluate(self, points: np.ndarray) -> None:
        """Predict at some samples and add their radiance."""

    def opacity(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Opacity float32 (P,), and the mean over it of the scattered light ahead, (P,) or None."""

    def smooth_parts(self, mean: np.ndarray) -> list[np.ndarray]:
        """What has to be smooth where pixels are interpolated, (P,) each; mean: (C, P), over the opacity."""


class _Estimate:
    """The network's estimate of one group's multiple scattering of one sun, in P pixels.

    directions: (R, 3), in which the network sees the samples' rays. radiance: float64 (C, P), of the channels rendered
    together; in double precision it does not depend on how points are divided among calls. error: float32 (P,), its
    standard error, as a mean over all three channels.
    """

    def __init__(
        self,
        context: RenderContext,
        samples: DepthSamples,
        directions: np.ndarray,
        tile: Tile,
        prepared: PreparedPredictor,
        source: _Source,
    ):
        pixels = len(tile.framebuffer.alpha)
        self.context, self.samples, self.prepared, self.source = context, samples, prepared, source
        self.fraction = samples.fraction[:, source.members]
        self.directions = directions
        self.pixel = samples.pixel[samples.ray]
        self.radiance = np.zeros((len(source.indices), pixels))
        self.error = np.zeros(pixels, np.float32)

    def evaluate(self, points: np.ndarray) -> None:
        """Predict at some samples and add their radiance."""
        context, samples, source = self.context, self.samples, self.source
        values = [value for value, _ in source.albedos]
        # Contribution of each sample to the mean of the three channels.
        parts = np.zeros(len(self.pixel), np.float32)

        def task(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            directions = self.directions[samples.ray[points]]
            return points, self.prepared.predict(
                samples.positions(points), directions, values, samples.jitter(points), self._features(points)
            )

        for done, radiance in context.tasks.map(task, sample_batches(points)):
            weight = samples.weight[done, None] * (self.fraction[done] @ source.scattered)
            pixel = self.pixel[done]
            for (_, channels), row in zip(source.albedos, radiance):
                for c in channels:
                    part = weight[:, c] * row
                    add_at(self.radiance[source.indices.index(c)], pixel, part)
                    parts[done] += part / 3.0
            context.progress.advance("network", len(done))
        add_at(self.error, *samples.standard_error(parts))
        context.report.count("network points", len(points))
        context.report.count("network answers", len(points) * len(source.albedos))

    def _features(self, points: np.ndarray | slice) -> np.ndarray | None:
        """Ray features of some samples, if the network needs them."""
        features = self.samples.features
        return None if features is None else features.of(points, self.source.group, self.source.sun)

    def opacity(self) -> tuple[np.ndarray, np.ndarray | None]:
        """Opacity float32 (P,) of the group alone, and the mean over it of the scattered light ahead, (P,) or None."""
        weight = self.samples.weight * self.fraction.sum(axis=1)
        opacity = np.bincount(self.pixel, weight, len(self.error)).astype(np.float32)
        features = self._features(slice(None))
        if features is None:
            return opacity, None
        ahead = np.bincount(self.pixel, weight * features[:, -1], len(opacity))
        return opacity, ahead / np.maximum(opacity, np.float32(1e-30))

    def smooth_parts(self, mean: np.ndarray) -> list[np.ndarray]:
        """The mean of the channels, which one sun lights alike; mean: (C, P)."""
        return [mean.mean(axis=0)]


def evaluate_adaptively(
    estimate: Estimate, inside: np.ndarray, window: tuple[int, int, int, int], single: np.ndarray
) -> None:
    """Predict where neighbouring pixels disagree, and interpolate where they agree.

    inside: samples to predict at. window: of the P pixels. single: (C, P), single scattering of the sun.
    """
    # What is interpolated is the mean over the opacity, which is known in every pixel.
    opacity, ahead = estimate.opacity()
    safe = np.where(opacity > 0.0, opacity, np.float32(1.0))
    # A pixel whose rays end at different surfaces differs from its neighbours.
    split = np.bincount(estimate.samples.pixel, minlength=len(safe)) > 1
    mean, error, interpolation_error = estimate.radiance / safe, estimate.error / safe, np.zeros(len(safe), np.float32)
    evaluated, interpolated = np.zeros((2, len(safe)), bool)
    pixel, report = estimate.pixel[inside], estimate.context.report

    def evaluate(pixels: np.ndarray) -> None:
        estimate.evaluate(inside[pixels[pixel]])
        evaluated[pixels] = True
        mean[:, pixels] = estimate.radiance[:, pixels] / safe[pixels]
        error[pixels] = estimate.error[pixels] / safe[pixels]

    for stride, difference in LEVELS:
        squares = Squares(window, stride).without(interpolated)
        evaluate(squares.known_pixels() & ~evaluated)
        # Errors are those of the mean over all three channels.
        smooth, centre_error = np.ones(len(squares.pixels), bool), np.zeros(len(squares.pixels))
        for part in estimate.smooth_parts(mean):
            found, part_error = interpolable(
                squares,
                part,
                error * (3.0 / len(mean)),
                opacity,
                single.mean(axis=0),
                ahead,
                difference / np.sqrt(estimate.context.settings.depth_samples),
            )
            smooth, centre_error = smooth & found, np.maximum(centre_error, part_error)
        smooth &= ~squares.any(split)
        interior = squares.interior(smooth) & ~evaluated & ~interpolated
        for values in (*mean, error):
            squares.fill(values, smooth, interior)
        errors = np.zeros_like(interpolation_error)
        errors[squares.pixels[smooth]] = centre_error[smooth, None]
        interpolation_error[interior] = errors[interior]
        interpolated |= interior
    evaluate(~(evaluated | interpolated))
    interpolated &= opacity > 0.0
    estimate.radiance[:, interpolated] = (mean * opacity)[:, interpolated]
    total = error + CENTRE_ERROR * interpolation_error * (len(mean) / 3.0)
    estimate.error[interpolated] = (total * opacity)[interpolated]
    report.count("pixels that share their neighbours' multiple scattering", interpolated.sum())
