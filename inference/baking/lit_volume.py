# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light: what a volume scatters more than once, as emission on a grid of its own."""

from dataclasses import dataclass, field

import numpy as np

from ..numerics.interpolation import pad_with_zeros, sample_padded
from ..numerics.small_matmul import affine_inverse, product
from ..runtime.report import Report
from .directional_factor import DirectionalFactor
from .lattice import BakeLattice


@dataclass(frozen=True)
class LitVolume:
    """The light that one volume scatters more than once, and what it scatters of its own emission.

    density: float32 (nx, ny, nz), of the volume, 0 in the outermost voxels.
    scattered: float32 (nx, ny, nz, 3), what a density of 1 scatters towards the camera: extinction times albedo times
        the predicted radiance, W/(m^2 sr) per world unit of path length. It is continued beyond the density, so that
        both can be interpolated and then multiplied: light varies little across the edge of a volume, where density
        falls to 0, and interpolating their product would make the edge too bright.
    world_from_index: float64 (4, 4), as in Volume; the grid need not be the volume's.
    directional: what makes other directions right, or None.
    fine: the density in smaller voxels than those in which light is baked, or None. Renderers show it instead.
    name: of the volume.
    report: of the bake, the same for all volumes baked together.
    """

    density: np.ndarray
    scattered: np.ndarray
    world_from_index: np.ndarray
    directional: DirectionalFactor | None = None
    fine: BakeLattice | None = None
    name: str = "volume"
    report: Report = field(default_factory=Report)

    @property
    def emission(self) -> np.ndarray:
        """float32 (nx, ny, nz, 3), radiance per world unit of path length, W/(m^2 sr) per unit, at voxel centres.

        Scattered towards the camera: density times extinction times albedo times the predicted radiance. It is not
        attenuated.
        """
        return self.density[..., None] * self.scattered

    def towards(self, positions: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Emission float32 (N, 3) at world positions (N, 3), for camera rays along unit directions (N, 3)."""
        index, shown = _index(self.world_from_index, positions), self.fine or self
        channels = [sample_padded(pad_with_zeros(self.scattered[..., c]), index) for c in range(3)]
        scattered = np.stack(channels, axis=1)
        if self.directional is not None:
            scattered *= self.directional(positions, directions, scattered.mean(axis=1))
        density = sample_padded(pad_with_zeros(shown.density), _index(shown.world_from_index, positions))
        return scattered * density[:, None]


def _index(world_from_index: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Indices float32 (3, N) of world positions (N, 3)."""
    inverse = affine_inverse(world_from_index)
    index: np.ndarray = (product(positions, inverse[:3, :3].T) + inverse[:3, 3]).T.astype(np.float32)
    return index
