"""Features mu, S and P at the stencil's points around each x."""

from typing import List

import numpy as np

from .fields import Lattice
from .phase import PhaseFeatures
from .stencil import LOW_POINTS, MIPS, POINTS, Stencil, frames


def _lookup(lattice: Lattice, points: np.ndarray, jitter) -> np.ndarray:
    """Nearest fine cell of points (N, k, 3) in the cube's frame, moved by jitter (N, 3) cells: complex64 (N, k)."""
    _, ny, nz = lattice.packed.shape
    cell = points * np.float32(lattice.scale)
    cell += (jitter - np.float32(lattice.origin * lattice.scale))[:, None]
    cell = cell.astype(np.int32)
    index = (cell[..., 0] * ny + cell[..., 1]) * nz + cell[..., 2]
    index -= (lattice.first[0] * ny + lattice.first[1]) * nz + lattice.first[2]
    # The lattice holds every cell that a stencil can read; clipping costs less than checking.
    return lattice.packed.reshape(-1).take(index, mode="clip")


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


def read_fields(stencil: Stencil, lattices: List[Lattice], positions, omega, sun, mu, transmittance, jitter=None):
    """Fill mu and transmittance, float32 (N, 192), with the features mu and S of points.

    positions, omega: float (N, 3) in the cube's frame; sun: (3,) unit vector. jitter: (N, 3) in
    [-1/2, 1/2), by which lookups of each point are moved, in fine cells; none by default.
    Averaged over jitter, the nearest cell is linear interpolation, and cells leave no bands.
    """
    points = stencil_points(stencil, positions, omega, np.asarray(sun, np.float64))
    jitter = np.zeros((len(positions), 3), np.float32) if jitter is None else np.asarray(jitter, np.float32)
    for m in range(MIPS):
        columns = np.flatnonzero(stencil.mips == m)
        # A mip's points are one run of the low-frequency part and perhaps one of the high-frequency part.
        for run in np.split(columns, np.flatnonzero(np.diff(columns) > 1) + 1):
            span = slice(run[0], run[-1] + 1)
            values = _lookup(lattices[m], points[:, span], jitter)
            mu[:, span] = values.real
            transmittance[:, span] = values.imag


def angle_to_sun(omega, sun) -> np.ndarray:
    """gamma float32 (N,): the angle between camera rays (N, 3) and the direction towards the sun (3,)."""
    cosine = np.asarray(omega, np.float64) @ np.asarray(sun, np.float64)
    return np.arccos(np.clip(cosine, -1.0, 1.0)).astype(np.float32)


def describe(stencil: Stencil, lattices: List[Lattice], phase: PhaseFeatures, positions, omega, sun, jitter=None):
    """Descriptors of points for one sun, as the paper's networks read them.

    Arguments as for `read_fields`. Returns features float32 (3, N, 192) in the order mu, S, P, and
    gamma float32 (N,).
    """
    features = np.empty((3, len(positions), POINTS), np.float32)
    read_fields(stencil, lattices, positions, omega, sun, features[0], features[1], jitter)
    gamma = angle_to_sun(omega, sun)
    features[2] = phase(gamma)
    return features, gamma
