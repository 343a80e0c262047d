# SPDX-License-Identifier: GPL-3.0-or-later
"""Mean optical depth of a lamp's light, at the voxels of a medium.

The shadow of an extended lamp is the mean of the shadows of its emitters. Where there are many more steps on camera
rays than voxels, it is cheaper to compute that mean once at each voxel than in each step.
"""

from dataclasses import dataclass

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..grids.dense_grid import DenseGrid
from ..numerics.small_matmul import inverse
from ..runtime.tasks import AnyTasks
from ..source_terms.lamp_cells import LampCells, light_in_cells
from .joined_lamps import PredictedLamp

# Distance from a lamp, over its reach, from which on its mean depth is used.
APART = 1.8
# Voxels that a task computes.
VOXELS_PER_TASK = 1 << 15
# Depth that stands for no light, and fluence of a lamp of power 1 that counts as dark.
OPAQUE, DARK = 80.0, 1e-30


@dataclass(frozen=True)
class MeanLampDepth:
    """Mean optical depth of a lamp's light at the voxels of a medium, and at a layer around it.

    It is -ln of the mean transmittance towards the lamp's emitters, weighted by their unattenuated light. grid: depths,
    with a layer of voxels before the medium's first along each axis. start: distance from the lamp's middle, in world
    units, from which on the depths are used.
    """

    grid: DenseGrid
    start: float


def mean_lamp_depth(lamp: PredictedLamp, medium: BoundMedium, tasks: AnyTasks) -> MeanLampDepth:
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
    shape, voxels = filled.shape, np.flatnonzero(filled)
    depths = np.zeros(filled.size, np.float32)

    def fill(start: int) -> None:
        numbers = voxels[start : start + VOXELS_PER_TASK]
        depths[numbers] = _depths(lamp, medium, numbers, shape)

    for _ in tasks.map(fill, range(0, len(voxels), VOXELS_PER_TASK)):
        pass
    return MeanLampDepth(DenseGrid(depths.reshape(shape)), APART * lamp.reach)


def _depths(lamp: PredictedLamp, medium: BoundMedium, numbers: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Mean depth float32 (N,) of a lamp's light at voxels of a medium.

    numbers: int (N,), in a lattice of a shape that has one voxel more than the medium on each side.
    """
    world_from_index, index = inverse(medium.linear), np.stack(np.unravel_index(numbers, shape)) - 1
    emitters = [(emitter, depth, None) for emitter, [depth] in zip(lamp.emitters, lamp.depths)]
    origin = world_from_index @ (-1.0 - medium.offset)
    cells = LampCells(shape, world_from_index, origin, np.ones(3, int), medium.sigma_t)
    passed, unshadowed = light_in_cells(emitters, cells, (numbers, 1, 0.0))
    # Where no emitter shines, all have the same weight.
    dark = np.flatnonzero(unshadowed < DARK)
    if len(dark):
        through = [np.exp(-depth(index[:, dark].astype(np.float32), medium.sigma_t)) for [depth] in lamp.depths]
        passed[dark], unshadowed[dark] = np.mean(through, axis=0), 1.0
    return np.minimum(-np.log(np.maximum(passed / unshadowed, np.float32(1e-37))), np.float32(OPAQUE))
