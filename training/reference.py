"""The path tracer as a system: importing this lets Settings(model="reference") trace multiple scattering.

It stands where the networks stand: at the depth samples of a render, with the same single scattering and
composition. What is left between such an image and a path-traced one is not the networks' error.
"""

import threading
import zlib

import numpy as np

from inference.network.network import register_system
from inference.scene import SceneError
from inference.scene.sparse_grid import SparseGrid
from training.path_tracer import trace_points
from training.transport import prepare

#: Paths a point; a render averages over its depth samples too.
PATHS = 8
#: Voxels may differ by this share from cubes.
UNEVEN = 1e-4

# The tracer's parallel loops must not be entered by several threads at once.
_tracing = threading.Lock()


class PathTracer:
    """What `load_network("reference")` gives."""

    name = "reference"
    checksum = ""
    anisotropy_range = (-1.0, 1.0)
    sigma_hat_range = (0.0, np.inf)
    albedo_range = (0.0, 1.0)
    needs_ray_features = False

    def __init__(self, paths: int = PATHS):
        self.paths = paths

    def field(self, volume, cube, anisotropy: float, check=lambda: None):
        """Raises SceneError where the volume's voxels are no cubes."""
        return TracedField(self.paths, volume, cube, anisotropy)


class TracedField:
    """A volume's own voxels, as the tracer's cube, and paths through them."""

    def __init__(self, paths, volume, cube, anisotropy):
        axes = volume.world_from_index[:3, :3]
        voxel = float(np.linalg.norm(axes[:, 0]))
        if np.abs(axes.T @ axes / voxel**2 - np.eye(3)).max() > UNEVEN:
            raise SceneError(f"{volume.name}: the path-traced reference needs cubic voxels; resample the grid")
        # A voxel of zeros around the active ones: interpolation ends there, and the tracer's cube behind it.
        size = cube.high - cube.low
        cells = int(size.max()) + 2
        density = np.zeros((cells,) * 3, np.float32)
        whole = volume.density.dense() if isinstance(volume.density, SparseGrid) else volume.density
        density[tuple(slice(1, n + 1) for n in size)] = whole[tuple(map(slice, cube.low, cube.high))]
        self.grid, self.paths, self.anisotropy = prepare(density), paths, anisotropy
        # From the working cube's frame to the tracer's [-1/2, 1/2]^3, whose cell 1 is voxel `low`.
        index_from_world = np.linalg.inv(volume.world_from_index)
        self.linear = index_from_world[:3, :3] @ cube.rotation * (cube.edge / cells)
        index = index_from_world[:3, :3] @ cube.centre + index_from_world[:3, 3] - cube.low + 1.5
        self.offset = index / cells - 0.5
        self.edge = cells * voxel / cube.edge

    def light(self, sigma_hat: float, sun, low, high, mapper=map):
        """Take one optical density of the working cube's edge and one sun (3,), in the cube's frame."""
        self.sigma, self.sun = sigma_hat * self.edge, self.linear @ sun

    def predict(self, positions, omega, albedos, jitter=None, light=None) -> np.ndarray:
        """Radiance float32 (A, N), noisy, the same for the same points and jitter; light is not needed."""
        places = np.clip(positions @ self.linear.T + self.offset, -0.5, 0.5)
        with _tracing:
            radiance = trace_points(
                self.grid, self.sun, None, places, omega @ self.linear.T, self.sigma, self.anisotropy,
                albedos, self.paths, seed=_seed(positions, jitter),
            )
        return radiance[:, 0].T


def _seed(positions, jitter) -> int:
    """Of the paths: the jitter tells apart renders of different seeds, whose points are the same."""
    return zlib.crc32(b"".join(np.ascontiguousarray(a).tobytes() for a in (positions, jitter) if a is not None))


register_system("reference", PathTracer)
