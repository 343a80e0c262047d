# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of lamps along camera rays, many rays at a time."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import DTypeLike

from inference.grids.bound_medium import BoundMedium
from inference.grids.lamp_optical_depth import LampOpticalDepth
from inference.marching.lamp_in_media import LEAST_FACING, LampInMedia, softened
from inference.marching.mean_lamp_depth import MeanLampDepth
from inference.marching.ray_features import MAX_TAU_SUN, RayFeatures
from inference.marching.ray_march import (
    BRIEF,
    DARK,
    FEW,
    MANY,
    WIDE,
    LampMarch,
    LampSegment,
    MarchOptions,
    optical_depth_behind,
)
from inference.marching.ray_steps import STEPS, RayBatch
from inference.numerics.quadrature import legendre_nodes
from inference.occluders.lamp_shadow_map import LampShadowMap
from inference.scene.emitters import Emitter

from .march import MarchedMedium, block_sums, group_sums, mean_transmittance, reduced_fractions, scattered_source
from .ray_features import SampleSteps, gather_ray_features
from .ray_steps import Cutting, mean_visibility


def light_directions(emitter: Emitter, points: np.ndarray) -> np.ndarray:
    """Unit vectors (N, 3) along which its light arrives at points (N, 3): within a cone, also close to a disk."""
    away = points - emitter.position
    away /= np.maximum(np.linalg.norm(away, axis=1), 1e-30)[:, None]
    return away if emitter.cone is None else emitter.cone.turned(away)


