# SPDX-License-Identifier: GPL-3.0-or-later
"""Description of a scene: volumes, media, lights and surfaces.

Lengths are in world units, extinction in 1/world unit, irradiance in W/m^2, radiance in W/(m^2 sr). Arrays are float32
unless stated otherwise.
"""

import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from .errors import SceneError
from .light import Families, Light
from .phase_function import PhaseFunction, henyey_greenstein
from .sparse_grid import SparseGrid

# The limit that Cycles has: the phase function degenerates at -1 and 1.
MAX_ANISOTROPY = 0.999
# Voxels of one quantity.
Voxels = np.ndarray | SparseGrid
# Suns within this angle of each other, in radians, count as parallel.
PARALLEL_ANGLE = 1e-6
# Brighter light overflows single precision where the phase function peaks.
MAX_IRRADIANCE = 1e30


def rgb_triple(value: ArrayLike, name: str) -> np.ndarray:
    """One number or three as float64 (3,). Raises SceneError for other shapes and for values that are not finite."""
    rgb = np.asarray(value, dtype=np.float64)
    if rgb.shape not in ((), (1,), (3,)):
        raise SceneError(f"{name} must be one number or three, not shape {rgb.shape}")
    rgb = np.broadcast_to(rgb, (3,)).copy()
    if not np.all(np.isfinite(rgb)):
        raise SceneError(f"{name} must be finite, not {rgb.tolist()}")
    return rgb


def affine_matrix(matrix: ArrayLike, name: str) -> np.ndarray:
    """A matrix as float64 (4, 4). Raises SceneError unless it is finite and invertible."""
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.all(np.isfinite(matrix)):
        raise SceneError(f"{name} must be a finite 4x4 matrix")
    if abs(np.linalg.det(matrix[:3, :3])) == 0.0:
        raise SceneError(f"{name} is singular: the object is scaled to nothing")
    return matrix


@dataclass(frozen=True)
class Motion:
    """How an object moves while the camera's shutter is open.

    world_matrices: float64 (S, 4, 4) object to world, at S > 1 evenly spaced times from opening to closing.
    world_matrix: (4, 4), the same where the object is described.

    Raises SceneError for singular transforms, and for a single one.
    """

    world_matrices: np.ndarray
    world_matrix: np.ndarray

    def __post_init__(self) -> None:
        if len(self.world_matrices) < 2:
            raise SceneError("motion needs transforms at two times or more")
        matrices = [affine_matrix(matrix, "motion: transform") for matrix in self.world_matrices]
        object.__setattr__(self, "world_matrices", np.array(matrices))
        object.__setattr__(self, "world_matrix", affine_matrix(self.world_matrix, "motion: transform"))


@dataclass(frozen=True)
class Velocity:
    """Velocities that carry what a volume holds while the camera's shutter is open.

    At a time t since the frame, a place shows what the volume has at the frame at that place less t times the velocity.
    That velocity is looked up in the same way where the velocity at the place itself leads back to, as in Cycles.

    components: x, y and z of the velocity in the volume's own space, on voxels of their own: three arrays float32
        (nx, ny, nz) or three SparseGrids; trilinear in between, 0 outside.
    world_from_index: float64 (4, 4), of these voxels, as of Volume.
    world_from_velocity: float64 (3, 3), turns velocities into world units per unit of time.
    times: since the frame, at which the shutter opens and closes, in that unit.

    Raises SceneError for grids that are not three or not finite, for singular transforms and for infinite times.
    """

    components: tuple[Voxels, ...]
    world_from_index: np.ndarray
    world_from_velocity: np.ndarray
    times: tuple[float, float]

    def __post_init__(self) -> None:
        grids = tuple(
            grid if isinstance(grid, SparseGrid) else np.ascontiguousarray(grid, np.float32) for grid in self.components
        )
        if len(grids) != 3 or any(len(grid.shape) != 3 or 0 in grid.shape for grid in grids):
            raise SceneError("velocity must be three 3D grids")
        if not all(np.isfinite(float(grid.min()) + float(grid.max())) for grid in grids):
            raise SceneError("velocity holds NaN or infinite values")
        matrix = np.asarray(self.world_from_velocity, np.float64)
        if matrix.shape != (3, 3) or not np.isfinite(matrix).all() or not np.isfinite(self.times).all():
            raise SceneError("velocity needs a finite 3x3 matrix and finite times")
        object.__setattr__(self, "components", grids)
        object.__setattr__(self, "world_from_index", affine_matrix(self.world_from_index, "velocity: transform"))
        object.__setattr__(self, "world_from_velocity", matrix)


