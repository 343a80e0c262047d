# SPDX-License-Identifier: GPL-3.0-or-later
"""How baked light depends on the direction that it is seen from."""

from collections.abc import Callable, Sequence

import numpy as np

from ..scene.description import Sun
from .lattice import DIRECTIONS, BakeLattice, Visibility
from .lit_volume import COEFFICIENTS, BakedView, DirectionalFactor, Lobe, directional_terms

# Nodes along the longest edge of the grid of coefficients, at most.
NODES = 48
# Suns about which the lobe is, the brightest.
MAX_LIGHTS = 4
# Transmittance below which nobody sees light along a direction, and radiance, as a share of the mean of a point, below
# which it hardly counts.
MIN_TRANSMITTANCE, MIN_RADIANCE = 0.02, 0.01
# Further directions about a lobe that is narrower than DIRECTIONS are apart, and about the baked view: degrees from it
# and how many. NARROW: anisotropy from which on a lobe is.
LOBE_RINGS, VIEW_RING, NARROW = ((0.0, 1), (22.0, 4), (45.0, 7)), (45.0, 7), 0.4
# How much a node can count in a picture, as a share of the most, below which it takes the coefficients of others.
MIN_IMPORTANCE = 0.1
# Stiffness of the fit against large coefficients.
RIDGE = 1e-3
NODES_PER_BATCH = 4096


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


def fit_directions(
    lattice: BakeLattice,
    scattered: np.ndarray,
    steady: np.ndarray,
    visibility: Visibility,
    lobe: Lobe,
    view: BakedView,
    sharpness: float,
    predict: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> DirectionalFactor | None:
    """The DirectionalFactor of one volume; None where nothing scatters.

    scattered: (nx, ny, nz, 3), light that density 1 scatters, as baked, 0 in voxels that need none. steady: the part of
    it, of the same shape, that is taken to be the same in all directions. lobe, view, sharpness: of the factor.
    predict: the other part (N,), mean over the colours, at world positions (N, 3) along unit directions (N, 3); it may
    raise Cancelled.
    """
    stride = max(-(-max(scattered.shape[:3]) // NODES), 1)
    nodes, voxels = _representatives(scattered, stride)
    if not len(nodes):
        return None
    directions = sampled_directions(lobe, view.directions(lattice.positions(voxels)))
    # A ray along a direction shows a point to a viewer on the other side of it.
    seen = visibility.transmittances(voxels, -directions)
    seen[seen < MIN_TRANSMITTANCE] = 0.0
    thickness = visibility.extinction(voxels) * np.float32(stride * lattice.voxel)
    importance = np.minimum(thickness, np.float32(1.0)) * seen.max(axis=1)
    if importance.any():
        some = importance >= MIN_IMPORTANCE * importance.max()
        nodes, voxels, seen = nodes[some], voxels[some], seen[some]
    else:
        seen = np.ones_like(seen)
    positions = lattice.positions(voxels)
    same = steady[tuple(voxels.T)].mean(axis=1)
    samples = np.zeros((len(nodes), len(directions)))
    for number, direction in enumerate(directions):
        at = np.flatnonzero(seen[:, number])
        samples[at, number] = same[at] + predict(positions[at], np.broadcast_to(direction, (len(at), 3)).copy())
    coefficients = np.zeros((len(nodes), COEFFICIENTS), np.float32)
    for start in range(0, len(nodes), NODES_PER_BATCH):
        span = slice(start, start + NODES_PER_BATCH)
        coefficients[span, :-2] = _fit(samples[span], seen[span], directional_terms(directions, lobe))
    coefficients[:, -1] = np.log(np.maximum(scattered[tuple(voxels.T)].mean(axis=1), 1e-30))
    along = view.directions(positions)
    if along is not None:
        terms = directional_terms(along, lobe)
        coefficients[:, -2] = coefficients[:, -1] - np.einsum("nk,nk->n", coefficients[:, :-2], terms)
    frame = lattice.world_from_index.copy()
    frame[:3, :3] *= stride
    frame[:3, 3] = lattice.positions(np.full((1, 3), 0.5 * (stride - 1)))[0]
    shape = [-(-n // stride) for n in scattered.shape[:3]]
    return DirectionalFactor(_spread(shape, nodes, coefficients), frame, lobe, view, sharpness)


def _representatives(scattered: np.ndarray, stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes int (N, 3) whose blocks of stride^3 voxels have light, and a voxel of each near the block's middle."""
    voxels = np.argwhere(scattered.any(axis=3))
    if not len(voxels):
        return voxels, voxels
    blocks = voxels // stride
    distance = np.abs(voxels - blocks * stride - 0.5 * (stride - 1)).sum(axis=1)
    flat = np.ravel_multi_index(tuple(blocks.T), [-(-n // stride) for n in scattered.shape[:3]])
    order = np.lexsort((distance, flat))
    first = order[np.flatnonzero(np.diff(flat[order], prepend=-1))]
    return blocks[first], voxels[first]


def _fit(samples: np.ndarray, seen: np.ndarray, terms: np.ndarray) -> np.ndarray:
    """Coefficients (N, COEFFICIENTS - 2) from grey light (N, D) along D directions.

    seen: (N, D), importance of each direction, 0 where the light is not known, but never for all. terms: of the
    directions, (D, COEFFICIENTS - 2). Least squares of the logarithm, weighted such that relative errors count by the
    light, then scaled to the right mean.
    """
    mean = samples.sum(axis=1, keepdims=True) / (seen > 0.0).sum(axis=1, keepdims=True)
    floor = np.maximum(MIN_RADIANCE * mean, 1e-30)
    logarithms = np.log(np.maximum(samples, floor) / np.maximum(mean, 1e-30))
    weights = seen * (np.maximum(samples, floor) / np.maximum(mean, 1e-30))
    matrix = np.einsum("nk,kp,kq->npq", weights, terms, terms, optimize=True)
    stiffness = RIDGE * np.trace(matrix, axis1=1, axis2=2) / terms.shape[1]
    # The constant is free.
    matrix += stiffness[:, None, None] * np.diag([1e-6, *[1.0] * (terms.shape[1] - 1)])
    right = np.einsum("nk,kp,nk->np", weights, terms, logarithms, optimize=True)
    found = np.linalg.solve(matrix, right[..., None])[..., 0]
    fitted = np.exp(np.clip(found @ terms.T, -20.0, 20.0)) * mean
    scale = (seen * samples).sum(axis=1) / np.maximum((seen * fitted).sum(axis=1), 1e-30)
    found[:, 0] += np.log(np.maximum(scale * mean[:, 0], 1e-30))
    return found


def _spread(shape: Sequence[int], nodes: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """Coefficients on the whole grid, (nx, ny, nz, COEFFICIENTS): nodes without any take the mean of neighbours."""
    sums = np.zeros((*shape, coefficients.shape[1]), np.float32)
    counts = np.zeros((*shape, 1), np.float32)
    sums[tuple(nodes.T)], counts[tuple(nodes.T)] = coefficients, 1.0
    while not counts.all():
        for axis in range(3):
            known, values = counts > 0.0, np.concatenate([sums, counts], axis=3)
            padded = np.pad(values, [(1, 1) if a == axis else (0, 0) for a in range(4)])
            size = values.shape[axis]
            around = padded.take(range(size), axis) + padded.take(range(2, size + 2), axis)
            sums = np.where(known, sums, around[..., :-1])
            counts = np.where(known, counts, around[..., -1:])
            sums, counts = sums / np.maximum(counts, 1e-30), (counts > 0.0).astype(np.float32)
    return sums
