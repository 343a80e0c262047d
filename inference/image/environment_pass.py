# SPDX-License-Identifier: GPL-3.0-or-later
"""Adds the light of environments that volumes scatter, at the depth samples of camera rays."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..marching.depth_samples import DepthSamples
from ..network.albedos import Albedos
from ..network.prepared_predictors import EnvironmentPredictor
from ..network.ray_points import RayPoints
from ..plan.plan import last_albedo
from .adaptive_evaluation import (
    distance_guide,
    evaluate_adaptively,
    pixels_per_voxel,
    sample_batches,
    scattered_shares,
)
from .adaptive_interpolation import Guide
from .context import ChannelPass, PreparedScene, RenderContext, Tile
from .framebuffer import add_at
from .predicted_error import environment_deviation
from .prediction_sources import lattice_bounds


@dataclass(frozen=True)
class EnvironmentSource:
    """One group of volumes in the light of the plan's environments.

    members: numbers of the group's volumes. indices: colour channels that are rendered together. albedos: of these
    channels. last_albedo: float32 (V, C), as of `plan.last_albedo`, in each of the group's volumes. places: as for
    `DepthSamples.scattered`. varies: whether the albedo of any of the volumes does, or they differ. voxel: shortest
    edge of the group's voxels. correction: (C,), factor of the predicted light.
    """

    members: list[int]
    indices: list[int]
    albedos: Albedos
    last_albedo: np.ndarray
    places: list[int]
    varies: bool
    voxel: float
    predictor: EnvironmentPredictor
    correction: np.ndarray


def prepare_environment(
    context: RenderContext, scene: PreparedScene, channel_pass: ChannelPass, view: Sequence[DepthSamples]
) -> list[EnvironmentSource]:
    """What predicts the light of environments in every group of a pass. Raises Cancelled.

    view: as for `prepare_prediction`.
    """
    plan, sources, indices = scene.plan, [], channel_pass.channels.indices
    if scene.environment_network is None or not channel_pass.first:
        return []
    for g, group in scene.predicted(channel_pass.channels):
        members = plan.groups[g]
        context.progress.message(f"light from everywhere in {plan.group_name(g)}")
        with context.report.stage("fields"):
            # The light of surfaces begins at them: what they hide neither dims nor scatters it.
            opened = (scene.open_groups[g] if scene.open_groups else None) or group
            bounds = lattice_bounds(context, members, opened.predictor, view)
            sigma_t = float(group.medium.sigma_t[indices[0]])
            predictor = opened.predictor.prepare_environment(
                scene.environment_network, plan.environments, sigma_t, bounds, context.tasks
            )
            context.cancel.check()
        source = EnvironmentSource(
            members=members,
            indices=indices,
            albedos=opened.predictor.albedos(
                group.medium,
                sigma_t,
                indices,
                plan.environments,
                tasks=context.tasks,
                optimizations=plan.optimizations,
            ),
            last_albedo=np.array([last_albedo(*plan.volumes[v])[indices] for v in members], np.float32),
            places=[channel_pass.scattering_place(c) for c in indices],
            varies=group.volume.scattering is not None,
            voxel=min(scene.grids[v].voxel for v in members),
            predictor=predictor,
            correction=np.ones(len(indices)),
        )
        sources.append(source)
    return sources


def add_environment_light(
    context: RenderContext, sources: Sequence[EnvironmentSource], tile: Tile, samples: DepthSamples
) -> None:
    """Add single and multiple scattering of the plan's environments to the tile. Raises Cancelled."""
    with tile.report.stage("network"):
        for source in sources:
            inside = np.flatnonzero(samples.share(source.members))
            if not len(inside):
                continue
            tile.report.count("network points wanted", len(inside))
            estimate = EnvironmentEstimate(context, samples, tile, source)
            if "shared_pixels" not in context.settings.leave_out:
                estimate.evaluate(inside)
            else:
                evaluate_adaptively(estimate, inside, tile.camera.window, np.zeros((1, len(estimate.error))))
            count = len(source.indices)
            both = estimate.radiance.reshape(2, count, -1).sum(axis=0)
            # Of varying albedos the mean over the volumes tells what share of the light is left.
            relative = environment_deviation(source.last_albedo.mean(axis=0))
            deviation = np.einsum("c,cp->p", relative, both) / 3.0
            tile.framebuffer.deviation += deviation.astype(np.float32)
            tile.framebuffer.single[:, source.indices] += estimate.radiance[:count].T
            if context.settings.multiple:
                tile.framebuffer.multiple[:, source.indices] += estimate.radiance[count:].T
            tile.framebuffer.uncertainty += estimate.error