@dataclass
class Volume:
    """A density grid placed in the world.

    density: float32 (nx, ny, nz) or SparseGrid; values at voxel centres, trilinear in between, 0 outside the grid.
    world_from_index: float64 (4, 4) affine transform; the centre of voxel (i, j, k) is world_from_index @ (i, j, k, 1).
    name: for messages.
    emission: emitted radiance per world unit of path length, W/(m^2 sr) per unit, interpolated like the density and
        independent of it: float32 (nx, ny, nz, 3), or three SparseGrids with the blocks of a sparse density, or None.
    emission_power: exponent applied to the interpolated emission, keeping its sign. Blackbodies whose temperature is
        interpolated store the fourth root of their emission.
    scattering: density times albedo of a medium whose albedo varies, interpolated like the density: one grid for all
        colour channels or three, of the density's kind; None for a uniform albedo. Set by `plan.plan.in_range`.
    motion: in the camera's shutter; None for a volume that stands still. velocity: of what it holds, or None.

    peak: largest density. filled: mean density where matter is, weighted by density.

    Volumes that hold the very same arrays are instances: what a render derives from their voxels is made once.

    Raises SceneError for an empty or non-finite grid, negative density, or a singular transform.
    """

    density: np.ndarray | SparseGrid
    world_from_index: np.ndarray
    name: str = "volume"
    emission: None | np.ndarray | tuple[SparseGrid, ...] = None
    emission_power: int = 1
    scattering: None | tuple[Voxels, ...] = None
    motion: Motion | None = None
    velocity: Velocity | None = None
    peak: float = field(init=False, default=0.0)
    filled: float = field(init=False, default=0.0)

    def __post_init__(self) -> None:
        if not isinstance(self.density, SparseGrid):
            self.density = np.ascontiguousarray(self.density, dtype=np.float32)
            if self.density.ndim != 3 or self.density.size == 0:
                raise SceneError(f"{self.name}: density must be a 3D grid with at least one voxel")
        low, high = float(self.density.min()), float(self.density.max())
        if not (np.isfinite(low) and np.isfinite(high)):
            raise SceneError(f"{self.name}: density holds NaN or infinite values")
        if low < 0.0:
            raise SceneError(f"{self.name}: density holds negative values (lowest {low:g})")
        self.peak, self.filled = high, _weighted_mean(self.density, high)
        self.world_from_index = affine_matrix(self.world_from_index, f"{self.name}: transform")
        if self.emission is not None:
            self._check_emission()

    def _check_emission(self) -> None:
        if isinstance(self.density, SparseGrid):
            channels = [channel for channel in self.emission or () if isinstance(channel, SparseGrid)]
            matches = len(channels) == 3 and all(channel.table is self.density.table for channel in channels)
        else:
            self.emission = np.asarray(self.emission, dtype=np.float32)
            matches = self.emission.shape == (*self.density.shape, 3)
        if not matches:
            raise SceneError(f"{self.name}: emission must have the density's shape and three channels")
        if not all(np.isfinite(channel.min() + channel.max()) for channel in self.emission_channels()):
            raise SceneError(f"{self.name}: emission holds NaN or infinite values")

    def instance(self, world_from_index: np.ndarray, name: str) -> "Volume":
        """The same voxels, which are not checked again, at another place.

        Raises SceneError for a singular transform.
        """
        found = copy.copy(self)
        found.world_from_index, found.name = affine_matrix(world_from_index, f"{name}: transform"), name
        return found

    @property
    def voxels_key(self) -> tuple[int, ...]:
        """Equal for volumes that hold the very same arrays, as long as these live."""
        emission = self.emission if isinstance(self.emission, tuple) else (self.emission,)
        return self.emission_power, *(id(grid) for grid in (self.density, *emission, *(self.scattering or ())))

    def same_content(self, other: "Volume") -> bool:
        """Whether two volumes hold equal grids at the same position, whatever their names."""
        mine: list[Voxels] = [self.density, *self.emission_channels(), *(self.scattering or ())]
        theirs: list[Voxels] = [other.density, *other.emission_channels(), *(other.scattering or ())]
        return (
            np.array_equal(self.world_from_index, other.world_from_index)
            and self.emission_power == other.emission_power
            and (self.emission is None) == (other.emission is None)
            and len(mine) == len(theirs)
            and all(map(_same_grid, mine, theirs))
        )

    def emission_channels(self) -> list[np.ndarray] | list[SparseGrid]:
        """The emission per colour channel: three grids of the density's kind, or none."""
        if self.emission is None:
            return []
        return list(np.moveaxis(self.emission, 3, 0)) if isinstance(self.emission, np.ndarray) else list(self.emission)

    def scattering_of(self, channel: int) -> Voxels | None:
        """Density times albedo in a colour channel; None for a uniform albedo."""
        return None if self.scattering is None else self.scattering[channel if len(self.scattering) == 3 else 0]


