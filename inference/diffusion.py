"""Fluence in the diffusion approximation: what light does far from where it enters.

A coarse solution of  -div(D grad phi) = source  in the working cube, for albedo 1 and the reduced extinction
s = sigma_hat (1 - G), for which scattering is as if isotropic. D = 1 / (3 s + THIN): in empty space light crosses a
good part of the cube. The source is what the sun's beam, of irradiance 1, loses to scattering. At the cube's
faces light leaves and none comes in (Marshak's condition). Not an answer but a hint to the network, which knows
what surrounds a point only in outline.
"""

from dataclasses import dataclass
from typing import List

import numpy as np

from .transmittance import sun_optical_depth
from .trilinear import between

#: Level of the density pyramid on which the equation is solved, and its cells along the cube's edge.
LEVEL, CELLS = 3, 32
THIN = 2.0
TOLERANCE, MOST_ITERATIONS = 1e-3, 400
#: Added to the fluence before its logarithm.
LEAST = 1e-6


def diffusion_equation(density, tau, reduced: float, lit=1.0, walls=None):
    """Coefficients of the 7-point equation on CELLS^3 cells.

    density: (32, 32, 32) of the level; tau: its optical depth towards the sun for extinction 1; reduced: s; lit:
    (32, 32, 32), share of the beam that surfaces let through; walls: `Walls` that end light, or None.
    Returns diagonal (32, 32, 32), couplings (3, 32, 32, 32) of each cell to the next along each axis,
    and the right-hand side, float64.
    """
    h = 1.0 / CELLS
    extinction = reduced * density.astype(np.float64)
    spread = 1.0 / (3.0 * extinction + THIN)
    # The mean over a cell of what the beam loses, exact for a beam along an axis.
    half = 0.5 * h * extinction
    beam = reduced * tau
    source = h * lit * (np.exp(-np.maximum(beam - half, 0.0)) - np.exp(-(beam + half)))
    return *couple(spread, h, walls), source


def couple(spread, h: float, walls=None):
    """What -div(D grad phi) is on cells of edge h, times h^2: diagonal (x, y, z), and couplings (3, x, y, z).

    spread: D of each cell, float64; walls: where light ends as at the faces of all, or None.
    """
    diagonal, couplings = np.zeros_like(spread), np.zeros((3, *spread.shape))
    for axis in range(3):
        d = np.moveaxis(spread, axis, 0)
        coupling = np.moveaxis(couplings[axis], axis, 0)
        total = np.moveaxis(diagonal, axis, 0)
        # Harmonic means, so that the flux through a face is that through both half cells.
        coupling[:-1] = 2.0 * d[1:] * d[:-1] / (d[1:] + d[:-1])
        if walls is not None:
            walls.end(axis, coupling, total, d, h)
        total += coupling
        total[1:] += coupling[:-1]
        for side in (0, -1):
            total[side] += 0.5 * h / (1.0 + h / (4.0 * d[side]))
    return diagonal, couplings


def _apply(diagonal, couplings, x):
    y = diagonal * x
    for axis in range(3):
        c, u, v = (np.moveaxis(a, axis, 0) for a in (couplings[axis], x, y))
        v[:-1] -= c[:-1] * u[1:]
        v[1:] -= c[:-1] * u[:-1]
    return y


def solve(diagonal, couplings, source, least: float = 0.0):
    """Conjugate gradients with the diagonal as preconditioner; float64 (x, y, z), >= least."""
    x = np.zeros_like(source)
    residual = source.copy()
    z = residual / diagonal
    p, rz = z.copy(), float(np.vdot(residual, z))
    enough = rz * TOLERANCE**2
    for _ in range(MOST_ITERATIONS):
        if rz <= enough:
            break
        ap = _apply(diagonal, couplings, p)
        step = rz / float(np.vdot(p, ap))
        x += step * p
        residual -= step * ap
        z = residual / diagonal
        rz, before = float(np.vdot(residual, z)), rz
        p = z + (rz / before) * p
    return np.maximum(x, least)


def log_fluence(density, sun, reduced: float, lit=1.0, walls=None) -> np.ndarray:
    """log(phi + LEAST), float32 (34, 34, 34): the cells and one more of the same beyond each face.

    density: float32 (32, 32, 32), level 3 of the pyramid; sun: (3,) unit vector; reduced: sigma_hat (1 - G);
    lit, walls: as in `diffusion_equation`.
    """
    tau = sun_optical_depth(density, sun, 1.0 / CELLS).astype(np.float64)
    logs = np.log(solve(*diffusion_equation(density, tau, reduced, lit, walls)) + LEAST)
    if walls is not None:
        logs = walls.spread_inside(logs)
    return np.pad(logs, 1, mode="edge").astype(np.float32)


def probe_points(positions, omega, sun):
    """Where a point's diffusion is read: there, a cell ahead and behind on its ray, and a cell towards the sun.

    positions, omega: (N, 3) in the cube's frame; sun: (3,). Returns continuous indices into what
    `log_fluence` gives, float32 (N, 4, 3).
    """
    h = 1.0 / CELLS
    offsets = np.stack([np.zeros_like(omega), h * omega, -h * omega, np.broadcast_to(h * sun, omega.shape)], axis=1)
    index = (positions[:, None] + offsets + 0.5) * CELLS + 0.5
    return np.clip(index, 0.0, CELLS + 1 - 1e-3).astype(np.float32)


def read_fluence(field, positions, omega, sun) -> np.ndarray:
    """The field's logarithms at the points of `probe_points`: float32 (N, 4), trilinear."""
    index = np.ascontiguousarray(np.moveaxis(probe_points(positions, omega, sun), 2, 0))
    cell = index.astype(np.int32)
    fx, fy, fz = index - cell
    n = field.shape[0]
    base, flat = (cell[0] * np.intp(n) + cell[1]) * n + cell[2], field.reshape(-1)

    def edge(offset):
        return between(flat[offset:].take(base), flat[offset + 1 :].take(base), fz)

    return between(between(edge(0), edge(n), fy), between(edge(n * n), edge(n * n + n), fy), fx)


def finer(field) -> np.ndarray:
    """The fluence float32 (64, 64, 64), for looking up the nearest cell, from what `log_fluence` gives."""
    for axis in range(3):
        f = np.moveaxis(field, axis, 0)
        halves = np.stack([0.25 * f[:-2] + 0.75 * f[1:-1], 0.75 * f[1:-1] + 0.25 * f[2:]], axis=1)
        field = np.moveaxis(halves.reshape(-1, *f.shape[1:]), 0, axis)
    return np.exp(field)


@dataclass
class DiffusedLight:
    """The fluence of each sun in one volume, for camera rays to look up on their way.

    linear: (3, 3) and offset: (3,), indices from world positions. fluences: a (64, 64, 64) of `finer` for each sun.
    """

    linear: np.ndarray
    offset: np.ndarray
    fluences: List[np.ndarray]

    @classmethod
    def in_cube(cls, cube, fluences):
        """In the working cube of a volume."""
        cells = 2 * CELLS
        linear = cube.rotation.T * (cells / cube.edge)
        return cls(linear, 0.5 * cells - linear @ cube.centre, fluences)

    def cells(self, index) -> np.ndarray:
        """Flat offsets (N,) into the fluences of indices float32 (3, N)."""
        x, y, z = np.clip(index, np.float32(0.0), np.float32(2 * CELLS - 1)).astype(np.int32)
        return (x * np.intp(2 * CELLS) + y) * np.intp(2 * CELLS) + z
