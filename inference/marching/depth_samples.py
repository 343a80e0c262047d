# SPDX-License-Identifier: GPL-3.0-or-later
"""Depths along camera rays at which multiple scattering is evaluated.

Multiple scattering varies smoothly along a ray, and its integral over the ray's opacity is computed by Gauss-Legendre
quadrature: n depths integrate polynomials of degree 2n - 1 exactly, where as many equal strata integrate only straight
lines. Light of a lamp close by is not smooth. On rays of more detail the interval of opacity that each node stands for
is divided into equal strata. They are sampled in their middles, except that the stratum that holds the node is sampled
at the node: smooth light still has the full quadrature.
"""

import functools
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..grids.bound_medium import Movement
from ..numerics.quadrature import legendre_integrals, legendre_nodes
from ..numerics.small_matmul import product
from .held_volumes import places_among, side_by_side
from .ray_features import RayFeatures

# Rays below this opacity are not sampled.
MIN_ALPHA = 1e-4
# Sample counts above this are rounded up to multiples of it, because computing their nodes takes time.
COARSE_COUNT = 16
# Remaining fraction of the noise of samples along a ray whose jitter is a lattice; measured.
LATTICE_NOISE = 0.5

#: Nodes in [0, 1) of a ray's opacity and their weights, which sum to 1: float64 (n,) each, for n samples.
Quadrature = Callable[[int], tuple[np.ndarray, np.ndarray]]


