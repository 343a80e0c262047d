"""What a render is asked for: volumes, media, lights and surfaces.

Lengths are in world units, extinction in 1/world unit, irradiance in W/m^2, radiance in W/(m^2 sr). Arrays are float32
unless stated otherwise; nothing here knows Blender.
"""

from dataclasses import dataclass

import numpy as np

from .errors import SceneError
from .phase_function import PhaseFunction, henyey_greenstein
from .sparse_grid import SparseGrid
from .validation import affine_matrix, rgb_triple

# Cycles' own limit: the phase function degenerates at -1 and 1.
ANISOTROPY_MOST = 0.999
# Brighter light would not fit the image's single precision where the phase function peaks.
IRRADIANCE_MOST = 1e30


@dataclass
class Volume:
    """A density grid placed in the world.

    density: float32 (nx, ny, nz) or SparseGrid, value at voxel centres, trilinear in between,
        0 outside the grid.
    world_from_index: float64 (4, 4) affine; voxel (i, j, k) has its centre at
        world_from_index @ (i, j, k, 1).
    name: used in messages.
    emission: float32 (nx, ny, nz, 3), radiance that a world unit of the way through it adds, in
        W/(m^2 sr) a unit, interpolated as the density and wanted whether there is any; or None. Three SparseGrids, one a
        channel, with the density's blocks where that is a SparseGrid.
    emission_power: what the emission is raised to once it is interpolated, its sign kept: blackbodies whose temperature is
        interpolated are given by the fourth root.

    Raises SceneError for an empty or non-finite grid, negative density, or a
    singular transform.
    """

    density: np.ndarray | SparseGrid
    world_from_index: np.ndarray
    name: str = "volume"
    emission: None | np.ndarray | tuple[SparseGrid, SparseGrid, SparseGrid] = None
    emission_power: int = 1

    def __post_init__(self):
        if not isinstance(self.density, SparseGrid):
            self.density = np.ascontiguousarray(self.density, dtype=np.float32)
            if self.density.ndim != 3 or self.density.size == 0:
                raise SceneError(f"{self.name}: density must be a 3D grid with at least one voxel")
        low, high = float(self.density.min()), float(self.density.max())
        if not (np.isfinite(low) and np.isfinite(high)):
            raise SceneError(f"{self.name}: density holds NaN or infinite values")
        if low < 0.0:
            raise SceneError(f"{self.name}: density holds negative values (lowest {low:g})")
        self.world_from_index = affine_matrix(self.world_from_index, f"{self.name}: transform")
        if self.emission is not None:
            self._check_emission()

    def _check_emission(self):
        if isinstance(self.density, SparseGrid):
            matches = len(self.emission) == 3 and all(channel.table is self.density.table for channel in self.emission)
        else:
            self.emission = np.asarray(self.emission, dtype=np.float32)
            matches = self.emission.shape == (*self.density.shape, 3)
        if not matches:
            raise SceneError(f"{self.name}: emission must have the density's shape and three channels")
        if not all(np.isfinite(channel.min() + channel.max()) for channel in self.emission_channels()):
            raise SceneError(f"{self.name}: emission holds NaN or infinite values")

    def same_content(self, other: "Volume") -> bool:
        """Whether both hold the same density and emission in the same place, whatever their names."""
        mine, theirs = [self.density, *self.emission_channels()], [other.density, *other.emission_channels()]
        return (np.array_equal(self.world_from_index, other.world_from_index)
                and self.emission_power == other.emission_power and len(mine) == len(theirs)
                and all(map(_same_grid, mine, theirs)))

    def emission_channels(self):
        """Three grids as the density is one, or none."""
        if self.emission is None:
            return []
        return list(self.emission) if isinstance(self.density, SparseGrid) else list(np.moveaxis(self.emission, 3, 0))


def _same_grid(a, b) -> bool:
    return a is b or (a.equals(b) if isinstance(a, SparseGrid) else np.array_equal(a, b))