class EnvironmentEstimate:
    """The network's estimate of the light of environments that one group scatters; an `Estimate`.

    radiance: float64 (2 C, P), single scattering of the C channels rendered together, then multiple scattering.
    """

    def __init__(self, context: RenderContext, samples: DepthSamples, tile: Tile, source: EnvironmentSource):
        self.context, self.samples, self.source, self.report = context, samples, source, tile.report
        self.camera = tile.camera
        self.share = samples.share(source.members)
        self.pixel = samples.pixel[samples.ray]
        self.radiance = np.zeros((2 * len(source.indices), len(tile.framebuffer.alpha)))
        self.quantities = len(self.radiance)
        self.error = np.zeros(self.radiance.shape[1], np.float32)
        behind, whole = samples.optical_depths()
        self.along = np.stack([np.maximum(whole - behind, 0.0), behind], axis=1).astype(np.float32)

    def evaluate(self, points: np.ndarray) -> None:
        """Predict at some samples and add their radiance."""
        samples, source, indices = self.samples, self.source, self.source.indices
        # Contribution of each sample to the mean of the three channels.
        parts = np.zeros(len(self.pixel), np.float32)
        for done in sample_batches(points):
            self.context.cancel.check()
            directions = samples.directions[samples.ray[done]]
            asked = RayPoints(samples.positions(done), directions, samples.jitter(done))
            radiance = source.predictor.predict(asked, self.along[done], source.albedos.values)
            weight = samples.scattered(done, source.members, source.last_albedo, source.places) * source.correction
            pixel = self.pixel[done]
            for c, row in source.albedos.by_channel(radiance[1:], samples.positions(done), directions):
                number, colour = indices.index(c), c if source.predictor.channels > 1 else 0
                single, multiple = weight[:, number] * radiance[0, :, colour], weight[:, number] * row[:, colour]
                add_at(self.radiance[number], pixel, single)
                add_at(self.radiance[len(indices) + number], pixel, multiple)
                parts[done] += (single + multiple) / 3.0
        if len(points):
            add_at(self.error, *samples.standard_error(parts, points))
        self.report.count("network points", len(points))
        self.report.count("network answers", len(points) * len(source.albedos.values))

    def opacity(self) -> tuple[np.ndarray, Guide]:
        """Opacity float32 (P,) of the group alone; its guide is the distance, as scattered light ahead is not known."""
        weight = self.samples.weight * self.share
        opacity = np.bincount(self.pixel, weight, len(self.error)).astype(np.float32)
        return opacity, distance_guide(self, opacity, self.source.voxel)

    def pixels_per_voxel(self) -> np.ndarray:
        """Width (P,) of the smallest voxels in pixels, where the light of each pixel is scattered; 0 if none is."""
        return pixels_per_voxel(self, self.source.voxel)

    def scattered(self) -> np.ndarray | None:
        """What of the light that each pixel takes it scatters, (2 C, P); None where that is the same in all of them."""
        source = self.source
        if not source.varies:
            return None
        return np.tile(scattered_shares(self, source.members, source.last_albedo, source.places), (2, 1))

    def smooth_parts(self, mean: np.ndarray) -> list[np.ndarray]:
        """Half the light of each channel, since colours come from different directions; mean: (2 C, P)."""
        channels = mean.reshape(2, -1, mean.shape[1]).mean(axis=0)
        coloured = self.source.varies or self.source.predictor.channels > 1
        return list(channels) if coloured else [channels.mean(axis=0)]
