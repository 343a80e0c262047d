# SPDX-License-Identifier: GPL-3.0-or-later
"""Optical depth of a lamp's light as a whole, at the voxels of a medium.

The shadow of a lamp of some size is the mean of the shadows of its parts. Where there are many more steps on camera
rays than voxels, it is cheaper to find that mean once at each voxel than in each step.
"""

from dataclasses import dataclass

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..grids.dense_grid import DenseGrid
from ..kernels.field_structures import LampFluence
from ..kernels.structures import array_of
from ..numerics.small_matmul import inverse
from ..runtime.tasks import AnyTasks
from ..scene.emitters import Emitter
from ..transport.described_lamps import describe_emitter
from .lamp_in_media import LampInMedia

# Distance from a lamp, over its reach, from which on its parts are taken together.
APART = 1.8
# Voxels that a task finds at a time.
VOXELS_PER_TASK = 1 << 15
# Depth from which on nothing arrives.
OPAQUE = 80.0


@dataclass(frozen=True)
class MeanLampDepth:
    """Optical depth of a lamp's light at the voxels of one medium, and at those around it.

    It is -ln of the mean transmittance towards the lamp's parts, weighted by what they would give. grid: depths, whose
    first voxel lies in front of the medium's along each axis. start: distance from the lamp's middle from which on they
    are used.
    """

    grid: DenseGrid
    start: float

    def __call__(self, index: np.ndarray) -> np.ndarray:
        """Optical depth float32 (N,) at continuous indices float32 (3, N) of the medium."""
        return self.grid.sample(index + np.float32(1.0))


def mean_lamp_depth(lamp: LampInMedia, medium: BoundMedium, tasks: AnyTasks) -> MeanLampDepth:
    """Depths of a lamp's light in a medium alone, whose density is a DenseGrid. Raises Cancelled."""
    density = medium.grid.density
    assert isinstance(density, DenseGrid)
    filled = np.pad(density.padded[1:-2, 1:-2, 1:-2] > 0.0, 1)
    for axis in range(3):
        along = np.moveaxis(filled, axis, 0)
        near = along.copy()
        near[1:] |= along[:-1]
        near[:-1] |= along[1:]
        filled = np.moveaxis(near, 0, axis)
    shape, wanted = filled.shape, np.flatnonzero(filled)
    found = np.zeros(filled.size, np.float32)

    def fill(start: int) -> None:
        some = wanted[start : start + VOXELS_PER_TASK]
        found[some] = _depths(lamp, medium, np.stack(np.unravel_index(some, shape)) - 1)

    for _ in tasks.map(fill, range(0, len(wanted), VOXELS_PER_TASK)):
        pass
    return MeanLampDepth(DenseGrid(found.reshape(shape)), APART * lamp.reach)


def _depths(lamp: LampInMedia, medium: BoundMedium, index: np.ndarray) -> np.ndarray:
    """Depth float32 (N,) of all of a lamp's light at voxels int (3, N) of a medium."""
    points = (index - medium.offset[:, None]).T @ inverse(medium.linear).T
    index = index.astype(np.float32)
    passed, given = np.zeros((2, len(points)), np.float32)
    for emitter, [depth] in zip(lamp.emitters, lamp.depths):
        # Where no part gives anything, all of them alike.
        light = _fluence(lamp, emitter, points) + np.float32(1e-30)
        passed += light * np.exp(-depth(index, medium.sigma_t))
        given += light
    return np.minimum(-np.log(np.maximum(passed / given, np.float32(1e-37))), np.float32(OPAQUE))


def _fluence(lamp: LampInMedia, emitter: Emitter, points: np.ndarray) -> np.ndarray:
    """Fluence float32 (N,) of one part of a lamp at world points (N, 3)."""
    if lamp.kernels is None:
        return emitter.fluence(points).astype(np.float32)
    fluence, brightest = np.empty((2, len(points)))
    data = LampFluence(
        points=len(points),
        positions=np.ascontiguousarray(points),
        lamp=1,
        emitters=array_of([describe_emitter(emitter)]),
        fluence=fluence,
        brightest=brightest,
    )
    lamp.kernels.prepare("lamp_fluence", data)
    return fluence.astype(np.float32)
