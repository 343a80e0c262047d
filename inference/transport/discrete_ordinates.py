"""Multiple scattering on coarse cells by discrete ordinates: what light does far from where it enters.

Radiance goes from cell to cell of the working cube along 26 directions, those of a cell's neighbours, with the weights of
Lebedev's rule of that order, for albedo 1. What the phase function scatters forward most sharply counts as not scattered
(delta scaling, Wiscombe 1977), so that few directions do for any anisotropy G:

    sigma' = sigma_hat (1 - G^2),    G' = G / (1 + G).

A sweep along all directions gives the fluence phi and the flux F of the light that scatters from the sun's beam and from
phi and F before; its sources are (phi + 3 G' F . u) / (4 pi), and for the beam Henyey and Greenstein's phase function of
G'. What of the fluence is still missing after a sweep follows from a diffusion equation,

    -div(D grad psi) = sigma' (phi_new - phi_old),    D = 1 / (3 sigma_hat (1 - G)) + what cells spread by themselves,

so that a few sweeps do where light scatters a thousand times (diffusion synthetic acceleration). At the cube's faces light
leaves and none comes in. It is coarse, and so not an answer but a hint to the network, which knows what surrounds a point
only in outline.
"""

import numpy as np

from ..grids.optical_depth_sweep import sun_optical_depth
from ..numerics.exponential import one_minus_exp
from ..occluders.cell_boundaries import CellBoundaries
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.phase_function import henyey_greenstein
from .diffusion import THIN, couple, solve

#: Level of the density pyramid that has these cells, and its cells along the cube's edge.
LEVEL, CELLS = 2, 64
# Solid angles of the directions to a cell's neighbours across a face, an edge and a corner, over 4 pi.
WEIGHTS = 1.0 / 21.0, 4.0 / 105.0, 9.0 / 280.0
# Cells an edge from which on light is first followed through cells twice as large; sweeps there and otherwise, at most: they
# end before where less than this share of what scatters has changed.
FINE, ROUNDS, MORE_ROUNDS, ENOUGH = 64, 8, 2, 0.002
# Diffusion's tolerance, and iterations at most; it is solved on cells twice as large.
TOLERANCE, MOST_ITERATIONS = 0.1, 40
# A cell as thick as it may be passes light on to the next as far as if D were this share of its edge.
SPREAD = 0.2
# Optical depths of cells below this count as this.
LEAST_DEPTH = np.float32(1e-6)


def _directions(axis: int):
    """Steps int (D, 3) that rise along an axis and go along none before it, nearest neighbours first."""
    steps = np.array([step for step in np.ndindex(3, 3, 3)]) - 1
    steps = steps[(steps[:, axis] == 1) & (steps[:, :axis] == 0).all(axis=1)]
    return steps[np.argsort(np.abs(steps).sum(axis=1), kind="stable")]


# With their opposites, all 26.
STEPS = [_directions(axis) for axis in range(3)]


def reduced_anisotropy(anisotropy: float) -> float:
    """G' of the phase function without its forward peak."""
    return anisotropy / (1.0 + anisotropy)