@functools.lru_cache(maxsize=256)
def gauss_legendre(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Legendre nodes in (0, 1) and their weights, which sum to 1: float64 (count,) each."""
    nodes, weights = legendre_nodes(count)
    return 0.5 + 0.5 * nodes, 0.5 * weights


def possible_counts(most: int) -> list[int]:
    """Every number of depths above 0 that a ray may have; an opaque ray has `most`."""
    return [*range(1, min(most, COARSE_COUNT + 1)), *range(2 * COARSE_COUNT, most, COARSE_COUNT), most]


def entry_point(count: int) -> tuple[np.ndarray, np.ndarray]:
    """As `gauss_legendre`, for samples where rays enter density."""
    return np.zeros(count), np.full(count, 1.0 / count)


def divided(quadrature: tuple[np.ndarray, np.ndarray], detail: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (n detail,) ascending and weights of the strata of a quadrature, and indices (n,) of its nodes in them.

    quadrature: nodes and weights (n,), each node within its interval of [0, 1].
    """
    nodes, weights = quadrature
    number = np.arange(detail)
    width, begin = weights[:, None] / detail, np.append(0.0, np.cumsum(weights)[:-1])[:, None]
    low = begin + number * width
    holds = ((number == 0) | (nodes[:, None] >= low)) & ((number + 1 == detail) | (nodes[:, None] < low + width))
    positions = np.where(holds, nodes[:, None], low + 0.5 * width)
    return positions.ravel(), np.repeat(width.ravel(), detail), np.flatnonzero(holds)


@dataclass
class DepthSamples:
    """Depth samples along camera rays, ray after ray.

    pixel: int (P,), of each ray, ascending. origins, directions: float64 (P, 3). offsets: (P,) in [0, 1), jitter of
    each ray's lookups. ray: int32 (M,), ascending. distance, weight: (M,). held: int32 (M, K), numbers of the volumes
    that each sample is in, as of `held_volumes`. fraction: float32 (M, K), of the extinction in each of these.
    held_groups: int32 (M, J), the same of groups of volumes. features: of these, for networks that need them, or None.
    lamp_features: the same of lamps. scattering: float32 (M, K, S), `sample_scattering` of RaySegment, or None. detail:
    int (P,), as of RayBatch, or None. volumes: numbers of those that rays were marched through. Other volumes are not
    met. rays: through each whole pixel. eyes: int (P,), as of RayBatch, or None. motion: as of BoundMedium, of all
    volumes.
    """

    pixel: np.ndarray
    origins: np.ndarray
    directions: np.ndarray
    offsets: np.ndarray
    ray: np.ndarray
    distance: np.ndarray
    weight: np.ndarray
    held: np.ndarray
    fraction: np.ndarray
    held_groups: np.ndarray
    features: RayFeatures | None = None
    lamp_features: RayFeatures | None = None
    scattering: np.ndarray | None = None
    detail: np.ndarray | None = None
    volumes: frozenset[int] = frozenset((0,))
    rays: int = 1
    eyes: np.ndarray | None = None
    motion: Sequence[Movement | None] = ()

    @classmethod
    def joined(cls, parts: Sequence["DepthSamples"]) -> "DepthSamples":
        """Those along rays through different pixels, in the order of these."""
        if len(parts) == 1:
            return parts[0]
        pixel = np.concatenate([part.pixel for part in parts])
        rays = np.argsort(pixel, kind="stable")
        new = np.empty(len(rays), np.int32)
        new[rays] = np.arange(len(rays))
        first = np.cumsum([0, *(len(part.pixel) for part in parts)])
        ray = np.concatenate([new[start + part.ray] for start, part in zip(first, parts)])
        order = np.argsort(ray, kind="stable")
        # Where the albedo of one part alone varies, the others scatter in proportion to their extinction.
        channels = max(0 if part.scattering is None else part.scattering.shape[2] for part in parts)
        scattering = [
            np.repeat(part.fraction[..., None], channels, axis=2) if part.scattering is None else part.scattering
            for part in parts
        ]

        def of_rays(arrays: Sequence[np.ndarray | None]) -> np.ndarray | None:
            return None if arrays[0] is None else np.concatenate([array for array in arrays if array is not None])[rays]

        def of_samples(features: Sequence[RayFeatures | None]) -> RayFeatures | None:
            known = [each.values for each in features if each is not None]
            return RayFeatures(side_by_side(known)[order]) if known else None

        return cls(
            pixel=pixel[rays],
            origins=np.concatenate([part.origins for part in parts])[rays],
            directions=np.concatenate([part.directions for part in parts])[rays],
            offsets=np.concatenate([part.offsets for part in parts])[rays],
            ray=ray[order],
            distance=np.concatenate([part.distance for part in parts])[order],
            weight=np.concatenate([part.weight for part in parts])[order],
            held=side_by_side([part.held for part in parts], -1)[order],
            fraction=side_by_side([part.fraction for part in parts])[order],
            held_groups=side_by_side([part.held_groups for part in parts], -1)[order],
            features=of_samples([part.features for part in parts]),
            lamp_features=of_samples([part.lamp_features for part in parts]),
            scattering=side_by_side(scattering)[order] if channels else None,
            detail=of_rays([part.detail for part in parts]),
            volumes=frozenset().union(*(part.volumes for part in parts)),
            rays=parts[0].rays,
            eyes=of_rays([part.eyes for part in parts]),
            motion=parts[0].motion,
        )

    def __post_init__(self) -> None:
        starts = np.flatnonzero(np.diff(self.ray, prepend=-1))
        counts = np.diff(starts, append=len(self.ray))
        self.starts, self.counts = starts, counts
        # The sampled ray of each sample.
        self.sampled = np.repeat(np.arange(len(starts)), counts)

    @property
    def nodes(self) -> "DepthSamples":
        """The samples without detail."""
        # Cached, a reference to itself would keep the samples in memory until Python looks for cycles.
        return self if self.detail is None else self._nodes

    @functools.cached_property
    def _nodes(self) -> "DepthSamples":
        assert self.detail is not None
        sampled = np.arange(len(self.starts))
        at_nodes = np.sort(np.concatenate([self.ray[:0], *(samples.ravel() for _, samples, _ in self._alike(sampled))]))
        detail = self.detail[self.ray[at_nodes]]
        return replace(
            self,
            ray=self.ray[at_nodes],
            distance=self.distance[at_nodes],
            weight=self.weight[at_nodes] * detail,
            held=self.held[at_nodes],
            fraction=self.fraction[at_nodes],
            held_groups=self.held_groups[at_nodes],
            features=None if self.features is None else RayFeatures(self.features.values[at_nodes]),
            lamp_features=None if self.lamp_features is None else RayFeatures(self.lamp_features.values[at_nodes]),
            scattering=None if self.scattering is None else self.scattering[at_nodes],
            detail=None,
        )

    def _alike(self, sampled: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """Groups of sampled rays (S,), by number, with the same nodes: indices (R,) in `sampled`, samples at nodes
        (R, n), and the nodes (n,) in the opacity."""
        starts, counts = self.starts[sampled], self.counts[sampled]
        details = np.ones_like(counts) if self.detail is None else self.detail[self.ray[starts]]
        most = int(details.max(initial=1)) + 1
        for number in np.flatnonzero(np.bincount(counts * most + details)):
            count, detail = divmod(int(number), most)
            quadrature = gauss_legendre(count // detail)
            offsets = divided(quadrature, detail)[2] if detail > 1 else np.arange(count)
            rays = np.flatnonzero((counts == count) & (details == detail))
            yield rays, starts[rays, None] + offsets, quadrature[0]

    def seen(self, samples: np.ndarray | slice, members: int | np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Positions and unit directions (N, 3) in the world of samples, moved to where they are at the frame.

        members: volumes, by number, with which they move, int (N,) or the same for all.
        """
        ray = self.ray[samples]
        directions = self.directions[ray]
        positions = self.origins[ray] + self.distance[samples, None] * directions
        members = np.broadcast_to(members, len(ray))
        for v, motion in enumerate(self.motion):
            if motion is not None and self.eyes is not None and (some := np.flatnonzero(members == v)).size:
                eyes = self.eyes[ray[some]]
                positions[some] = motion.at_frame(positions[some], eyes)
                turned = np.einsum("nij,nj->ni", motion.frames[eyes, :, :3], directions[some])
                directions[some] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
        return positions, directions

    def velocities(self, samples: np.ndarray, motion: Movement) -> np.ndarray | None:
        """World velocities float64 (N, 3) at which what is seen at samples moves so; None where nothing is carried."""
        if motion.flow is None or self.eyes is None:
            return None
        ray = self.ray[samples]
        eyes = self.eyes[ray]
        places = self.origins[ray] + self.distance[samples, None] * self.directions[ray]
        return motion.flow.apparent(motion.frame_of(places, eyes), eyes)

    def share(self, members: Sequence[int]) -> np.ndarray:
        """Fraction float32 (M,) of the extinction at each sample that the member volumes have."""
        if not self.meets(members):
            return np.zeros(len(self.fraction), np.float32)
        fraction = self.fraction * (places_among(members, self.held) >= 0)
        # numpy is slow to sum along an axis of length 1.
        return fraction[:, 0] if fraction.shape[1] == 1 else fraction.sum(axis=1)

    def meets(self, members: Sequence[int]) -> bool:
        """Whether rays were marched through any of some volumes."""
        return not self.volumes.isdisjoint(members)

    def turns(self, members: Sequence[int]) -> list[np.ndarray]:
        """Of each sample one of some volumes that hold it, int (M,), by place in `members` or -1; in as many arrays as
        it takes for all that do."""
        places = places_among(members, self.held)
        within = np.cumsum((places >= 0) & (self.fraction > 0.0), axis=1)
        every, most = np.arange(len(places)), int(within.max(initial=0))
        return [
            np.where(within[:, -1] >= n, places[every, (within >= n).argmax(axis=1)], -1) for n in range(1, most + 1)
        ]

    def scattered_by(
        self, samples: np.ndarray, members: np.ndarray, factors: np.ndarray, columns: Sequence[int]
    ) -> np.ndarray:
        """As `scattered`, by one volume, int (N,), at each sample; factors: float32 (N, C)."""
        column = (self.held[samples] == members[:, None]).argmax(axis=1)
        weight = self.weight[samples, None] * factors
        if self.scattering is None:
            return weight * self.fraction[samples, column, None]
        return weight * self.scattering[samples, column][:, columns]

    def column_of_group(self, samples: np.ndarray | slice, groups: int | np.ndarray) -> int | np.ndarray:
        """Column of a group, or of one (N,) for each of some samples, in the ray features; any where these are not in
        it."""
        if self.held_groups.shape[1] == 1:
            return 0
        return (self.held_groups[samples] == np.reshape(groups, (-1, 1))).argmax(axis=1)

    def scattered(
        self, samples: np.ndarray | slice, members: Sequence[int], factors: np.ndarray, columns: Sequence[int]
    ) -> np.ndarray:
        """Weights (N, C) of the light that the member volumes scatter at samples in C colour channels.

        factors: float32 (V, C) of each member. columns: index of each channel in `scattering`.
        """
        # Of each sample's volumes; others scatter nothing.
        own = np.vstack([factors, np.zeros_like(factors[:1])])[places_among(members, self.held[samples])]
        if self.scattering is not None:
            scattered = self.scattering[samples][:, :, columns] * own
        else:
            scattered = self.fraction[samples][..., None] * own
        scattered = scattered[:, 0] if scattered.shape[1] == 1 else scattered.sum(axis=1)
        return self.weight[samples, None] * scattered

    def jitter(self, samples: np.ndarray) -> np.ndarray:
        """Jitter (N, 3) in [-1/2, 1/2) of the samples' lookups: a rank-1 lattice along each ray, shifted by pixel."""
        number = samples - self.starts[self.sampled[samples]]
        along = number[:, None] * [0.8191725133961645, 0.6710436067037893, 0.5497004779019703]
        # Large odd factors decorrelate the three components.
        along += self.offsets[self.ray[samples], None] * [1571.0, 5717.0, 9371.0]
        return along - np.floor(along) - 0.5

    def optical_depths(self) -> tuple[np.ndarray, np.ndarray]:
        """Optical depth (M,) between the camera and each sample, and of its whole ray.

        For samples without detail, which are Gauss-Legendre nodes in the opacity of rays; their weights sum to it.
        """
        nodes = np.zeros(len(self.ray))
        for _, samples, opacities in self._alike(np.arange(len(self.starts))):
            nodes[samples] = opacities
        alpha = np.minimum(np.add.reduceat(self.weight, self.starts), 1.0 - 1e-12)
        alpha = np.repeat(alpha, self.counts)
        return -np.log1p(-nodes * alpha), -np.log1p(-alpha)

    def legendre_means(self, share: np.ndarray, count: int) -> np.ndarray:
        """Means float64 (count, M) of Legendre polynomials over the opacity that each sample stands for.

        share: (M,), of the extinction, whose opacity alone counts; along a ray it is the polynomials' argument, from -1
        to 1.
        """
        weight = self.weight * share
        ends = np.cumsum(weight)
        before = (ends - weight)[self.starts]
        total = np.maximum(np.add.reduceat(weight, self.starts), 1e-30) if len(weight) else weight
        begin, end = (
            2.0 * (place - before[self.sampled]) / total[self.sampled] - 1.0 for place in (ends - weight, ends)
        )
        width = np.where(end > begin, end - begin, 1.0)
        means = (legendre_integrals(end, count) - legendre_integrals(begin, count)) / width
        return np.where(end > begin, means, 1.0)

    def standard_error(self, values: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Standard errors of the sums of weighted values over rays: the rays' pixels (S,), and errors (S,).

        values: (M,), weighted. points: samples (N,) on these rays, ascending. Estimated from the upper quarter of the
        Legendre coefficients that the values at the nodes determine. A smooth integrand leaves little in them; noise
        contributes as much to each as to the mean, apart from what cancels because the jitter along a ray is a lattice.
        With one sample the error is the sum itself. On rays of more detail it falls in proportion to the samples.
        Errors of rays through the same pixel are independent.
        """
        chosen = self.sampled[points]
        chosen = chosen[np.flatnonzero(np.diff(chosen, prepend=-1))]
        errors = np.zeros(len(chosen))
        for rays, samples, _ in self._alike(chosen):
            errors[rays] = _upper_quarter(values[samples], samples.shape[1])
        return self.pixel[self.ray[self.starts[chosen]]], errors / np.sqrt(self.rays)


def _upper_quarter(values: np.ndarray, count: int) -> np.ndarray:
    """LATTICE_NOISE times the root mean square of the last Legendre coefficients, normalised, of values (R, count)."""
    if count == 1:
        return np.abs(values[:, 0])
    return LATTICE_NOISE * np.sqrt((product(values, _last_polynomials(count)) ** 2).mean(axis=1))


@functools.lru_cache(maxsize=256)
def _last_polynomials(count: int) -> np.ndarray:
    """The last quarter of the first `count` normalised Legendre polynomials at its nodes: float64 (count, degrees)."""
    degrees = np.arange(max(3 * count // 4, 1), count)
    basis = np.polynomial.legendre.legvander(2.0 * gauss_legendre(count)[0] - 1.0, count - 1)[:, degrees]
    return basis * np.sqrt(2 * degrees + 1.0)
