"""Light that volumes emit, scattered by them.

Radiance is sweep_radiance along directions over coarse cells, with scattering reduced to sigma_s' = sigma_s (1 - G), as if it
were isotropic. First what was not scattered; then, a few times, all that is scattered by the fluence phi so far. What a
sweep leaves missing of the fluence follows from a diffusion equation,

    -div(D grad psi) + sigma_a psi = sigma_s' (phi_new - phi_old),    D = 1 / (3 sigma_tr),    sigma_tr = sigma_a + sigma_s',

so that three sweeps do where light scatters a hundred times (diffusion synthetic acceleration). Of the radiance its
fluence phi and flux J are kept, and what a point scatters towards the camera, along -omega, is

    albedo / (4 pi) (phi - 3 G J . omega).
"""


import numpy as np

from ..grids.merge import resampled
from ..numerics.interpolation import sample_padded
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.description import Medium
from .diffusion import THIN, couple, solve
from .radiance_sweep import sweep_radiance

# Cells along the longest edge of the box around the volumes.
CELLS = 32
# Directions along an edge of each face of a cube: of what was not scattered, which is sharper, and of what was.
DIRECT, SCATTERED = 6, 4
ROUNDS = 3
# Reduced optical depth of a cell above which light changes within cells.
THICK = 1.0


class ScatteredEmission:
    """Fluence and flux of the light that some volumes emit, in three colour channels.

    grids: a Grid of each; media: of each. thickest: the largest reduced optical depth of a cell.
    """

    def __init__(self, grids, media: list[Medium], cancel: CancelToken = NEVER):
        corners = np.concatenate([grid.corners() for grid in grids])
        low, high = corners.min(axis=0), corners.max(axis=0)
        self.edge = float((high - low).max())
        self.cell, self.thickest = self.edge / CELLS, 0.0
        shape = np.maximum(np.ceil((high - low) / self.cell - 1e-6), 1).astype(int)
        self.first = 0.5 * (low + high) - 0.5 * (shape - 1) * self.cell
        frame = np.diag([*[self.cell] * 3, 1.0])
        frame[:3, 3] = self.first
        densities = [resampled(grid, grid.sample_density, frame, shape, cancel).astype(np.float64) for grid in grids]
        solved, self.fields = [], []
        for c in range(3):
            extinction = sum(m.sigma_t[c] * values for m, values in zip(media, densities))
            scatter = sum(m.sigma_t[c] * m.albedo[c] * values for m, values in zip(media, densities))
            reduced = sum(m.sigma_t[c] * m.albedo[c] * (1.0 - m.anisotropy) * values for m, values in zip(media, densities))
            emission = np.zeros(shape)
            for grid, medium in zip(grids, media):
                if grid.emission:
                    emission += medium.emission * resampled(
                        grid, lambda index, grid=grid: grid.sample_emission(c, index), frame, shape, cancel)
            self.fields.append(self._field(solved, np.maximum(extinction - scatter, 0.0), reduced, emission, cancel))

    def _field(self, solved, absorption, reduced, emission, cancel):
        """Fluence and flux, (4, ...) padded for `sample_padded`, or None where nothing is scattered.

        solved: what was solved before; light is linear in what is emitted.
        """
        total = emission.sum()
        if not total > 0.0 or not reduced.any():
            return None
        asked = absorption, reduced, emission / total
        found = next((field for terms, field in solved if all(map(_close, terms, asked))), None)
        if found is None:
            found = self._solve(*asked, cancel)
            solved.append((asked, found))
        return found * np.float32(total)

    def _solve(self, absorption, reduced, emission, cancel):
        extinction = absorption + reduced
        self.thickest = max(self.thickest, self.cell * extinction.max())
        spread = 1.0 / (3.0 * extinction + THIN / self.edge)
        diagonal, couplings = couple(spread, self.cell)
        diagonal += absorption * self.cell**2
        direct, direct_flux = sweep_radiance(extinction, emission, self.cell, DIRECT, cancel)
        # Before the first round nothing but the direct light has scattered.
        scattered, flux, missing = np.zeros_like(direct), np.zeros_like(direct_flux), direct
        for number in range(ROUNDS):
            if number:
                source = reduced * (direct + scattered) / (4.0 * np.pi)
                before = scattered
                scattered, flux = sweep_radiance(extinction, source, self.cell, SCATTERED, cancel)
                missing = scattered - before
            more = solve(diagonal, couplings, reduced * missing * self.cell**2, -np.inf)
            scattered = scattered + more
            for axis in range(3):
                if more.shape[axis] > 1:
                    flux[axis] -= spread * np.gradient(more, self.cell, axis=axis)
        fluence, flux = np.maximum(direct + scattered, 0.0), direct_flux + flux
        # No flux is larger than that of all light in one direction, but diffusion's may be.
        flux *= np.minimum(fluence / np.maximum(np.linalg.norm(flux, axis=0), 1e-30), 1.0)
        # Beyond the outermost cells' middles all is as there.
        field = np.concatenate([fluence[None], flux])
        return np.pad(field, [(0, 0), (1, 2), (1, 2), (1, 2)], mode="edge").astype(np.float32)

    def warnings(self, name: str) -> list[str]:
        if self.thickest < THICK:
            return []
        return [f"{name}: light that it emits and scatters is less accurate in smoke as dense as this, with an optical "
                f"depth of {self.thickest:.2g} in a {CELLS}th of its size"]

    def scattered(self, c: int, positions, directions, anisotropy: float) -> np.ndarray:
        """Radiance (N,) in colour c that an albedo of 1 scatters at world positions (N, 3) against rays along (N, 3)."""
        if self.fields[c] is None:
            return np.zeros(len(positions), np.float32)
        index = ((positions - self.first) / self.cell).T.astype(np.float32)
        fluence, *flux = (sample_padded(values, index) for values in self.fields[c])
        along = sum(part * directions[:, axis] for axis, part in enumerate(flux))
        return np.maximum(fluence - 3.0 * anisotropy * along, 0.0) / (4.0 * np.pi)


def _close(a, b) -> bool:
    return np.allclose(a, b, rtol=1e-4, atol=1e-6 * b.max())