@dataclass
class Medium:
    """How the density scatters.

    sigma_t: extinction per unit density per world unit, scalar or RGB, >= 0.
    albedo: single-scattering albedo, scalar or RGB, in [0, 1].
    anisotropy: mean cosine of the Henyey-Greenstein phase function, in [-0.999, 0.999].
    emission: what the volume's emission is multiplied by, >= 0.
    phase: what light that is scattered once follows; None is Henyey and Greenstein's. More scattering knows its mean
        cosine alone, the anisotropy.

    Raises SceneError outside these ranges.
    """

    sigma_t: np.ndarray
    albedo: np.ndarray = 1.0
    anisotropy: float = 0.0
    emission: float = 1.0
    phase: PhaseFunction | None = None

    def __post_init__(self):
        self.sigma_t = rgb_triple(self.sigma_t, "extinction")
        self.albedo = rgb_triple(self.albedo, "albedo")
        self.anisotropy = float(self.anisotropy)
        if np.any(self.sigma_t < 0.0):
            raise SceneError(f"extinction must not be negative: {self.sigma_t.tolist()}")
        if np.any(self.albedo < 0.0) or np.any(self.albedo > 1.0):
            raise SceneError(f"albedo must lie in [0, 1]: {self.albedo.tolist()}")
        if not abs(self.anisotropy) <= ANISOTROPY_MOST:
            raise SceneError(f"anisotropy must lie between -{ANISOTROPY_MOST} and {ANISOTROPY_MOST}, "
                             f"not {self.anisotropy:g}")
        if not 0.0 <= self.emission < np.inf:
            raise SceneError(f"the factor of emission must be finite and not negative, not {self.emission:g}")

    def same_coefficients(self, other: "Medium") -> bool:
        """Whether extinction, albedo, anisotropy and emission are the same, whatever the phase function."""
        return (np.array_equal(self.sigma_t, other.sigma_t) and np.array_equal(self.albedo, other.albedo)
                and self.anisotropy == other.anisotropy and self.emission == other.emission)

    def scattered(self, cosine):
        """Phase function, 1/sr, of light scattered once, at cosines between the directions before and after it."""
        return self.phase(cosine) if self.phase else henyey_greenstein(cosine, self.anisotropy)


@dataclass
class Sun:
    """Parallel light.

    direction: (3,) world vector towards the sun; normalised here.
    irradiance: W/m^2 on a surface that faces the sun, scalar or RGB, in [0, 1e30].
    spread: where the light comes from if not from one direction: unit vectors (K, 3) and shares (K,) that sum to 1.
        Scattered, it goes about where it would go from there; its shadows are those of `direction`.

    Raises SceneError for a zero direction or negative irradiance.
    """

    direction: np.ndarray
    irradiance: np.ndarray = 1.0
    name: str = "sun"
    spread: tuple[np.ndarray, np.ndarray] | None = None

    def __post_init__(self):
        direction = np.asarray(self.direction, dtype=np.float64)
        length = np.linalg.norm(direction) if direction.shape == (3,) else np.nan
        if not np.isfinite(length) or length == 0.0:
            raise SceneError(f"{self.name}: direction must be three finite numbers, not all zero")
        self.direction = direction / length
        self.irradiance = rgb_triple(self.irradiance, f"{self.name}: irradiance")
        if np.any(self.irradiance < 0.0) or np.any(self.irradiance > IRRADIANCE_MOST):
            raise SceneError(f"{self.name}: irradiance must not be negative or above {IRRADIANCE_MOST:g}")


@dataclass
class Surface:
    """triangles: float64 (T, 3, 3) corners in the world. name: for messages. covers: whether camera rays end there.
    shades: whether it keeps suns from volumes. stops: whether light that volumes scatter ends there.

    Raises SceneError where they are not finite.
    """

    triangles: np.ndarray
    name: str = "surface"
    covers: bool = True
    shades: bool = True
    stops: bool = True

    def __post_init__(self):
        self.triangles = np.asarray(self.triangles, np.float64).reshape(-1, 3, 3)
        if not np.isfinite(self.triangles).all():
            raise SceneError(f"{self.name}: its vertices hold NaN or infinite values")
