# SPDX-License-Identifier: GPL-3.0-or-later
"""Adds the light of environments that volumes scatter, at the depth samples of camera rays."""

import numpy as np

from ..marching.depth_samples import DepthSamples
from ..network.predictor import EnvironmentPredictor
from ..plan.plan import Plan, distinct_albedos
from ..render_cache import ScatteringGroup
from ..scene.description import Medium
from .context import ChannelPass, PreparedScene, RenderContext, Tile
from .framebuffer import add_at
from .multiple_scattering import evaluate_adaptively, lattice_bounds, sample_batches
from .work_estimate import WorkEstimate


def add_environment_light(
    context: RenderContext,
    scene: PreparedScene,
    channel_pass: ChannelPass,
    tile: Tile,
    samples: DepthSamples,
    work: WorkEstimate,
) -> None:
    """Add single and multiple scattering of the plan's environments to the tile.

    work: is told of each prediction. Raises Cancelled.
    """
    if scene.environment_network is None:
        return
    for g, group in scene.predicted(channel_pass.channels):
        _add_group(context, scene, group, tile, samples, g, channel_pass.channels.indices)
        work.job_predicted(tile)


def _add_group(
    context: RenderContext,
    scene: PreparedScene,
    group: ScatteringGroup,
    tile: Tile,
    samples: DepthSamples,
    g: int,
    indices: list[int],
) -> None:
    plan, report = scene.plan, context.report
    inside = np.flatnonzero(samples.fraction[:, plan.groups[g]].any(axis=1))
    if not len(inside):
        return
    context.progress.message(f"light from everywhere in {plan.group_name(g)}")
    with report.stage("fields"):
        assert scene.environment_network is not None
        bounds = lattice_bounds(context, scene, group.predictor, samples, inside)
        sigma_t = float(group.medium.sigma_t[indices[0]])
        predictor = group.predictor.prepare_environment(
            scene.environment_network, plan.environments, sigma_t, bounds, context.tasks
        )
        context.cancel.check()
    report.count("network points wanted", len(inside))
    members, medium = plan.groups[g], group.medium
    estimate = _EnvironmentEstimate(context, plan, samples, tile, predictor, members, medium, indices)
    with report.stage("network"), context.progress.stage("network"):
        if "shared_pixels" not in context.settings.leave_out:
            estimate.evaluate(inside)
        else:
            evaluate_adaptively(estimate, inside, tile.camera.window, np.zeros((1, len(estimate.error))))
    count = len(indices)
    tile.framebuffer.single[:, indices] += estimate.radiance[:count].T
    if context.settings.multiple:
        tile.framebuffer.multiple[:, indices] += estimate.radiance[count:].T
    tile.framebuffer.uncertainty += estimate.error


class _EnvironmentEstimate:
    """The network's estimate of the light of environments that one group scatters; an `Estimate`.

    radiance: float64 (2 C, P), single scattering of the C channels rendered together, then multiple scattering.
    """

    def __init__(
        self,
        context: RenderContext,
        plan: Plan,
        samples: DepthSamples,
        tile: Tile,
        predictor: EnvironmentPredictor,
        members: list[int],
        medium: Medium,
        indices: list[int],
    ):
        self.context, self.samples, self.predictor, self.indices = context, samples, predictor, indices
        self.fraction = samples.fraction[:, members]
        self.albedos = distinct_albedos(medium, indices, plan.optimizations)
        # Of the last scattering, in each volume.
        self.last_albedo = np.array([plan.volumes[v][1].albedo[indices] for v in members], np.float32)
        self.pixel = samples.pixel[samples.ray]
        self.radiance = np.zeros((2 * len(indices), len(tile.framebuffer.alpha)))
        self.error = np.zeros(self.radiance.shape[1], np.float32)
        behind, whole = samples.optical_depths()
        self.along = np.stack([np.maximum(whole - behind, 0.0), behind], axis=1).astype(np.float32)

    def evaluate(self, points: np.ndarray) -> None:
        """Predict at some samples and add their radiance."""
        context, samples, predictor, indices = self.context, self.samples, self.predictor, self.indices
        values = [value for value, _ in self.albedos]
        # Contribution of each sample to the mean of the three channels.
        parts = np.zeros(len(self.pixel), np.float32)

        def task(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            directions = samples.directions[samples.ray[points]]
            return points, predictor.predict(
                samples.positions(points), directions, self.along[points], values, samples.jitter(points)
            )

        for done, radiance in context.tasks.map(task, sample_batches(points)):
            weight = samples.weight[done, None] * (self.fraction[done] @ self.last_albedo)
            pixel = self.pixel[done]
            for row, (_, channels) in zip(radiance[1:], self.albedos):
                for c in channels:
                    number, colour = indices.index(c), c if predictor.channels > 1 else 0
                    single, multiple = weight[:, number] * radiance[0, :, colour], weight[:, number] * row[:, colour]
                    add_at(self.radiance[number], pixel, single)
                    add_at(self.radiance[len(indices) + number], pixel, multiple)
                    parts[done] += (single + multiple) / 3.0
            context.progress.advance("network", len(done))
        add_at(self.error, *samples.standard_error(parts))
        context.report.count("network points", len(points))
        context.report.count("network answers", len(points) * len(self.albedos))

    def opacity(self) -> tuple[np.ndarray, None]:
        """Opacity float32 (P,) of the group alone; the scattered light ahead is not known."""
        weight = self.samples.weight * self.fraction.sum(axis=1)
        return np.bincount(self.pixel, weight, len(self.error)).astype(np.float32), None

    def smooth_parts(self, mean: np.ndarray) -> list[np.ndarray]:
        """Half the light of each channel, since colours come from different directions; mean: (2 C, P)."""
        channels = mean.reshape(2, -1, mean.shape[1]).mean(axis=0)
        return list(channels) if self.predictor.channels > 1 else [channels.mean(axis=0)]
