# SPDX-License-Identifier: GPL-3.0-or-later
"""How baked light depends on the direction that it is seen from."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ..numerics.small_matmul import positive_inverse, product, solve_positive
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
from .guided_light import GuidedLight, PointGrid, grey_of
from .lattice import DIRECTIONS, BakeLattice, Visibility, block_means

# Points along the longest edge of a volume, at most: of the smooth coefficients, and of those about the baked view.
NODES, FINE_NODES = 48, 112
# Predictions for each direction: of the smooth coefficients, of an anchor.
SMOOTH_PREDICTIONS, PREDICTIONS = 600, 3000
# Points times directions of each kind, beyond which points are farther apart.
MAX_POINTS = 1_000_000
# Share of the points with light that count where rays go along one direction, for the progress.
IMPORTANT_SHARE = 0.3
# Corrections of corrections, where anchors are seen from other directions than in the middle.
SWEEPS = 2
# In thin volumes light varies less from voxel to voxel: points are as far apart as this optical depth, but at least so
# many along the longest edge.
SPACING, LEAST_NODES = 0.2, 20
# Suns about which the lobe is, the brightest.
MAX_LIGHTS = 4
# Transmittance below which nobody sees light along a direction, and radiance, as a share of the mean of a point, below
# which it hardly counts.
MIN_TRANSMITTANCE, MIN_RADIANCE = 0.02, 0.01
# Further directions about a lobe that is narrower than DIRECTIONS are apart: degrees from it and how many. NARROW:
# anisotropy from which on a lobe is.
LOBE_RINGS, NARROW = ((0.0, 1), (22.0, 4), (45.0, 7)), 0.4
# How much a node can count in a picture, as a share of the most, below which it takes the coefficients of others.
MIN_IMPORTANCE = 0.015
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


def sampled_directions(lobe: Lobe) -> np.ndarray:
    """Directions of rays (D, 3) along which light is predicted: DIRECTIONS, and more where those are too far apart.

    That is about narrow lobes of the brightest lights, those at least half as bright as the first.
    """
    found = [DIRECTIONS]
    if abs(lobe.anisotropy) > NARROW:
        axes = lobe.directions[lobe.weights >= 0.5 * lobe.weights[0]] * np.sign(lobe.anisotropy)
        found += [_ring(axis, *ring) for axis in axes for ring in LOBE_RINGS]
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


def expected_work(voxels: float, longest: int, thickness: float, directions: int, anchors: int) -> float:
    """Predictions of a fit, about; voxels: with light.

    directions: sampled_directions. anchors: 0 without a view. Others: as for `stride_of`.
    """
    predictions = 0.0
    for most, each, count in (FINE_NODES, PREDICTIONS, anchors), (NODES, SMOOTH_PREDICTIONS, directions):
        points = IMPORTANT_SHARE * voxels / stride_of(longest, most, thickness) ** 3
        predictions += count * min(points, each)
    return predictions


@dataclass(frozen=True)
class _Nodes:
    """Points of a coarse grid whose blocks have light.

    points: the whole grid. places: int (N, 3). baked, steady: means (N, 3) over the voxels with light of a block, of
    `DirectionFit.scattered` and `DirectionFit.steady`.
    """

    points: PointGrid
    places: np.ndarray
    baked: np.ndarray
    steady: np.ndarray

    @property
    def positions(self) -> np.ndarray:
        """(N, 3) in the world."""
        return self.points.positions(self.places)

    def take(self, some: np.ndarray) -> "_Nodes":
        """Some of the nodes, bool (N,)."""
        return _Nodes(self.points, self.places[some], self.baked[some], self.steady[some])

    def grid(self, coefficients: np.ndarray) -> NodeGrid:
        """Coefficients (N, K) of the nodes on the whole grid."""
        return NodeGrid(self.points.spread(self.places, coefficients), self.points.world_from_index)


@dataclass(frozen=True)
class _AlongAnchors:
    """Light of N nodes along A rays that are turned from the baked one as the anchors are, about the volume's middle.

    stride: of the nodes. along: float32 (N, A, 3), unit directions. light: (N, A), mean over the colours.
    """

    nodes: _Nodes
    stride: int
    along: np.ndarray
    light: np.ndarray


@dataclass(frozen=True)
class DirectionFit:
    """What the DirectionalFactor of one volume is fitted to.

    scattered: (nx, ny, nz, 3), light that density 1 scatters, as baked, 0 in voxels that need none. steady: the part of
    it, of the same shape, that is taken to be the same in all directions. lobe, view: of the factor. light: the other
    part.
    """

    lattice: BakeLattice
    scattered: np.ndarray
    steady: np.ndarray
    visibility: Visibility
    lobe: Lobe
    view: BakedView
    light: GuidedLight

    def factor(self, sharpness: float) -> DirectionalFactor | None:
        """The factor, whose detail fades with some sharpness; None where nothing scatters."""
        if not self.scattered.any():
            return None
        anchors = self._along_anchors()
        smooth, colours = self._smooth()
        return DirectionalFactor(smooth, self._anchors(smooth, anchors), colours, self.lobe, self.view, sharpness)

    @property
    def _middle(self) -> np.ndarray:
        return self.light.middle

    def _smooth(self) -> tuple[NodeGrid, NodeGrid | None]:
        """Smooth coefficients, and those of the colours."""
        directions = sampled_directions(self.lobe)
        nodes, seen, stride = self._important(NODES, directions)
        views = [BakedView(direction=direction) for direction in directions]
        light = self._light(nodes, stride)
        found = [light(view, seen[:, k], SMOOTH_PREDICTIONS) for k, view in enumerate(views)]
        terms, grey = directional_terms(directions, self.lobe), np.stack([grey_of(one) for one in found], axis=1)
        spans = [slice(start, start + NODES_PER_BATCH) for start in range(0, len(grey), NODES_PER_BATCH)]
        smooth = nodes.grid(np.concatenate([_fit(grey[span], seen[span], terms) for span in spans]))
        if all(np.array_equal(one[:, c], one[:, 0]) for one in (nodes.baked, *found) for c in (1, 2)):
            return smooth, None
        along = self.view.directions(nodes.positions)
        turned = directions[None] - (0.0 if along is None else along[:, None])
        ratios = _ratios(np.stack(found, axis=1)) - _ratios(nodes.baked[:, None])
        ratios[seen == 0.0] = 0.0
        if np.abs(ratios).max() < SAME_COLOUR:
            return smooth, None
        return smooth, nodes.grid(_slopes(ratios, seen * grey, np.broadcast_to(turned, ratios.shape)))

    def _along_anchors(self) -> _AlongAnchors | None:
        """Light along the anchors; None without a view."""
        frames = self.view.frames(self._middle[None])
        if frames is None:
            return None
        [frame] = frames
        nodes, seen, stride = self._important(FINE_NODES, product(ANCHORS, frame))
        views = [self._turned(frame.T @ _turn(anchor) @ frame) for anchor in ANCHORS]
        along_view, light = self._light(nodes, stride), [nodes.baked]
        light += [along_view(view, seen[:, k], PREDICTIONS) for k, view in enumerate(views) if k]
        found = [view.directions(nodes.positions) for view in views]
        along = np.stack([one.astype(np.float32) for one in found if one is not None], axis=1)
        return _AlongAnchors(nodes, stride, along, np.stack([grey_of(one) for one in light], axis=1))

    def _anchors(self, smooth: NodeGrid, known: _AlongAnchors | None) -> NodeGrid:
        """Logarithms of the light as baked, and what corrects smooth coefficients along the anchors."""
        every = self._nodes(self._stride(FINE_NODES) if known is None else known.stride)
        positions, logarithms = every.positions, _logarithm(grey_of(every.baked))
        frames = self.view.frames(positions)
        if frames is None or known is None:
            return every.grid(logarithms[:, None])
        # Unimportant nodes take others'.
        spread = self._corrections(smooth, known)
        corrections = spread.values[tuple(every.places.T)].astype(np.float64)
        # Along the baked ray, light is known at every node.
        fitted = np.einsum("nk,nk->n", smooth.sample(positions), directional_terms(frames[:, 2], self.lobe))
        fitted += product(corrections, anchor_terms(ANCHORS[:1])[0])
        corrections[:, 0] += logarithms - fitted
        exact = every.grid(np.stack([logarithms, corrections[:, 0]], axis=1))
        return NodeGrid(np.concatenate([exact.values, spread.values[..., 1:]], axis=3), exact.world_from_index)

    def _corrections(self, smooth: NodeGrid, known: _AlongAnchors) -> NodeGrid:
        """What corrects smooth coefficients along the anchors."""
        positions = known.nodes.positions
        frames, coefficients = self.view.frames(positions), smooth.sample(positions)
        assert frames is not None
        frames = frames.astype(np.float32)
        columns = range(len(ANCHORS))
        fitted = [np.einsum("nk,nk->n", coefficients, directional_terms(known.along[:, k], self.lobe)) for k in columns]
        least = MIN_RADIANCE * known.light.mean(axis=1, keepdims=True)
        residual = _logarithm(np.maximum(known.light, least)) - np.stack(fitted, axis=1)
        inverse = positive_inverse(anchor_terms(ANCHORS))
        corrections = product(residual, inverse)
        # Off the middle, rays of turned cameras are not quite along the anchors.
        for start in range(0, len(corrections) if self.view.position is not None else 0, NODES_PER_BATCH):
            span = slice(start, start + NODES_PER_BATCH)
            local = np.einsum("nij,nkj->nki", frames[span], known.along[span])
            terms = anchor_terms(local.reshape(-1, 3)).reshape(len(local), len(columns), -1)
            for _ in range(SWEEPS):
                told = np.einsum("nk,nak->na", corrections[span], terms)
                corrections[span] += product(residual[span] - told, inverse)
        return known.nodes.grid(corrections)

    def _turned(self, rotation: np.ndarray) -> BakedView:
        """The view, turned by a rotation (3, 3) about the volume's middle."""
        if self.view.position is None:
            return BakedView(direction=rotation @ self.view.direction)
        return BakedView(position=self._middle + rotation @ (self.view.position - self._middle))

    def _light(self, nodes: _Nodes, stride: int) -> Callable[[BakedView, np.ndarray, int], np.ndarray]:
        """Light (N, 3) that density 1 scatters at nodes along a view's rays, which show them so clearly (N,).

        The last argument is how many of them are predicted, about.
        """
        light, thickness = self.light.at(stride, nodes.places), self._thickness(nodes)
        return lambda view, seen, most: light(view, seen * thickness, most) + nodes.steady

    def _stride(self, most: int) -> int:
        thickness = self.visibility.most_extinction * self.lattice.voxel
        return stride_of(max(self.scattered.shape[:3]), most, thickness)

    def _thickness(self, nodes: _Nodes) -> np.ndarray:
        """Optical thickness (N,) of nodes, at most 1."""
        thickness = self.visibility.extinction(self.lattice.voxels(nodes.positions)) * np.float32(nodes.points.spacing)
        return np.minimum(thickness, np.float32(1.0))

    def _nodes(self, stride: int) -> _Nodes:
        """Nodes with light, so many voxels apart."""
        # numpy is slow to reduce an axis of length 3.
        red, green, blue = (self.scattered[..., c] != 0.0 for c in range(3))
        filled = block_means(red | green | blue, stride)
        places = np.argwhere(filled > 0.0)
        at = tuple(places.T)
        baked, steady = (
            np.stack([block_means(light[..., c], stride)[at] / filled[at] for c in range(3)], axis=1)
            if light.any()
            else np.zeros(places.shape, np.float32)
            for light in (self.scattered, self.steady)
        )
        return _Nodes(PointGrid.over(self.lattice, stride), places, baked, steady)

    def _important(self, most: int, directions: np.ndarray) -> tuple[_Nodes, np.ndarray, int]:
        """As `_seen`, and the stride of the nodes: at most so many along the longest edge, and MAX_POINTS in all."""
        stride = self._stride(most)
        while True:
            every = self._nodes(stride)
            if IMPORTANT_SHARE * len(every.places) * len(directions) <= MAX_POINTS:
                nodes, seen = self._seen(every, directions)
                if seen.size <= MAX_POINTS:
                    return nodes, seen, stride
            stride += 1

    def _seen(self, nodes: _Nodes, directions: np.ndarray) -> tuple[_Nodes, np.ndarray]:
        """Nodes that count where rays go along some of D directions (D, 3), and how clearly each shows them (N, D).

        Transmittances, 0 where nobody sees a node along a direction.
        """
        # A ray along a direction shows a point to a viewer on the other side of it.
        voxels = self.lattice.voxels(nodes.positions)
        seen = self.visibility.transmittances(voxels, -directions)
        seen[seen < MIN_TRANSMITTANCE] = 0.0
        importance = self._thickness(nodes) * seen.max(axis=1)
        if not importance.any():
            return nodes, np.ones_like(seen)
        some = importance >= MIN_IMPORTANCE * importance.max()
        return nodes.take(some), seen[some]


def _turn(anchor: np.ndarray) -> np.ndarray:
    """The rotation (3, 3), about an axis across both, that takes the third axis to a unit vector (3,)."""
    x, y, z = anchor
    cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
    return np.eye(3) + cross + cross @ cross / (1.0 + z)


def _logarithm(light: np.ndarray) -> np.ndarray:
    return np.log(np.maximum(light, 1e-30))


def _ratios(light: np.ndarray) -> np.ndarray:
    """Logarithms of the ratios of colours (..., 3) to their mean; those that are hardly there count as equal."""
    mean = np.maximum(grey_of(light), 1e-30)[..., None]
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
