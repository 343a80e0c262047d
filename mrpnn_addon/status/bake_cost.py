# SPDX-License-Identifier: GPL-3.0-or-later
"""Estimates the time of a bake from boxes around its volumes, and from earlier bakes; imports no bpy.

A bake predicts light in voxels and, for other directions, at coarse points. `BakeWork` counts these as a bake's
progress does; constants convert the counts to seconds. The last bake calibrates them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...inference.baking.bake import SKY_SHARE
from ...inference.baking.directional_factor import ANCHORS
from ...inference.baking.directions import FINE_NODES, NODES, expected_work, stride_of
from ...inference.baking.lattice import DIRECTIONS, joined_voxels
from ...inference.baking.smooth_light import SKY_STRIDES, STRIDES, expected_predictions
from ...inference.scene import Camera
from ..objects.workload import Box, corners, count_groups
from .cost_model import EVALUATED, FIELD_SCALING, SCALING, SHORTEST, Calibration

# The machine's rate in `Calibration.rates`.
BAKE = "bake"
# All constants are processor seconds of a desktop of 2020, see `benchmarks.cost.forecast --bake`.
# Of each volume, of each cell of its box and of each voxel with light in it.
VOLUME, CELL, VOXEL = 0.1, 5.0e-8, 8.0e-7
# Of the coarse transport and lattices of each light and group, and of surfaces.
FIELD_SUN, FIELD_LAMP, FIELD_WORLD, SURFACES = 0.55, 1.0, 0.5, 1.7
# Predictions of a World beside suns or lamps, over those of a World alone.
FAINT = 0.35
# Of each prediction of a sun, a lamp and the World, and of each point of a coarse grid and direction.
POINT_SUN, POINT_LAMP, POINT_WORLD, GRID_POINT = 1.3e-5, 2.0e-5, 2.5e-5, 2.5e-7


@dataclass
class BakeWork:
    """Work of a bake.

    names: of the volumes. volumes, groups: their number, and that of groups of volumes that overlap. suns, lamps,
    worlds: numbers of lights. surfaces: whether there are any. cells: voxels of the volumes' boxes. voxels: those with
    light. points: predictions of suns and lamps, of each. sky_points: of the World. grid_points: points of coarse grids
    times directions.
    """

    names: frozenset[str]
    volumes: int
    groups: int
    suns: int
    lamps: int
    worlds: int
    surfaces: bool
    cells: float = 0.0
    voxels: float = 0.0
    points: float = 0.0
    sky_points: float = 0.0
    grid_points: float = 0.0


def bake_work(
    boxes: Sequence[Box], camera: Camera, lights: tuple[int, int, int], surfaces: bool, directional: bool
) -> BakeWork:
    """The work of baking what is in some boxes. lights: numbers of suns, lamps and Worlds."""
    names = frozenset(box.name for box in boxes)
    found = BakeWork(names, len(boxes), count_groups(list(boxes)), *lights, surfaces)
    for box in boxes:
        edges = np.linalg.norm(box.matrix[:3, :3], axis=0) * (box.high - box.low)
        # The renderer refines small grids; a bake does not.
        voxel = box.voxel * box.refined
        joined = joined_voxels(camera, corners(box), voxel)
        shape = np.maximum(edges / (voxel * joined), 1.0)
        thickness = box.thickness * box.refined * joined
        cells, longest = float(np.prod(shape)), int(np.ceil(shape.max()))
        voxels = cells * (EVALUATED if box.filled is None else box.filled)
        found.cells += cells
        found.voxels += voxels
        if surfaces:
            # What they throw back is not smooth.
            found.points += expected_predictions(voxels, STRIDES, 1.0)
            found.sky_points += expected_predictions(voxels, STRIDES, 1.0)
        else:
            found.points += expected_predictions(voxels, STRIDES)
            found.sky_points += (FAINT if any(lights[:2]) else 1.0) * expected_predictions(voxels, SKY_STRIDES)
        if directional:
            work = expected_work(voxels, longest, thickness, len(DIRECTIONS), len(ANCHORS) - 1)
            found.points += work
            found.sky_points += SKY_SHARE * work
            for most, count in (FINE_NODES, len(ANCHORS) - 1), (NODES, len(DIRECTIONS)):
                found.grid_points += count * cells / stride_of(longest, most, thickness) ** 3
    return found


def estimate_bake(work: BakeWork, threads: int, known: Calibration) -> float:
    """Estimated wall-clock seconds of a bake; with one thread, processor seconds."""
    # Before the first bake, the machine is as fast as it renders.
    rate = known.bakes.get(work.names) or known.rates.get(BAKE) or known.rates.get("network", 1.0)
    return rate * _modelled(work, threads)


def calibrate_bake(known: Calibration, work: BakeWork, threads: int, seconds: float) -> None:
    """Update a calibration by a bake of all volumes, which took so many seconds."""
    if seconds > SHORTEST:
        known.bakes[work.names] = known.rates[BAKE] = seconds / _modelled(work, threads)


def _modelled(work: BakeWork, threads: int) -> float:
    skies = (work.worlds > 0) + work.surfaces
    parallel, fields = max(threads, 1) ** SCALING, max(threads, 1) ** FIELD_SCALING
    field = FIELD_SUN * work.suns + FIELD_LAMP * work.lamps + FIELD_WORLD * skies
    points = work.points * (POINT_SUN * work.suns + POINT_LAMP * work.lamps) + work.sky_points * POINT_WORLD * skies
    # Rays are marched through all volumes that overlap.
    points *= (work.volumes / max(work.groups, 1)) ** 0.5
    alone = VOLUME * work.volumes + CELL * work.cells + VOXEL * work.voxels + GRID_POINT * work.grid_points
    return alone + (work.groups * field + SURFACES * work.surfaces) / fields + points / parallel
