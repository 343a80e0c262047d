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
from dataclasses import dataclass

import numpy as np

from ..grids.bound_medium import Movement
from ..numerics.quadrature import legendre_integrals, legendre_nodes
from ..numerics.small_matmul import product
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
    each ray's lookups. ray: int32 (M,), ascending. distance, weight: (M,). fraction: float32 (M, V), of the extinction
    in each volume. features: for networks that need them, or None. lamp_features: the same of lamps.
    scattering: float32 (M, V, S), `sample_scattering` of RaySegment, or None. detail: int (P,), as of RayBatch, or
    None. volumes, groups: numbers, ascending, of those that rays were marched through; None for all of them. Other
    volumes are not met. rays: through each whole pixel. eyes: int (P,), as of RayBatch, or None. motion: as of
    BoundMedium, of all volumes.
    """

    pixel: np.ndarray
    origins: np.ndarray
    directions: np.ndarray
    offsets: np.ndarray
    ray: np.ndarray
    distance: np.ndarray
    weight: np.ndarray
    fraction: np.ndarray
    features: RayFeatures | None = None
    lamp_features: RayFeatures | None = None
    scattering: np.ndarray | None = None
    detail: np.ndarray | None = None
    volumes: Sequence[int] | None = None
    groups: Sequence[int] | None = None
    rays: int = 1
    eyes: np.ndarray | None = None
    motion: Sequence[Movement | None] = ()

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
        return DepthSamples(
            pixel=self.pixel,
            origins=self.origins,
            directions=self.directions,
            offsets=self.offsets,
            ray=self.ray[at_nodes],
            distance=self.distance[at_nodes],
            weight=self.weight[at_nodes] * detail,
            fraction=self.fraction[at_nodes],
            features=None if self.features is None else RayFeatures(self.features.values[at_nodes]),
            lamp_features=None if self.lamp_features is None else RayFeatures(self.lamp_features.values[at_nodes]),
            scattering=None if self.scattering is None else self.scattering[at_nodes],
            volumes=self.volumes,
            groups=self.groups,
            rays=self.rays,
            eyes=self.eyes,
            motion=self.motion,
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
        members = self._places(members)
        # numpy is slow to sum along an axis of length 1.
        return self.fraction[:, members[0]] if len(members) == 1 else self.fraction[:, members].sum(axis=1)

    def meets(self, members: Sequence[int]) -> bool:
        """Whether rays were marched through volumes of a group."""
        return self.volumes is None or members[0] in self.volumes

    def _places(self, members: Sequence[int]) -> Sequence[int]:
        return members if self.volumes is None else [self.volumes.index(v) for v in members]

    def turns(self, members: Sequence[int]) -> list[np.ndarray]:
        """Of each sample one of some volumes that hold it, int (M,), by place in `members` or -1; in as many arrays as
        it takes for all that do."""
        within = np.cumsum(self.fraction[:, self._places(members)] > 0.0, axis=1)
        most = int(within.max(initial=0))
        return [np.where(within[:, -1] >= n, (within >= n).argmax(axis=1), -1) for n in range(1, most + 1)]

    def scattered_by(
        self, samples: np.ndarray, members: np.ndarray, factors: np.ndarray, columns: Sequence[int]
    ) -> np.ndarray:
        """As `scattered`, by one volume, int (N,), at each sample; factors: float32 (N, C)."""
        places = members if self.volumes is None else np.searchsorted(self.volumes, members)
        weight = self.weight[samples, None] * factors
        if self.scattering is None:
            return weight * self.fraction[samples, places, None]
        return weight * self.scattering[samples, places][:, columns]

    def place_of_group(self, group: int) -> int:
        """Place of a group in the ray features."""
        return group if self.groups is None else self.groups.index(group)

    def scattered(
        self, samples: np.ndarray | slice, members: Sequence[int], factors: np.ndarray, columns: Sequence[int]
    ) -> np.ndarray:
        """Weights (N, C) of the light that the member volumes scatter at samples in C colour channels.

        factors: float32 (V, C) of each member. columns: index of each channel in `scattering`.
        """
        weight, members = self.weight[samples, None], self._places(members)
        if self.scattering is None and len(members) == 1:
            return weight * self.fraction[samples, members[0], None] * factors
        if self.scattering is None:
            return weight * product(self.fraction[samples][:, members], factors)
        scattering = self.scattering[samples][:, members][:, :, columns]
        return weight * np.einsum("nvc,vc->nc", scattering, factors)

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