class _Steps:
    """Known steps of marched rays, flat: S of them, and the edges between them, E of them."""

    def __init__(self, medium: MarchedMedium, rays: RayBatch, known: np.ndarray) -> None:
        """known: bool (P, STEPS), whether light is looked up there."""
        blocks = medium.blocks
        self.medium, self.rays, self.known, self.filled = medium, rays, known, np.flatnonzero(known)
        self.ray = np.repeat(blocks.ray, STEPS)[self.filled]
        edges = np.zeros((len(blocks.ray), STEPS + 1), bool)
        edges[:, :-1] |= known
        edges[:, 1:] |= known
        self.edge = np.flatnonzero(edges)
        self.edge_ray, self.edge_place = np.repeat(blocks.ray, STEPS + 1)[self.edge], blocks.edges().ravel()[self.edge]
        # Where the edges of each step are in the flat array of edges.
        self.start = self.filled + self.filled // STEPS
        near, dt = medium.lines.near[self.ray], medium.lines.dt[self.ray]
        self.begin = near + blocks.steps(0.0).ravel()[self.filled] * dt
        self.end = near + blocks.steps(1.0).ravel()[self.filled] * dt
        self.middle = self.positions(0.5 * (self.begin + self.end))

    def distances(self, centre: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of rays: the distance (R,) of a point (3,) from their blocks, and the length (R,) of the longest of these."""
        blocks, lines, rays = self.medium.blocks, self.medium.lines, self.rays
        size = STEPS * blocks.size * lines.dt[blocks.ray]
        begin, end, longest = np.full(blocks.rays, np.inf), np.full(blocks.rays, -np.inf), np.zeros(blocks.rays)
        start = lines.near[blocks.ray] + blocks.place * lines.dt[blocks.ray]
        np.minimum.at(begin, blocks.ray, start)
        np.maximum.at(end, blocks.ray, start + size)
        np.maximum.at(longest, blocks.ray, size)
        away = centre - rays.origins
        nearest = np.maximum(np.minimum((away * rays.directions).sum(axis=1), end), begin)
        nearest = np.where(longest > 0.0, nearest, 0.0)
        return np.linalg.norm(away - nearest[:, None] * rays.directions, axis=1), longest

    def between_nodes(self, function: Callable[[np.ndarray, np.ndarray], np.ndarray], some: np.ndarray) -> np.ndarray:
        """Values (..., N) in the middles of some steps, by number, int (N,), between those at the ends of blocks.

        function: values (..., M) at world points (M, 3) on rays by number, int (M,).
        """
        blocks, lines = self.medium.blocks, self.medium.lines
        block, step = np.divmod(self.filled[some], STEPS)
        used, place = np.unique(block, return_inverse=True)
        ray, ends = blocks.ray[used], []
        for steps in (0, STEPS):
            distance = lines.near[ray] + (blocks.place[used] + steps * blocks.size[used]) * lines.dt[ray]
            ends.append(function(self.rays.origins[ray] + distance[:, None] * self.rays.directions[ray], ray))
        share = (step + 0.5) / STEPS
        return (1.0 - share) * ends[0][..., place] + share * ends[1][..., place]

    def scattered(self, values: np.ndarray, dtype: DTypeLike = np.float64) -> np.ndarray:
        """Values (S,) as (P, STEPS), 0 elsewhere."""
        found = np.zeros(self.medium.total.shape, dtype)
        found.reshape(-1)[self.filled] = values
        return found

    def visibility(self, shadow_map: LampShadowMap) -> np.ndarray:
        """Visibility (S,) of an emitter."""

        def visible_at(some: np.ndarray, part: float) -> np.ndarray:
            distance = self.begin[some] + part * (self.end[some] - self.begin[some])
            ray = self.ray[some]
            return shadow_map.visibility(self.rays.origins[ray] + distance[:, None] * self.rays.directions[ray])

        return mean_visibility(visible_at, self.medium.blocks, self.known)

    def positions(self, distance: np.ndarray) -> np.ndarray:
        """World positions (S, 3) at distances (S,) along the rays."""
        return self.rays.origins[self.ray] + distance[:, None] * self.rays.directions[self.ray]

    def optical_depth(self, media: Sequence[BoundMedium], depths: Sequence[LampOpticalDepth]) -> np.ndarray:
        """Optical depth float32 (V, P, STEPS + 1) towards a lamp, at both ends of filled steps."""
        shape = len(self.medium.total), STEPS + 1
        found = np.full((len(media), *shape), DARK, np.float32)
        for v, (bound, depth) in enumerate(zip(media, depths)):
            index = self.medium.lines.index(v, self.edge_ray, self.edge_place)
            found[v].reshape(-1)[self.edge] = depth(index, bound.sigma_t) if bound.sigma_t > 0.0 else 0.0
        return found

    def mean_depth(self, mean: MeanLampDepth) -> np.ndarray:
        """Optical depth float32 (P, STEPS + 1) of all of a lamp's light in the only medium, at ends of filled steps."""
        found = np.full((len(self.medium.total), STEPS + 1), DARK, np.float32)
        index = self.medium.lines.index(0, self.edge_ray, self.edge_place)
        found.reshape(-1)[self.edge] = mean.grid.sample(index + np.float32(1.0))
        return found

    def integrals(self, emitter: Emitter, media: Sequence[BoundMedium], smooth: np.ndarray) -> np.ndarray:
        """Integrals (V, S) over the filled steps of the emitter's fluence times the phase function.

        smooth: bool (S,), where both are interpolated between the ends of blocks.
        """
        found = np.zeros((len(media), len(self.ray)))
        some = np.flatnonzero(smooth)
        found[:, some] = self._smooth_light(emitter, media, some) * (self.end - self.begin)[some]
        some = np.flatnonzero(~smooth)
        found[:, some] = self._integrals(emitter, media, some)
        return found

    def _smooth_light(self, emitter: Emitter, media: Sequence[BoundMedium], some: np.ndarray) -> np.ndarray:
        """The fluence times the phase function (V, N) in some steps, by number."""

        def scattered(points: np.ndarray, ray: np.ndarray) -> np.ndarray:
            cosine = -(light_directions(emitter, points) * self.rays.directions[ray]).sum(axis=1)
            return emitter.fluence(points) * np.stack([bound.medium.scattered(cosine) for bound in media])

        return self.between_nodes(scattered, some)

    def _integrals(self, emitter: Emitter, media: Sequence[BoundMedium], steps: np.ndarray) -> np.ndarray:
        """The integrals (V, N) of some steps, by number."""
        ray = self.ray[steps]
        origin, direction = self.rays.origins[ray] - emitter.position, self.rays.directions[ray]
        nearest = -(origin * direction).sum(axis=1)
        height = np.linalg.norm(origin + nearest[:, None] * direction, axis=1)
        # Only the part of each step within a cone is lit.
        first, last = emitter.lit_between(self.rays.origins, self.rays.directions)
        begin, end = (np.clip(one[ray], self.begin[steps], self.end[steps]) for one in (first, last))
        cut = (begin > self.begin[steps]) | (end < self.end[steps])
        begin, end = begin - nearest, np.maximum(end, begin) - nearest
        length, square = end - begin, height**2 + emitter.extent**2
        found = np.zeros((len(media), len(steps)))
        away = square + (0.5 * (begin + end)) ** 2
        wide, brief = length**2 > WIDE**2 * away, ~cut & (length**2 <= BRIEF**2 * away)
        height = np.sqrt(square + 1e-6 * length**2)
        for bent, count, which in ((False, 1, brief), (False, FEW, ~(brief | wide)), (True, MANY, wide)):
            some = np.flatnonzero(which)
            first, last = (np.arctan2(ends[some], height[some]) for ends in (begin, end))
            nodes, weights = legendre_nodes(count)
            for node, weight in zip(0.5 + 0.5 * nodes, 0.5 * weights):
                if bent:
                    along = height[some] * np.tan(first + node * (last - first))
                    inside = weight * (last - first) * (height[some] ** 2 + along**2) / height[some]
                else:
                    along, inside = begin[some] + node * length[some], weight * length[some]
                points = emitter.position + origin[some] + (nearest[some] + along)[:, None] * direction[some]
                light = emitter.fluence(points) * inside
                cosine = -(light_directions(emitter, points) * direction[some]).sum(axis=1)
                for v, bound in enumerate(media):
                    found[v, some] += light * bound.medium.scattered(cosine)
        return found


class _LitSteps:
    """One lamp in known steps: for each of its emitters optical depths (V, P, STEPS + 1) and visibility (S,).

    smooth: bool (S,), steps in which its light is interpolated between the ends of blocks.
    """

    def __init__(
        self, steps: _Steps, media: Sequence[BoundMedium], lamp: LampInMedia, mean: MeanLampDepth | None = None
    ) -> None:
        """mean: optical depth of all of the lamp's light in the only medium, or None."""
        self.steps, self.media, self.lamp = steps, media, lamp
        distance, longest = steps.distances(lamp.centre)
        self.smooth = (longest <= lamp.smooth(media) * (distance - lamp.reach))[steps.ray]
        self.depths = [steps.optical_depth(media, depths) for depths in lamp.depths]
        # Blocks in which all emitters have the same depths.
        self.together = np.zeros(len(steps.medium.blocks.ray), bool)
        if mean is not None:
            self.together = (distance >= mean.start)[steps.medium.blocks.ray]
            depth = steps.mean_depth(mean)
            for each in self.depths:
                each[0][self.together] = depth[self.together]
        self.visible: list[np.ndarray | float] = [1.0] * len(lamp.emitters)
        if lamp.shadow_maps is not None:
            self.visible = [steps.visibility(shadow_map) for shadow_map in lamp.shadow_maps]

    def single(self, transmitted: np.ndarray, scattering: Sequence[np.ndarray]) -> np.ndarray:
        """Single scattering (R, V, S) for power 1; transmitted: (P, STEPS), from the ray's start.

        scattering: scattering coefficients (V, P, STEPS) of S colour channels.
        """
        steps, medium = self.steps, self.steps.medium
        found = np.zeros((medium.blocks.rays, len(self.media), len(scattering)))
        for emitter, each, visible in zip(self.lamp.emitters, self.depths, self.visible):
            depth = each.sum(axis=0)
            passed = transmitted * mean_transmittance(depth[:, :-1], depth[:, 1:] + medium.tau)
            light = steps.integrals(emitter, self.media, self.smooth) * (passed.ravel()[steps.filled] * visible)
            for v in range(len(self.media)):
                inside = steps.scattered(light[v])
                for s, sigma in enumerate(scattering):
                    found[:, v, s] += medium.blocks.sums(block_sums(inside * sigma[v]))
        return found

    def _light(self, emitter: Emitter) -> np.ndarray:
        """Fluence of an emitter and what it would be if it faced them, (2, S), in the middles of the steps."""
        steps = self.steps
        found = np.stack([emitter.fluence(steps.middle), emitter.brightest(steps.middle)])
        some = np.flatnonzero(self.smooth)
        found[:, some] = steps.between_nodes(
            lambda points, _: np.stack([emitter.fluence(points), emitter.brightest(points)]), some
        )
        return found

    def beam(self, groups: list[list[int]] | None, radius: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The lamp as one light: optical depth (G, P, STEPS + 1), softened fluence and visibility (P, STEPS)."""
        steps = self.steps
        fluence, brightest = np.stack([self._light(emitter) for emitter in self.lamp.emitters], axis=1)
        total = np.maximum(fluence.sum(axis=0), 1e-30)
        reference = np.maximum(np.maximum(total, LEAST_FACING * brightest.sum(axis=0)), 1e-30)
        visible = sum(part * lit for part, lit in zip(fluence, self.visible)) / reference
        depths = [group_sums(each, groups) for each in self.depths]
        if len(depths) == 1:
            depth = depths[0]
        else:
            passed = np.zeros(depths[0].shape)
            for part, one in zip(fluence, depths):
                share = np.full(one.shape[1:], 1.0 / len(depths))
                for ends in (steps.start + 1, steps.start):
                    share.reshape(-1)[ends] = part / total
                passed += share * np.exp(-one.astype(np.float64))
            depth = np.minimum(-np.log(np.maximum(passed, 1e-30)), DARK).astype(np.float32)
            depth[:, self.together] = depths[0][:, self.together]
        received = steps.scattered(softened(reference, radius), np.float32)
        return depth, received, steps.scattered(visible, np.float32)


def march_lamps(
    media: Sequence[BoundMedium],
    rays: RayBatch,
    march: LampMarch,
    options: MarchOptions,
    samples: tuple[np.ndarray, np.ndarray],
) -> LampSegment:
    """What rays, whose intervals contain all media, gather of lamps.

    options: of the march for other light. samples: ray int (M,) and distance (M,) of samples at which ray features are
    wanted if there is a fluence.
    """
    lamps, radius, options = march.lamps, march.radius, replace(options, fluence=march.fluence)
    skip_empty = "empty_space" in options.optimizations
    cutting = Cutting(optical_depth_behind(options), skip_empty=skip_empty, everywhere=True)
    medium = MarchedMedium(media, rays, cutting)
    steps = _Steps(medium, rays, medium.total > 0.0)
    transmitted = np.exp(-medium.before).astype(np.float32)[:, None] * np.exp(medium.tau - medium.within)
    scattering = [medium.scattering(media, channel) for channel in options.scattering]
    single, beams = np.zeros((len(rays.near), len(media), len(lamps), len(scattering))), []
    for k, lamp in enumerate(lamps):
        lit = _LitSteps(steps, media, lamp, march.mean(k))
        single[:, :, k] = lit.single(transmitted, scattering)
        if options.fluence is not None:
            beams.append(lit.beam(options.groups, radius))
    if options.fluence is None or not len(samples[0]):
        return LampSegment(single)
    where = find_steps(medium, *samples)
    points = rays.origins[samples[0]] + samples[1][:, None] * rays.directions[samples[0]]
    return LampSegment(single, _features(steps, beams, lamps, options, where, points, radius))


def _features(
    steps: _Steps,
    beams: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    lamps: Sequence[LampInMedia],
    options: MarchOptions,
    where: SampleSteps,
    points: np.ndarray,
    radius: float,
) -> RayFeatures:
    """Ray features at points (M, 3) of lamps, over their softened fluence there; beams: of each lamp."""
    medium, fluence = steps.medium, options.fluence
    assert fluence is not None
    depths = np.stack([depth for depth, _, _ in beams], axis=1)
    light = np.stack([received * visible for _, received, visible in beams])
    sigma = group_sums(medium.sigma, options.groups)
    source = scattered_source(fluence, steps.rays, sigma, len(lamps), medium)
    found = gather_ray_features(
        medium.blocks, sigma * medium.dt, depths, source, reduced_fractions(fluence), where, light
    ).values
    for k, (lamp, (depth, _, visible)) in enumerate(zip(lamps, beams)):
        # The optical depth is the medium's and the surfaces', without the inverse square.
        start, end = depth[:, where.block, where.step], depth[:, where.block, where.step + 1]
        dark = -np.log(np.maximum(visible[where.block, where.step], 1e-30))
        found[:, :, k, 0] = np.minimum((start + where.inside * (end - start) + dark).T, MAX_TAU_SUN)
        found[:, :, k, 2:] /= np.maximum(softened(lamp.reference(points), radius), 1e-30)[:, None, None]
    return RayFeatures(found)


def find_steps(medium: MarchedMedium, ray: np.ndarray, distance: np.ndarray) -> SampleSteps:
    """Where points of marched rays lie among the steps: the step that holds each, or the nearest one."""
    blocks, lines = medium.blocks, medium.lines
    place = (distance - lines.near[ray]) / lines.dt[ray]
    span = 2.0 * (lines.count.max(initial=1) + STEPS)
    block = np.searchsorted(blocks.ray * span + blocks.place, ray * span + np.maximum(place, 0.0), side="right") - 1
    block = np.clip(block, np.searchsorted(blocks.ray, ray), np.searchsorted(blocks.ray, ray, side="right") - 1)
    inside = (place - blocks.place[block]) / blocks.size[block]
    step = np.clip(np.floor(inside).astype(int), 0, STEPS - 1)
    return SampleSteps(block, step, np.clip(inside - step, 0.0, 1.0))