def _weighted_mean(density: Voxels, peak: float) -> float:
    """Mean of a density, weighted by itself; the peak where squares leave the range of numbers."""
    values = (density.values if isinstance(density, SparseGrid) else density).ravel()
    with np.errstate(over="ignore", under="ignore", invalid="ignore"):
        square, total = float(np.dot(values, values)), float(values.sum())
    found = square / total if total > 0.0 else 0.0
    return found if 0.0 < found <= peak else peak


def _same_grid(a: Voxels, b: Voxels) -> bool:
    if a is b:
        return True
    if isinstance(a, SparseGrid) or isinstance(b, SparseGrid):
        return isinstance(a, SparseGrid) and a.equals(b)
    return np.array_equal(a, b)


@dataclass
class Medium:
    """How the density of a volume scatters light.

    sigma_t: extinction coefficient per unit density and world unit, scalar or RGB, >= 0; float64 (3,) once made.
    albedo: single-scattering albedo in [0, 1]: scalar or RGB, float64 (3,) once made. An albedo that varies in space is
        on the density's voxels: float32 (nx, ny, nz) or (nx, ny, nz, 3), or one or three SparseGrids with the blocks of
        a sparse density; a tuple of one or three grids once made. Its product with the density is interpolated.
    anisotropy: mean cosine of the phase function, in [-0.999, 0.999].
    emission: factor of the volume's emission, >= 0.
    phase: phase function of single scattering, None for Henyey-Greenstein. Multiple scattering depends on the mean
        cosine alone.
    holdout: whether what it takes of light counts as none of the layer's opacity, so that it leaves a hole. Its albedo
        and its emission are to be 0.

    Raises SceneError outside these ranges.
    """

    sigma_t: np.ndarray
    albedo: Any = field(default_factory=lambda: np.ones(3))
    anisotropy: float = 0.0
    emission: float = 1.0
    phase: PhaseFunction | None = None
    holdout: bool = False

    def __post_init__(self) -> None:
        self.sigma_t = rgb_triple(self.sigma_t, "extinction")
        self.albedo = _albedo_grids(self.albedo) or rgb_triple(self.albedo, "albedo")
        self.anisotropy = float(self.anisotropy)
        if np.any(self.sigma_t < 0.0):
            raise SceneError(f"extinction must not be negative: {self.sigma_t.tolist()}")
        if not self.varies and (np.any(self.albedo < 0.0) or np.any(self.albedo > 1.0)):
            raise SceneError(f"albedo must lie in [0, 1]: {self.albedo.tolist()}")
        if not abs(self.anisotropy) <= MAX_ANISOTROPY:
            raise SceneError(
                f"anisotropy must lie between -{MAX_ANISOTROPY} and {MAX_ANISOTROPY}, not {self.anisotropy:g}"
            )
        if not 0.0 <= self.emission < np.inf:
            raise SceneError(f"emission must be finite and not negative, not {self.emission:g}")

    @property
    def varies(self) -> bool:
        """Whether the albedo varies in space."""
        return isinstance(self.albedo, tuple)

    @property
    def scatters(self) -> bool:
        """Whether the albedo is above 0 anywhere."""
        return any(grid.any() for grid in self.albedo) if self.varies else bool(np.any(self.albedo > 0.0))

    def same_coefficients(self, other: "Medium") -> bool:
        """Whether extinction, albedo, anisotropy and emission are equal, whatever the phase functions."""
        if self.varies or other.varies:
            same_albedo = (
                self.varies
                and other.varies
                and len(self.albedo) == len(other.albedo)
                and all(map(_same_grid, self.albedo, other.albedo))
            )
        else:
            same_albedo = np.array_equal(self.albedo, other.albedo)
        return (
            np.array_equal(self.sigma_t, other.sigma_t)
            and same_albedo
            and self.anisotropy == other.anisotropy
            and self.emission == other.emission
        )

    def scattered(self, cosine: Any) -> Any:
        """Phase function of single scattering, 1/sr, at cosines between the directions before and after it."""
        return self.phase(cosine) if self.phase else henyey_greenstein(cosine, self.anisotropy)