class DiscreteOrdinates:
    """Scattering in one medium, for any sun.

    density: float32 (n, n, n), of a level of the pyramid, n being CELLS or half of it; sigma_hat: optical density of the
    cube; anisotropy: G > -1; triangles: (T, 3, 3), in the cube's frame, of black surfaces, or None.
    """

    def __init__(self, density, sigma_hat: float, anisotropy: float, triangles=None):
        n = len(density)
        self.density, self.sigma = density, np.float32(sigma_hat * (1.0 - anisotropy**2))
        self.anisotropy = reduced_anisotropy(anisotropy)
        self.extinction = self.sigma * density
        reduced = np.float32(sigma_hat * (1.0 - anisotropy)) * density
        self.coarser = DiscreteOrdinates(_means(density), sigma_hat, anisotropy, triangles) if n >= FINE else None
        self.spread = 1.0 / (3.0 * reduced + np.float32(THIN)) + np.float32(SPREAD / n)
        spread = 1.0 / (3.0 * _means(reduced) + np.float32(THIN)) + np.float32(SPREAD / n)
        self.boundaries, self.links, boundaries = None, None, None
        if triangles is not None and len(triangles):
            self.boundaries, boundaries = CellBoundaries(triangles, n), CellBoundaries(triangles, n // 2)
            if self.boundaries.empty:
                self.boundaries, boundaries = None, None
            else:
                self.links = [_open_links(self.boundaries, axis) for axis in range(3)]
        self.equation = [values.astype(np.float32) for values in couple(spread.astype(np.float64), 2.0 / n, boundaries)]
        self.passing = self._passing()

    def _passing(self):
        """For each main axis and kind of neighbour: transmittance of cells and the mean of exp(-tau) in them, main axis first."""
        n, kinds = len(self.density), []
        extinction = self.extinction
        if self.boundaries is not None:
            extinction = np.where(self.boundaries.inside, np.float32(n * 1e3), extinction)
        for length in np.sqrt([1.0, 2.0, 3.0]).astype(np.float32) / np.float32(n):
            tau = np.maximum(extinction * length, LEAST_DEPTH)
            lost = one_minus_exp(tau)
            kinds.append((1.0 - lost, lost / tau))
        return [[tuple(np.ascontiguousarray(np.moveaxis(values, axis, 0)) for values in kind)
                 for kind in kinds[: 3 - axis]] for axis in range(3)]

    def light(self, sun, visibility=1.0, cancel: CancelToken = NEVER) -> np.ndarray:
        """Fluence and flux, float32 (4, x, y, z), of what has been scattered of a sun's light of irradiance 1.

        sun: (3,) unit vector in the cube's frame; visibility: (x, y, z), share of its light that surfaces let through.
        Raises Cancelled.
        """
        n = len(self.density)
        tau = self.sigma * sun_optical_depth(self.density, sun, 1.0 / n)
        # The beam's mean over a cell, exact for a beam along an axis.
        half = np.float32(0.5 / n) * self.extinction
        across = np.maximum(2.0 * half, LEAST_DEPTH)
        beam = visibility * np.exp(-np.maximum(tau - half, 0.0)) * one_minus_exp(across) / across
        phases = [self._phases(steps, sun) for steps in STEPS]
        # The rule's sum over all directions need not be exactly 1.
        total = 4.0 * np.pi * sum((_solid_angles(steps) * phase).sum() for steps, pair in zip(STEPS, phases) for phase in pair)
        field = np.zeros((5, n, n, n), np.float32)
        field[4] = beam
        rounds = ROUNDS
        if self.coarser is not None:
            coarse = self.coarser.light(sun, _means(visibility) if np.ndim(visibility) else visibility, cancel)
            field[:4] = [self._finer(values) for values in coarse]
            rounds = MORE_ROUNDS
        for number in range(rounds):
            if self.boundaries is not None:
                field *= ~self.boundaries.inside
            swept = self._sweep(field, phases, total, cancel)
            change = self.extinction * (swept[0] - field[0])
            if self.boundaries is not None:
                change *= ~self.boundaries.inside
            if number == rounds - 1 or np.abs(change).sum() <= ENOUGH * (self.extinction * swept[0]).sum():
                break
            field[:4] = swept
            self._correct(field, change)
        return swept

    def _phases(self, steps, sun):
        """Henyey and Greenstein's phase function of the beam along steps and their opposites, (D,) each."""
        cosine = -(steps @ sun) / np.sqrt((steps**2).sum(axis=1))
        return henyey_greenstein(cosine, self.anisotropy), henyey_greenstein(-cosine, self.anisotropy)

    def _correct(self, field, change):
        """Add what diffusion makes of sources (x, y, z) that the field, (5, x, y, z), has not scattered yet."""
        n = len(self.density)
        source = _means(change) * np.float32((2.0 / n) ** 2)
        more = self._finer(solve(*self.equation, source, -np.inf, TOLERANCE, MOST_ITERATIONS))
        field[0] = np.maximum(field[0] + more, 0.0)
        for axis in range(3):
            field[1 + axis] -= self.spread * np.gradient(more, np.float32(1.0 / n), axis=axis)
        self._limit(field)

    def _finer(self, values):
        """Values on cells twice as large, between their middles, but not across surfaces."""
        return _between(values) if self.boundaries is None else values.repeat(2, 0).repeat(2, 1).repeat(2, 2)

    def _limit(self, field):
        """Flux of a field, (5, x, y, z), such that no source is negative."""
        size = np.sqrt((field[1:4] ** 2).sum(axis=0)) * np.float32(3.0 * abs(self.anisotropy))
        field[1:4] *= np.minimum(field[0] / np.maximum(size, np.float32(1e-30)), 1.0)

    def _sweep(self, field, phases, total, cancel):
        """Fluence and flux (4, x, y, z) of the light that sources of a field (5, x, y, z), phi, F and beam, send out."""
        swept = np.zeros((4, *field.shape[1:]), np.float32)
        for axis, steps in enumerate(STEPS):
            sources = np.ascontiguousarray(np.moveaxis(field, [1 + axis, 0], [0, 1]))
            sums = np.zeros((len(sources), 4, *sources.shape[2:]), np.float32)
            for sign, phase in zip((1, -1), phases[axis]):
                cancel.check()
                links = None if self.links is None else self.links[axis][sign]
                self._follow(axis, sign * steps, phase / total, sources, sums, links)
            swept += np.moveaxis(sums, [1, 0], [0, 1 + axis])
        return swept

    def _follow(self, axis: int, steps, phase, sources, sums, links):
        """Add fluence and flux (slices, 4, b, c) of light along steps (D, 3), all to one side along an axis."""
        n, count = len(sources), len(steps)
        kinds = np.abs(steps).sum(axis=1)
        unit = steps / np.sqrt(kinds)[:, None]
        one = np.ones((count, 1))
        scattered = np.concatenate([one, 3.0 * self.anisotropy * unit], axis=1) / (4.0 * np.pi)
        emit = np.concatenate([scattered, phase[:, None]], axis=1).astype(np.float32)
        gather = (4.0 * np.pi * _solid_angles(steps) * np.concatenate([one, unit], axis=1).T).astype(np.float32)
        of_kind = [(kind - 1, np.flatnonzero(kinds == kind)) for kind in np.unique(kinds)]
        of_kind = [(kind, slice(found[0], found[-1] + 1)) for kind, found in of_kind]
        b, c = (steps[:, other] for other in range(3) if other != axis)
        # Light that leaves the slice before, with a rim of none around it.
        light = np.zeros((count, sources.shape[2] + 2, sources.shape[3] + 2), np.float32)
        before, after = (np.empty((count, *sources.shape[2:]), np.float32) for _ in range(2))
        rows, columns = sources.shape[2:]
        for k in range(n)[:: steps[0, axis]]:
            source = (emit @ sources[k].reshape(5, -1)).reshape(before.shape)
            for d in range(count):
                arriving = light[d, 1 - b[d] : 1 - b[d] + rows, 1 - c[d] : 1 - c[d] + columns]
                if links is not None:
                    arriving = arriving * links[k, d]
                np.subtract(arriving, source[d], out=before[d])
            # In a cell light tends to the source: I = S + (I_0 - S) exp(-tau).
            for kind, which in of_kind:
                transmitted, mean = self.passing[axis][kind]
                np.multiply(before[which], transmitted[k], out=after[which])
                before[which] *= mean[k]
            np.add(after, source, out=light[:, 1:-1, 1:-1])
            before += source
            sums[k] += (gather @ before.reshape(count, -1)).reshape(sums[k].shape)


def _solid_angles(steps):
    """(D,) of steps, over 4 pi."""
    return np.array(WEIGHTS)[np.abs(steps).sum(axis=1) - 1]


def _open_links(boundaries, axis: int):
    """By sign, float32 (slices, D, b, c): 1 where no surface cuts a cell's link to the cell that steps come from, else 0."""
    clear = boundaries.facing == 0.0
    found = {}
    for sign in (1, -1):
        links = []
        for step in sign * STEPS[axis]:
            # From cell to cell along one axis after the other, backwards: what rolls in at a face comes with no light.
            place, link = np.zeros(3, int), np.ones(clear.shape[1:], bool)
            for a in np.flatnonzero(step):
                if step[a] > 0:
                    place[a] -= 1
                link &= np.roll(clear[a], tuple(-place), axis=(0, 1, 2))
                if step[a] < 0:
                    place[a] += 1
            links.append(np.moveaxis(link, axis, 0))
        found[sign] = np.stack(links, axis=1).astype(np.float32)
    return found


def _means(values):
    """Of 2 x 2 x 2 cells each."""
    n = len(values) // 2
    return values.reshape(n, 2, n, 2, n, 2).mean(axis=(1, 3, 5))


def _between(values):
    """Values (x, y, z) on cells half as large, linear between the middles of the large ones."""
    for axis in range(3):
        v = np.moveaxis(np.pad(values, [(int(a == axis),) * 2 for a in range(3)], mode="edge"), axis, 0)
        halves = np.stack([0.25 * v[:-2] + 0.75 * v[1:-1], 0.75 * v[1:-1] + 0.25 * v[2:]], axis=1)
        values = np.moveaxis(halves.reshape(-1, *v.shape[1:]), 0, axis)
    return values
