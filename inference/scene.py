"""What a render is asked for: plain descriptions of volumes, lights and cameras.

Units: lengths in world units, extinction in 1/world unit, irradiance in W/m^2,
radiance in W/(m^2 sr). Arrays are float32 unless stated; nothing here knows Blender.
"""

from dataclasses import dataclass
from typing import FrozenSet, Literal, Optional, Tuple, Union

import numpy as np

from .omissions import ALL
from .phase import henyey_greenstein
from .phase_function import PhaseFunction
from .sparse_grid import SparseGrid

# Cycles' own limit: the phase function degenerates at -1 and 1.
ANISOTROPY_MOST = 0.999
# Brighter light would not fit the image's single precision where the phase function peaks.
IRRADIANCE_MOST = 1e30


class SceneError(ValueError):
    """The scene cannot be rendered as described; the message says what to change."""


class Cancelled(Exception):
    """The caller's `cancelled` callback asked the work to stop."""


def _rgb(value, name: str) -> np.ndarray:
    """A scalar or three numbers as float64 (3,); refuses anything not finite."""
    rgb = np.asarray(value, dtype=np.float64)
    if rgb.shape not in ((), (1,), (3,)):
        raise SceneError(f"{name} must be one number or three, not shape {rgb.shape}")
    rgb = np.broadcast_to(rgb, (3,)).copy()
    if not np.all(np.isfinite(rgb)):
        raise SceneError(f"{name} must be finite, not {rgb.tolist()}")
    return rgb


def _affine(matrix, name: str) -> np.ndarray:
    matrix = np.asarray(matrix, dtype=np.float64)
    if matrix.shape != (4, 4) or not np.all(np.isfinite(matrix)):
        raise SceneError(f"{name} must be a finite 4x4 matrix")
    if abs(np.linalg.det(matrix[:3, :3])) == 0.0:
        raise SceneError(f"{name} is singular: the object is scaled to nothing")
    return matrix


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

    density: Union[np.ndarray, SparseGrid]
    world_from_index: np.ndarray
    name: str = "volume"
    emission: Union[None, np.ndarray, Tuple[SparseGrid, SparseGrid, SparseGrid]] = None
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
        self.world_from_index = _affine(self.world_from_index, f"{self.name}: transform")
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

    def emission_channels(self):
        """Three grids as the density is one, or none."""
        if self.emission is None:
            return []
        return list(self.emission) if isinstance(self.density, SparseGrid) else list(np.moveaxis(self.emission, 3, 0))


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
    phase: Optional[PhaseFunction] = None

    def __post_init__(self):
        self.sigma_t = _rgb(self.sigma_t, "extinction")
        self.albedo = _rgb(self.albedo, "albedo")
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
    spread: Optional[Tuple[np.ndarray, np.ndarray]] = None

    def __post_init__(self):
        direction = np.asarray(self.direction, dtype=np.float64)
        length = np.linalg.norm(direction) if direction.shape == (3,) else np.nan
        if not np.isfinite(length) or length == 0.0:
            raise SceneError(f"{self.name}: direction must be three finite numbers, not all zero")
        self.direction = direction / length
        self.irradiance = _rgb(self.irradiance, f"{self.name}: irradiance")
        if np.any(self.irradiance < 0.0) or np.any(self.irradiance > IRRADIANCE_MOST):
            raise SceneError(f"{self.name}: irradiance must not be negative or above {IRRADIANCE_MOST:g}")