def _albedo_grids(albedo: Any) -> tuple[Voxels, ...]:
    """One or three grids of an albedo that varies in space; none for numbers. Raises SceneError for bad grids."""
    if isinstance(albedo, SparseGrid):
        grids: tuple[Voxels, ...] = (albedo,)
    elif isinstance(albedo, (tuple, list)) and albedo and isinstance(albedo[0], (SparseGrid, np.ndarray)):
        grids = tuple(grid if isinstance(grid, SparseGrid) else np.asarray(grid, np.float32) for grid in albedo)
    elif np.ndim(albedo) == 3:
        grids = (np.asarray(albedo, np.float32),)
    elif np.ndim(albedo) == 4:
        grids = tuple(np.moveaxis(np.asarray(albedo, np.float32), 3, 0))
    else:
        return ()
    if len(grids) not in (1, 3) or any(len(grid.shape) != 3 or 0 in grid.shape for grid in grids):
        raise SceneError("an albedo that varies must be one grid or three")
    for grid in grids:
        low, high = float(grid.min()), float(grid.max())
        if not (low >= 0.0 and high <= 1.0):
            raise SceneError(f"albedo must lie in [0, 1]: its grid holds values from {low:g} to {high:g}")
    return grids


@dataclass
class Sun(Light):
    """A directional light.

    direction: (3,) world vector towards the sun; normalised here.
    irradiance: W/m^2 on a surface perpendicular to the light, scalar or RGB, in [0, 1e30]; float64 (3,) once made.
    name: for messages.
    spread: angular extent of the light, if it does not come from a single direction: unit vectors (K, 3) towards it and
        weights (K,) that sum to 1. The phase function is averaged over it; shadows are those of `direction`.
    part_of: the soft sun of which this is a part, or None. Multiple scattering is predicted once for all parts.
    receivers: names of the volumes and surfaces that it lights; None for all.

    Raises SceneError for a zero direction and for irradiance out of range.
    """

    direction: np.ndarray
    irradiance: np.ndarray = field(default_factory=lambda: np.ones(3))
    name: str = "sun"
    spread: tuple[np.ndarray, np.ndarray] | None = None
    part_of: "Sun | None" = None
    receivers: frozenset[str] | None = None

    def __post_init__(self) -> None:
        direction = np.asarray(self.direction, dtype=np.float64)
        length = np.linalg.norm(direction) if direction.shape == (3,) else np.nan
        if not np.isfinite(length) or length == 0.0:
            raise SceneError(f"{self.name}: direction must be three finite numbers, not all zero")
        self.direction = direction / length
        self.irradiance = rgb_triple(self.irradiance, f"{self.name}: irradiance")
        if np.any(self.irradiance < 0.0) or np.any(self.irradiance > MAX_IRRADIANCE):
            raise SceneError(f"{self.name}: irradiance must not be negative or above {MAX_IRRADIANCE:g}")

    @property
    def strength(self) -> np.ndarray:
        """Its irradiance."""
        return self.irradiance

    @property
    def darkness(self) -> str:
        """As of Light."""
        return "" if np.any(self.irradiance > 0.0) else "its irradiance is 0"

    def add_to(self, families: Families) -> None:
        """As of Light."""
        families.suns.append(self)

    def fluence_at(self, points: np.ndarray) -> np.ndarray:
        """As of Light."""
        return np.broadcast_to(self.irradiance, (len(points), 3))

    def mean_fluence(self) -> float:
        """Mean fluence of the colour channels in volumes, W/m^2."""
        return float(self.irradiance.mean())

    def screen(self, corners: np.ndarray) -> np.ndarray:
        """Triangles (T, 3, 3), in the world, that shade its own light alone; none.

        corners: (N, 3), of the boxes of the volumes that it lights.
        """
        return np.zeros((0, 3, 3))

    @property
    def screen_key(self) -> bytes:
        """Digest that is equal for suns with equal screens; empty for suns without a screen."""
        return b""

    def is_parallel_to(self, other: "Sun") -> bool:
        """Whether a single sun with the irradiance of both would be the same light."""
        parallel = np.linalg.norm(self.direction - other.direction) < PARALLEL_ANGLE
        undivided = not any(sun.spread or sun.part_of for sun in (self, other))
        linked = self.receivers == other.receivers and self.screen_key == other.screen_key
        return bool(parallel and undivided and linked)


