"""Features mu, S and P at the stencil's points around each x."""

import numpy as np

from .fields import Lattices
from .phase import PhaseFeatures
from .stencil import LOW_POINTS, POINTS, Stencil, frames

# Points looked up together, so that what is made on the way stays in the cache, and products are small (`products.py`).
POINTS_A_STEP = 192


def stencil_points(stencil: Stencil, positions, omega, sun) -> np.ndarray:
    """The stencil around each position: float32 (N, 192, 3) in the cube's frame.

    positions: (N, 3); omega: (N, 3) camera-ray directions; sun: (3,) unit vector.
    """
    points = np.empty((len(positions), POINTS, 3), np.float32)
    rotation = frames(omega, sun).astype(np.float32)
    np.matmul(stencil.low, rotation.transpose(0, 2, 1), out=points[:, :LOW_POINTS])
    points[:, LOW_POINTS:] = stencil.high[:, None] * sun.astype(np.float32)
    points += positions[:, None].astype(np.float32)
    return points


def _columns(stencil: Stencil, lattices: Lattices):
    """Of each of the 192 points: fine cells per cube edge, origin in fine cells, strides, and where its mip begins."""
    levels = [lattices.levels[m] for m in stencil.mips]
    scale = np.array([level.scale for level in levels], np.float32)
    origin = np.array([level.origin * level.scale for level in levels], np.float32)
    stride = np.array([level.packed.strides for level in levels], np.int32).T // lattices.values.itemsize
    sizes = np.array([level.packed.size for level in lattices.levels])
    begin = (np.cumsum(sizes) - sizes)[stencil.mips] - (stride * np.array([level.first for level in levels]).T).sum(axis=0)
    return scale, origin, stride, begin.astype(np.int32)


def read_fields(stencil: Stencil, lattices: Lattices, positions, omega, sun, mu, transmittance, jitter=None):
    """Fill mu and transmittance, float32 (N, 192), with the features mu and S of points.

    positions, omega: float (N, 3) in the cube's frame; sun: (3,) unit vector. jitter: (N, 3) in
    [-1/2, 1/2), by which lookups of each point are moved, in fine cells; none by default.
    Averaged over jitter, the nearest cell is linear interpolation, and cells leave no bands.
    """
    sun = np.asarray(sun, np.float64)
    jitter = np.zeros((len(positions), 3), np.float32) if jitter is None else jitter
    scale, origin, stride, begin = _columns(stencil, lattices)
    # Fine cells are linear in a point's position, its frame and its jitter: one product an axis gives all 192.
    terms = np.zeros((6, POINTS), np.float32)
    terms[0] = scale
    terms[1:4, :LOW_POINTS] = stencil.low.T * scale[:LOW_POINTS]
    terms[4] = 1.0
    towards = np.zeros(POINTS, np.float32)
    towards[LOW_POINTS:] = stencil.high * scale[LOW_POINTS:]
    point = np.ones((3, len(positions), 6), np.float32)
    point[..., 0], point[..., 4] = positions.T, jitter.T
    first, view = distinct_rows(omega)
    point[..., 1:4] = frames(omega[first], sun).transpose(1, 0, 2)[:, view]
    constant = [np.float32(component) * towards - origin for component in sun]
    for start in range(0, len(positions), POINTS_A_STEP):
        span = slice(start, start + POINTS_A_STEP)
        index = begin
        for axis in range(3):
            terms[5] = constant[axis]
            cell = (point[axis, span] @ terms).astype(np.int32)
            cell *= stride[axis]
            cell += index
            index = cell
        lattices.read(index, mu[span], transmittance[span])


def distinct_rows(rows):
    """Of rows (N, k) those that differ from the one before: their numbers (V,), and which of them each row is, int32 (N,)."""
    new = np.ones(len(rows), bool)
    new[1:] = (rows[1:] != rows[:-1]).any(axis=1)
    return np.flatnonzero(new), np.cumsum(new, dtype=np.int32) - np.int32(1)


def angle_to_sun(omega, sun) -> np.ndarray:
    """gamma float32 (N,): the angle between camera rays (N, 3) and the direction towards the sun (3,)."""
    cosine = np.asarray(omega, np.float64) @ np.asarray(sun, np.float64)
    return np.arccos(np.clip(cosine, -1.0, 1.0)).astype(np.float32)


def describe(stencil: Stencil, lattices: Lattices, phase: PhaseFeatures, positions, omega, sun, jitter=None):
    """Descriptors of points for one sun, as the paper's networks read them.

    Arguments as for `read_fields`. Returns features float32 (3, N, 192) in the order mu, S, P, and
    gamma float32 (N,).
    """
    features = np.empty((3, len(positions), POINTS), np.float32)
    read_fields(stencil, lattices, positions, omega, sun, features[0], features[1], jitter)
    gamma = angle_to_sun(omega, sun)
    features[2] = phase(gamma)
    return features, gamma