@dataclass
class Camera:
    """A view with Blender's axes: looks along -Z, +Y up.

    world_matrix: (4, 4) camera to world; scale is ignored.
    resolution: (width, height) in pixels.
    fov: horizontal field of view in radians (perspective).
    ortho_scale: world units across the image's width (orthographic).
    shift: (x, y) lens shift in units of the image's width; positive moves the
        window right and up.
    longitude, latitude: (left, right) and (lower, upper) edge in radians, 0 straight ahead,
        positive to the right and up (equirectangular).
    clip: (near, far) distances along the viewing axis; along each ray where equirectangular.
    region: (x0, y0, x1, y1) pixels, upper left inclusive, lower right exclusive,
        rows from the top; None renders the whole image. The layer has the
        region's size.
    """

    world_matrix: np.ndarray
    projection: Literal["perspective", "orthographic", "equirectangular"] = "perspective"
    resolution: Tuple[int, int] = (1920, 1080)
    fov: float = 0.6911112070083618
    ortho_scale: float = 6.0
    shift: Tuple[float, float] = (0.0, 0.0)
    longitude: Tuple[float, float] = (-np.pi, np.pi)
    latitude: Tuple[float, float] = (-np.pi / 2.0, np.pi / 2.0)
    clip: Tuple[float, float] = (0.0, np.inf)
    region: Optional[Tuple[int, int, int, int]] = None

    def __post_init__(self):
        self.world_matrix = _affine(self.world_matrix, "camera: transform")
        if self.projection not in ("perspective", "orthographic", "equirectangular"):
            raise SceneError(f"camera: projection {self.projection!r} is not supported")
        width, height = (int(n) for n in self.resolution)
        if width < 1 or height < 1:
            raise SceneError(f"camera: resolution {width}x{height} has no pixels")
        self.resolution = (width, height)
        if self.projection == "perspective" and not 0.0 < self.fov < np.pi:
            raise SceneError(f"camera: field of view {self.fov:g} must lie between 0 and pi")
        if self.projection == "orthographic" and not 0.0 < self.ortho_scale < np.inf:
            raise SceneError(f"camera: orthographic scale {self.ortho_scale:g} must be positive")
        if self.longitude[0] == self.longitude[1] or self.latitude[0] == self.latitude[1]:
            raise SceneError(f"camera: longitudes {self.longitude} and latitudes {self.latitude} span nothing")
        if not np.all(np.isfinite([*self.shift, *self.longitude, *self.latitude])):
            raise SceneError("camera: shift, longitudes and latitudes must be finite")
        near, far = self.clip
        if not 0.0 <= near < far:
            raise SceneError(f"camera: clip range {near:g} to {far:g} is empty")
        if self.region is not None:
            x0, y0, x1, y1 = (int(n) for n in self.region)
            if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
                raise SceneError(f"camera: region {self.region} does not lie in the image")
            self.region = (x0, y0, x1, y1)

    @property
    def window(self) -> Tuple[int, int, int, int]:
        """(x0, y0, x1, y1) of the pixels to render."""
        return self.region or (0, 0, *self.resolution)


@dataclass
class Settings:
    """How to render.

    depth_samples: network evaluations along a camera ray that the medium hides, up to 512.
    model: name of the network (a file in inference/weights).
    seed: of the lookups' offsets; the same seed gives the same image.
    threads: worker threads, 0 for one a core; the image does not depend on it.
    memory_limit: bytes the render may use on top of its input; it is refused
        with a message where it would need more.
    multiple: whether to predict multiple scattering; without, the layer is darker.
    provider: of onnxruntime, that runs the network: one of `provider.PROVIDERS`.
    leave_out: names of `omissions.OMISSIONS`: what the picture does not need and is not done.
    """

    depth_samples: int = 4
    model: str = "mrpnn"
    seed: int = 0
    threads: int = 0
    memory_limit: int = 8 << 30
    multiple: bool = True
    provider: str = "CPU"
    leave_out: FrozenSet[str] = ALL

    def __post_init__(self):
        for name, least, most in (("depth samples", 1, 512), ("threads", 0, 1024), ("seed", 0, 2**63 - 1)):
            value = getattr(self, name.replace(" ", "_"))
            if not least <= value <= most or value != int(value):
                raise SceneError(f"{name} must be a whole number from {least} to {most}, not {value}")
        self.leave_out = frozenset(self.leave_out)
        unknown = sorted(self.leave_out - ALL)
        if unknown:
            raise SceneError(f"there is no {unknown[0]!r} to leave out; there are: {', '.join(sorted(ALL))}")
        if not self.memory_limit > 0:
            raise SceneError(f"the memory limit must be above 0, not {self.memory_limit}")
