# SPDX-License-Identifier: GPL-3.0-or-later
"""How baked light depends on the direction that it is seen from."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..numerics.small_matmul import product, solve_positive
from ..scene.description import Sun
from .directional_factor import (
    ANCHORS,
    BakedView,
    DirectionalFactor,
    Lobe,
    NodeGrid,
    anchor_terms,
    directional_terms,
)
from .lattice import DIRECTIONS, BakeLattice, Visibility

# Points along the longest edge of a volume, at most: of the smooth coefficients, and of those about the baked view.
NODES, FINE_NODES = 48, 112
# Voxels of each of the latter whose mean is taken: light differs from one to the next.
FINE_VOXELS = 2
# In thin volumes light varies less from voxel to voxel: points are as far apart as this optical depth, but at least so
# many along the longest edge.
SPACING, LEAST_NODES = 0.2, 20
# Points times directions of each kind, beyond which points are farther apart.
MAX_PREDICTIONS = 2_000_000
# Share of the points with light that count in a picture, for the progress.
IMPORTANT_SHARE = 0.5
# Suns about which the lobe is, the brightest.
MAX_LIGHTS = 4
# Transmittance below which nobody sees light along a direction, and radiance, as a share of the mean of a point, below
# which it hardly counts.
MIN_TRANSMITTANCE, MIN_RADIANCE = 0.02, 0.01
# Further directions about a lobe that is narrower than DIRECTIONS are apart, and about the baked view: degrees from it
# and how many. NARROW: anisotropy from which on a lobe is.
LOBE_RINGS, VIEW_RING, NARROW = ((0.0, 1), (22.0, 4), (45.0, 7)), (45.0, 7), 0.4
# How much a node can count in a picture, as a share of the most, below which it takes the coefficients of others.
MIN_IMPORTANCE = 0.03
# Of the choice between voxels that are equally near to the middle of a block.
SEED = 0
# Stiffness of the fit against large coefficients.
RIDGE = 1e-3
NODES_PER_BATCH = 4096
# Logarithms of the ratios of colours that differ less from direction to direction are all alike.
SAME_COLOUR = 1e-3


def make_lobe(suns: Sequence[Sun], anisotropy: float) -> Lobe:
    """Lobes about the brightest suns: those of light that has scattered twice."""
    bright = sorted(suns, key=lambda sun: -float(sun.irradiance.mean()))[:MAX_LIGHTS]
    weights = np.array([max(float(sun.irradiance.mean()), 1e-30) for sun in bright])
    directions = np.array([sun.direction for sun in bright]).reshape(-1, 3)
    # Without suns, lobes of an anisotropy of 0 about any direction do nothing.
    if not bright:
        return Lobe(np.array([[0.0, 0.0, 1.0]]), np.ones(1), 0.0)
    return Lobe(directions, weights / weights.sum(), float(np.copysign(anisotropy**2, anisotropy)))


def sampled_directions(lobe: Lobe, along: np.ndarray | None) -> np.ndarray:
    """Directions of rays (D, 3) along which light is predicted: DIRECTIONS, and more where those are too far apart.

    That is about the baked view's rays, of which along (N, 3) holds some, and about narrow lobes of the brightest
    lights, those at least half as bright as the first.
    """
    found = [DIRECTIONS]
    if abs(lobe.anisotropy) > NARROW:
        axes = lobe.directions[lobe.weights >= 0.5 * lobe.weights[0]] * np.sign(lobe.anisotropy)
        found += [_ring(axis, *ring) for axis in axes for ring in LOBE_RINGS]
    if along is not None:
        middle = along.mean(axis=0)
        found.append(_ring(middle / np.linalg.norm(middle), *VIEW_RING))
    return np.concatenate(found)


def _ring(axis: np.ndarray, degrees: float, count: int) -> np.ndarray:
    """Unit directions (count, 3) at an angle to a unit axis (3,)."""
    across = np.cross(axis, np.eye(3)[np.abs(axis).argmin()])
    across /= np.linalg.norm(across)
    turn = 2.0 * np.pi * (np.arange(count)[:, None] + 0.5) / count
    ring = np.cos(turn) * across + np.sin(turn) * np.cross(axis, across)
    return np.cos(np.radians(degrees)) * axis + np.sin(np.radians(degrees)) * ring


def stride_of(longest: int, most: int, thickness: float) -> int:
    """Voxels from point to point, for at most so many points along the longest edge; more in thin volumes.

    longest: voxels along that edge. thickness: optical, of the densest voxel.
    """
    thin = min(SPACING / max(thickness, 1e-30), longest / LEAST_NODES)
    return max(-(-longest // most), int(thin), 1)


def expected_predictions(voxels: float, longest: int, thickness: float) -> float:
    """Points times directions at which a fit predicts light, about; the arguments are as for `stride_of`.

    voxels: number of those with light.
    """
    each = (NODES, len(DIRECTIONS) + VIEW_RING[1]), (FINE_NODES, FINE_VOXELS * (len(ANCHORS) - 1))
    points = [IMPORTANT_SHARE * voxels / stride_of(longest, most, thickness) ** 3 * times for most, times in each]
    return sum(min(number, MAX_PREDICTIONS) for number in points)


@dataclass(frozen=True)
class _Nodes:
    """Points of a coarse grid at which light is predicted, and voxels of each.

    shape: of the grid. stride: voxels from one point to the next. places: int (N, 3). voxels: int (N, V, 3), those near
    the middle of a point's block that have light, some more than once where there are fewer. world_from_index: (4, 4)
    of the grid.
    """

    shape: tuple[int, ...]
    stride: int
    places: np.ndarray
    voxels: np.ndarray
    world_from_index: np.ndarray

    @property
    def positions(self) -> np.ndarray:
        """(N, 3) in the world."""
        return self.places @ self.world_from_index[:3, :3].T + self.world_from_index[:3, 3]

    def grid(self, coefficients: np.ndarray) -> NodeGrid:
        """Coefficients (N, K) of the nodes on the whole grid."""
        return NodeGrid(_spread(self.shape, self.places, coefficients), self.world_from_index)


@dataclass(frozen=True)
class DirectionFit:
    """What the DirectionalFactor of one volume is fitted to.

    scattered: (nx, ny, nz, 3), light that density 1 scatters, as baked, 0 in voxels that need none. steady: the part of
    it, of the same shape, that is taken to be the same in all directions. lobe, view: of the factor. predict: the other
    part (N, 3) at world positions (N, 3) along unit directions (N, 3); it may raise Cancelled.
    """

    lattice: BakeLattice
    scattered: np.ndarray
    steady: np.ndarray
    visibility: Visibility
    lobe: Lobe
    view: BakedView
    predict: Callable[[np.ndarray, np.ndarray], np.ndarray]

    def factor(self, sharpness: float) -> DirectionalFactor | None:
        """The factor, whose detail fades with some sharpness; None where nothing scatters."""
        if not self.scattered.any():
            return None
        smooth, colours = self._smooth()
        return DirectionalFactor(smooth, self._anchors(smooth), colours, self.lobe, self.view, sharpness)

    def _smooth(self) -> tuple[NodeGrid, NodeGrid | None]:
        """Smooth coefficients, and those of the colours."""
        nodes, directions, seen = self._important(
            NODES, 1, lambda nodes: sampled_directions(self.lobe, self.view.directions(nodes.positions))
        )
        samples = np.zeros((len(nodes.voxels), len(directions), 3))
        for number, direction in enumerate(directions):
            at = np.flatnonzero(seen[:, number])
            samples[at, number] = self._light(nodes.voxels[at], np.broadcast_to(direction, (len(at), 3)).copy())
        terms, grey = directional_terms(directions, self.lobe), samples.mean(axis=2)
        spans = [slice(start, start + NODES_PER_BATCH) for start in range(0, len(grey), NODES_PER_BATCH)]
        smooth = nodes.grid(np.concatenate([_fit(grey[span], seen[span], terms) for span in spans]))
        along = self.view.directions(nodes.positions)
        turned = directions[None] - (0.0 if along is None else along[:, None])
        ratios = _ratios(samples) - _ratios(self._baked(nodes.voxels)[:, None])
        ratios[seen == 0.0] = 0.0
        if np.abs(ratios).max() < SAME_COLOUR:
            return smooth, None
        return smooth, nodes.grid(_slopes(ratios, seen * grey, np.broadcast_to(turned, ratios.shape)))

    def _anchors(self, smooth: NodeGrid) -> NodeGrid:
        """Logarithms of the light as baked, and what corrects smooth coefficients along the anchors."""
        if self.view.directions(np.zeros((1, 3))) is None:
            nodes = self._nodes(self._stride(FINE_NODES), FINE_VOXELS)
            return nodes.grid(_logarithm(self._baked(nodes.voxels).mean(axis=1))[:, None])
        nodes, corrections = self._corrections(smooth)
        positions, logarithms = nodes.positions, _logarithm(self._baked(nodes.voxels).mean(axis=1))
        frames = self.view.frames(positions)
        assert frames is not None
        # Along the baked ray, light is known at every node.
        fitted = np.einsum("nk,nk->n", smooth.sample(positions), directional_terms(frames[:, 2], self.lobe))
        fitted += corrections @ anchor_terms(ANCHORS[:1])[0]
        corrections[:, 0] += logarithms - fitted
        return nodes.grid(np.concatenate([logarithms[:, None], corrections], axis=1))

    def _corrections(self, smooth: NodeGrid) -> tuple[_Nodes, np.ndarray]:
        """Nodes and their corrections (N, K) along the anchors; unimportant nodes take others'."""
        nodes, _, _ = self._important(FINE_NODES, FINE_VOXELS, self._middle_anchors)
        turned, coefficients = self.view.frames(nodes.positions), smooth.sample(nodes.positions)
        assert turned is not None
        light, fitted = np.zeros((2, len(coefficients), len(ANCHORS)))
        for k, anchor in enumerate(ANCHORS):
            directions = np.einsum("j,nji->ni", anchor, turned)
            predicted = self._light(nodes.voxels, directions) if k else self._baked(nodes.voxels)
            light[:, k] = predicted.mean(axis=1)
            fitted[:, k] = np.einsum("nk,nk->n", coefficients, directional_terms(directions, self.lobe))
        logarithms = _logarithm(np.maximum(light, MIN_RADIANCE * light.mean(axis=1, keepdims=True)))
        # The same everywhere: anchors turn with the baked ray.
        corrections = nodes.grid(product(logarithms - fitted, np.linalg.inv(anchor_terms(ANCHORS))))
        every = self._nodes(nodes.stride, FINE_VOXELS)
        return every, corrections.values[tuple(every.places.T)].astype(np.float64)

    def _middle_anchors(self, nodes: _Nodes) -> np.ndarray:
        """Directions (K, 3) of the anchors in the middle of nodes."""
        frames = self.view.frames(nodes.positions)
        assert frames is not None
        return ANCHORS @ frames[np.linalg.norm(frames - frames.mean(axis=0), axis=(1, 2)).argmin()]

    def _light(self, voxels: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Light (N, 3) that density 1 scatters along unit directions (N, 3), mean over voxels (N, V, 3)."""
        count = voxels.shape[1]
        flat = voxels.reshape(-1, 3)
        light = self.predict(self.lattice.positions(flat), directions.repeat(count, axis=0))
        return (self.steady[tuple(flat.T)] + light).reshape(-1, count, 3).mean(axis=1)

    def _baked(self, voxels: np.ndarray) -> np.ndarray:
        """Light (N, 3) as baked, mean over voxels (N, V, 3)."""
        return self.scattered[tuple(np.moveaxis(voxels, -1, 0))].mean(axis=1)

    def _stride(self, most: int) -> int:
        thickness = self.visibility.most_extinction * self.lattice.voxel
        return stride_of(max(self.scattered.shape[:3]), most, thickness)

    def _nodes(self, stride: int, count: int) -> _Nodes:
        """Nodes with light, so many voxels apart, and up to `count` voxels of each."""
        size, lattice = self.scattered.shape[:3], self.lattice
        shape = tuple(-(-n // stride) for n in size)
        voxels = np.argwhere(self.scattered.any(axis=3))
        places = voxels // stride
        # Those nearest to the middle of a block, in no order that favours an axis.
        distance = np.linalg.norm(voxels - places * stride - 0.5 * (stride - 1), axis=1).round(3)
        flat = np.ravel_multi_index(tuple(places.T), shape)
        order = np.lexsort((np.random.default_rng(SEED).random(len(flat)), distance, flat))
        first = np.flatnonzero(np.diff(flat[order], prepend=-1))
        sizes = np.minimum(np.diff(first, append=len(order)), count)
        chosen = order[first[:, None] + np.arange(sizes.max()) % sizes[:, None]]
        frame = lattice.world_from_index.copy()
        frame[:3, :3] *= stride
        frame[:3, 3] = lattice.positions(np.full((1, 3), 0.5 * (stride - 1)))[0]
        return _Nodes(
            shape=shape, stride=stride, places=places[order[first]], voxels=voxels[chosen], world_from_index=frame
        )

    def _important(
        self, most: int, count: int, directions_at: Callable[[_Nodes], np.ndarray]
    ) -> tuple[_Nodes, np.ndarray, np.ndarray]:
        """Nodes that count, the directions (D, 3) that rays have there, and how clearly each shows a node (N, D).

        most, count: as for `_stride` and `_nodes`. No more nodes than MAX_PREDICTIONS allows.
        """
        stride = self._stride(most)
        while True:
            nodes = self._nodes(stride, count)
            directions = directions_at(nodes)
            nodes, seen = self._seen(nodes, directions)
            if nodes.voxels[..., 0].size * len(directions) <= MAX_PREDICTIONS:
                return nodes, directions, seen
            stride += 1

    def _seen(self, nodes: _Nodes, directions: np.ndarray) -> tuple[_Nodes, np.ndarray]:
        """Nodes that count where rays go along some of D directions (D, 3), and how clearly each shows them (N, D).

        Transmittances, 0 where nobody sees a node along a direction.
        """
        # A ray along a direction shows a point to a viewer on the other side of it.
        seen = self.visibility.transmittances(nodes.voxels[:, 0], -directions)
        seen[seen < MIN_TRANSMITTANCE] = 0.0
        spacing = np.linalg.norm(nodes.world_from_index[:3, :3], axis=0).max()
        thickness = self.visibility.extinction(nodes.voxels[:, 0]) * np.float32(spacing)
        importance = np.minimum(thickness, np.float32(1.0)) * seen.max(axis=1)
        if not importance.any():
            return nodes, np.ones_like(seen)
        some = importance >= MIN_IMPORTANCE * importance.max()
        return replace(nodes, places=nodes.places[some], voxels=nodes.voxels[some]), seen[some]


def _logarithm(light: np.ndarray) -> np.ndarray:
    return np.log(np.maximum(light, 1e-30))


def _ratios(light: np.ndarray) -> np.ndarray:
    """Logarithms of the ratios of colours (..., 3) to their mean; those that are hardly there count as equal."""
    mean = np.maximum(light.mean(axis=-1, keepdims=True), 1e-30)
    return np.log(np.maximum(light / mean, 1e-3))


def _slopes(ratios: np.ndarray, weights: np.ndarray, turned: np.ndarray) -> np.ndarray:
    """Slopes (N, 9), three of each colour, that fit ratios (N, D, 3) with weights (N, D) along turned (N, D, 3)."""
    weighted = weights[..., None] * turned
    matrix = np.stack([[np.einsum("nd,nd->n", weighted[..., p], turned[..., q]) for q in range(3)] for p in range(3)])
    stiffness = RIDGE * np.einsum("ppn->n", matrix) + 1e-30
    matrix += stiffness * np.eye(3)[..., None]
    slopes = [solve_positive(matrix, np.einsum("ndp,nd->pn", weighted, ratios[..., c])) for c in range(3)]
    return np.concatenate(slopes).T


def _fit(samples: np.ndarray, seen: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """Smooth coefficients (N, SMOOTH) from grey light (N, D) along D directions.

    seen: (N, D), importance of each direction, 0 where the light is not known, but never for all. terms: of the
    directions, (D, SMOOTH). Least squares of the logarithm, weighted such that relative errors count by the
    light, then scaled to the right mean.
    """
    mean = samples.sum(axis=1, keepdims=True) / (seen > 0.0).sum(axis=1, keepdims=True)
    floor = np.maximum(MIN_RADIANCE * mean, 1e-30)
    relative = np.maximum(samples, floor) / np.maximum(mean, 1e-30)
    weights, count = seen * relative, terms.shape[1]
    pairs = (terms[:, :, None] * terms[:, None]).reshape(len(terms), -1)
    matrix = np.ascontiguousarray(product(weights, pairs).T).reshape(count, count, -1)
    stiffness = RIDGE * np.einsum("ppn->n", matrix) / count
    # The constant is free.
    matrix += stiffness * np.diag([1e-6, *[1.0] * (count - 1)])[..., None]
    coefficients = solve_positive(matrix, product(weights * np.log(relative), terms).T).T
    fitted = np.exp(np.clip(product(coefficients, terms.T), -20.0, 20.0)) * mean
    scale = (seen * samples).sum(axis=1) / np.maximum((seen * fitted).sum(axis=1), 1e-30)
    coefficients[:, 0] += np.log(np.maximum(scale * mean[:, 0], 1e-30))
    return coefficients


def _spread(shape: Sequence[int], nodes: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Coefficients (N, K) of nodes on the whole grid, (nx, ny, nz, K): others take their neighbours' mean.

    Nodes without any that is known take those of neighbours that have just taken theirs, and so on.
    """
    # An edge that stays unknown saves tests of the grid's limits.
    padded = tuple(n + 2 for n in shape)
    values = np.zeros((math.prod(padded), coefficients.shape[1]), np.float32)
    known = np.zeros(len(values), bool)
    places = np.ravel_multi_index(tuple(nodes.T + 1), padded)
    values[places], known[places] = coefficients, True
    steps = np.array([[padded[1] * padded[2]], [padded[2]], [1]]) * [-1, 1]
    inside = np.ravel_multi_index(tuple(np.indices(shape).reshape(3, -1) + 1), padded)
    unknown = inside[~known[inside]]
    while len(unknown):
        around = unknown[:, None] + steps.ravel()
        near = known[around]
        counts = near.sum(axis=1)
        reached, around = unknown[counts > 0], around[counts > 0]
        # Values that are not known are zeros.
        sums = np.sum([values[around[:, side]] for side in range(6)], axis=0)
        values[reached] = sums / counts[counts > 0, None].astype(np.float32)
        known[reached] = True
        unknown = unknown[counts == 0]
    return values[inside].reshape(*shape, -1)
