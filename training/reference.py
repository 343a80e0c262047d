# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer as a system: importing this lets Settings(model="reference") trace multiple scattering.

It replaces the network at the depth samples of a render, with the same single scattering and composition. Where such an
image differs from a path-traced one, the network is not to blame.
"""

import threading
import zlib
from dataclasses import dataclass

import numpy as np

from inference.network.conditions import Conditions, RayPoints
from inference.network.interfaces import Predictor
from inference.network.network import register_system
from inference.runtime.cancellation import NEVER
from inference.runtime.tasks import SERIAL
from inference.scene import SceneError
from inference.scene.sparse_grid import SparseGrid
from training.tracer.density_grid import prepare
from training.tracer.path_tracer import Sampling, Scene, Vertices, trace_points

#: Paths per point; a render averages over its depth samples too.
PATHS = 8
#: Relative deviation of voxels from cubes that is accepted.
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
    deviation = None

    def __init__(self, paths: int = PATHS):
        self.paths = paths

    def predictor(self, volume, cube, anisotropy: float, cancel=NEVER):
        """Of a volume and its working cube. Raises SceneError where the voxels are not cubic."""
        return VolumeTracer(self.paths, volume, cube, anisotropy)


class VolumeTracer(Predictor):
    """The tracer's cube, made of a volume's own voxels."""

    respects_surfaces = respects_albedo = False

    def __init__(self, paths, volume, cube, anisotropy):
        axes = volume.world_from_index[:3, :3]
        voxel = float(np.linalg.norm(axes[:, 0]))
        if np.abs(axes.T @ axes / voxel**2 - np.eye(3)).max() > UNEVEN:
            raise SceneError(f"{volume.name}: the path-traced reference needs cubic voxels; resample the grid")
        # One layer of zeros around the active voxels, where interpolation falls to 0 inside the tracer's cube.
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
        return PreparedTracer(self, conditions.sigma_hat * self.edge, self.linear @ conditions.light.direction)


@dataclass(frozen=True)
class PreparedTracer:
    """Paths through one volume; sigma: optical thickness of the tracer's cube, sun: (3,) in its frame."""

    volume: VolumeTracer
    sigma: float
    sun: np.ndarray
    scale = 1.0

    def predict(self, points: RayPoints, albedos) -> np.ndarray:
        """Noisy radiance float32 (A, N), the same for the same points and jitter; ray features are not needed."""
        volume = self.volume
        places = np.clip(points.positions @ volume.linear.T + volume.offset, -0.5, 0.5)
        with _tracing:
            radiance = trace_points(
                Scene(volume.grid, self.sun),
                Vertices(places, points.directions @ volume.linear.T, self.sigma, volume.anisotropy, albedos),
                Sampling(volume.paths, _seed(points.positions, points.jitter)),
            )
        return radiance[:, 0].T


def _seed(positions, jitter) -> int:
    """Seed of the paths; the jitter distinguishes renders of different seeds, whose points are the same."""
    return zlib.crc32(b"".join(np.ascontiguousarray(a).tobytes() for a in (positions, jitter) if a is not None))


register_system("reference", PathTracer)