@dataclass
class Surface:
    """An opaque triangle mesh.

    triangles: float64 (T, 3, 3), corners in the world. name: for messages. covers: whether it ends camera rays.
    shades: whether it shadows volumes from suns. stops: whether it absorbs light that volumes scatter. reflectance:
    fraction of its irradiance that it scatters back diffusely, scalar or RGB, in [0, 1]; float64 (3,) once made.
    emission: radiance that it emits on both sides, W/(m^2 sr), scalar or RGB, in [0, 1e30]; float64 (3,) once made.
    receivers: names of the volumes and surfaces that its emission lights; None for all. motion: how it moves as a whole
    while the camera's shutter is open, or None. deformed: float64 (S, T, 3, 3), the corners at S > 1 evenly spaced
    times from opening to closing, of one that also changes its shape; or None. Light knows it at the frame alone.

    Raises SceneError for corners that are not finite, and for reflectance or emission out of range.
    """

    triangles: np.ndarray
    name: str = "surface"
    covers: bool = True
    shades: bool = True
    stops: bool = True
    reflectance: Any = (0.0, 0.0, 0.0)
    emission: Any = (0.0, 0.0, 0.0)
    receivers: frozenset[str] | None = None
    motion: Motion | None = None
    deformed: np.ndarray | None = None

    def __post_init__(self) -> None:
        self.triangles = np.asarray(self.triangles, np.float64).reshape(-1, 3, 3)
        if not np.isfinite(self.triangles).all():
            raise SceneError(f"{self.name}: its vertices hold NaN or infinite values")
        self.reflectance = rgb_triple(self.reflectance, f"{self.name}: reflectance")
        if np.any(self.reflectance < 0.0) or np.any(self.reflectance > 1.0):
            raise SceneError(f"{self.name}: reflectance must lie in [0, 1]: {self.reflectance.tolist()}")
        self.emission = rgb_triple(self.emission, f"{self.name}: emission")
        if np.any(self.emission < 0.0) or np.any(self.emission > MAX_IRRADIANCE):
            raise SceneError(f"{self.name}: emission must not be negative or above {MAX_IRRADIANCE:g}")
        if self.deformed is not None:
            self.deformed = np.asarray(self.deformed, np.float64)
            if len(self.deformed) < 2 or self.deformed.shape[1:] != self.triangles.shape:
                raise SceneError(f"{self.name}: deformed needs all corners at two times or more")
            if not np.isfinite(self.deformed).all():
                raise SceneError(f"{self.name}: its vertices hold NaN or infinite values while the shutter is open")

    @property
    def moves(self) -> bool:
        """Whether it is elsewhere, or has another shape, at some time of the shutter."""
        return self.motion is not None or self.deformed is not None

    @property
    def shines(self) -> bool:
        """Whether it sends any light into volumes."""
        return bool(self.reflectance.any() or self.emission.any())
