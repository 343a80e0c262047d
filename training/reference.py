# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer as a system: importing this lets Settings(model="reference") trace multiple scattering.

It stands where the networks stand: at the depth samples of a render, with the same single scattering and
composition. What is left between such an image and a path-traced one is not the networks' error.
"""

import threading
import zlib
from dataclasses import dataclass

import numpy as np

from inference.network.conditions import Conditions
from inference.network.network import register_system
from inference.runtime.cancellation import NEVER
from inference.runtime.tasks import SERIAL
from inference.scene import SceneError
from inference.scene.sparse_grid import SparseGrid
from training.tracer.density_grid import prepare
from training.tracer.path_tracer import Sampling, Scene, Vertices, trace_points

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

    def predictor(self, volume, cube, anisotropy: float, cancel=NEVER):
        """Raises SceneError where the volume's voxels are no cubes."""
        return VolumeTracer(self.paths, volume, cube, anisotropy)


class VolumeTracer:
    """A volume's own voxels, as the tracer's cube."""

    respects_surfaces = False

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

    def prepare(self, conditions: Conditions, tasks=SERIAL) -> "PreparedTracer":
        """For one optical thickness and one sun; bounds and surfaces are not used."""
        return PreparedTracer(self, conditions.sigma_hat * self.edge, self.linear @ conditions.sun)


@dataclass(frozen=True)
class PreparedTracer:
    """Paths through one volume; sigma: optical thickness of the tracer's cube, sun: (3,) in its frame."""

    volume: VolumeTracer
    sigma: float
    sun: np.ndarray
    lattice_cells = 0

    def predict(self, positions, omega, albedos, jitter=None, ray_features=None) -> np.ndarray:
        """Radiance float32 (A, N), noisy, the same for the same points and jitter; ray features are not needed."""
        volume = self.volume
        places = np.clip(positions @ volume.linear.T + volume.offset, -0.5, 0.5)
        with _tracing:
            radiance = trace_points(
                Scene(volume.grid, self.sun),
                Vertices(places, omega @ volume.linear.T, self.sigma, volume.anisotropy, albedos),
                Sampling(volume.paths, _seed(positions, jitter)),
            )
        return radiance[:, 0].T


def _seed(positions, jitter) -> int:
    """Of the paths: the jitter tells apart renders of different seeds, whose points are the same."""
    return zlib.crc32(b"".join(np.ascontiguousarray(a).tobytes() for a in (positions, jitter) if a is not None))


register_system("reference", PathTracer)
