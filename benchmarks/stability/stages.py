# SPDX-License-Identifier: GPL-3.0-or-later
"""Each stage in the precision of renders, against double precision or a closed form."""

from ctypes import c_int32

import numpy as np

from inference import Medium, Volume
from inference.features.mip_lattices import density_pyramid
from inference.grids.bound_medium import BoundMedium
from inference.grids.grid import Grid
from inference.grids.optical_depth_sweep import sun_optical_depth
from inference.grids.working_cube import fit_cube, mean_density
from inference.marching.marcher import Marcher, ray_features_at
from inference.marching.ray_features import SCALES
from inference.marching.ray_march import MarchOptions
from inference.marching.ray_steps import RayBatch
from inference.paper.phase_features import cumulative_phase
from inference.scene.phase_function import henyey_greenstein
from tests.reference.sun_columns import cell_depths

from .case import Case, Outcome
from .exact import ExactVolume
from .scenes import SUN, blob, placed


def shadows(density, sigma_t):
    """Transmittance to the sun from random points of steep density, against exact integrals."""

    def measure():
        volume = placed(density)
        grid, exact = Grid(volume), ExactVolume(volume, sigma_t)
        [depth] = grid.sun_depths([SUN.direction])
        index = np.random.default_rng(0).uniform(-1.0, np.array(density.shape), (2000, 3))
        world = index @ volume.world_from_index[:3, :3].T + volume.world_from_index[:3, 3]
        found = depth(grid.index(world).T.astype(np.float32), sigma_t)
        error = np.exp(-found) - np.exp(-exact.to_sun(index, SUN.direction))
        return Outcome({"root mean square": float(np.sqrt((error**2).mean())), "mean": float(abs(error.mean()))})

    return measure


def sweep_precision():
    """The sweep over 256 slices in single and in double precision."""
    density = np.random.default_rng(1).random((256, 24, 24)).astype(np.float32) ** 8 * 100
    direction = np.array([0.9, 0.3, -0.2])
    single = sun_optical_depth(density, direction)
    double = cell_depths(density.astype(np.float64), direction)
    return Outcome({"largest": float(np.abs(single - double).max() / double.max())})


def column(sigma_t):
    """A medium lit from above that varies along z, points (N, 3) in it, and optical depths (N,) below and above."""
    heights = np.random.default_rng(2).random(40) ** 4
    volume = Volume(np.broadcast_to(heights.astype(np.float32), (5, 5, 40)).copy(), np.eye(4), "column")
    grid = Grid(volume)
    medium = BoundMedium(grid, Medium(sigma_t), sigma_t, grid.sun_depths([np.array([0.0, 0.0, 1.0])]))
    # Integrals of the linear interpolant from one voxel to the next.
    padded = np.pad(volume.density[2, 2].astype(np.float64), 1)
    ends = np.concatenate([[0.0], np.cumsum(0.5 * (padded[1:] + padded[:-1]))]) * sigma_t
    inside = np.arange(0, 40, 3)
    points = np.stack([np.full(len(inside), 2.0), np.full(len(inside), 2.0), inside], axis=1)
    return medium, points, ends[inside + 1], ends[-1] - ends[inside + 1]


def light_ahead():
    """Light of a sun behind the camera along rays, with three scales of extinction, over 12 decades of density."""
    worst = 0.0
    for sigma_t in 10.0 ** np.linspace(-8, 1, 19):
        medium, points, below, above = column(sigma_t)
        down = np.broadcast_to([0.0, 0.0, -1.0], points.shape)
        features = ray_features_at(medium, points, down, None).of(slice(None), 0, 0)
        for scale, found in zip(SCALES, features[:, 2:].T):
            exact = np.exp(-scale * above) * -np.expm1(-2.0 * scale * below) / 2.0
            worst = max(worst, float((np.abs(found - exact) / np.maximum(exact, 1e-3 * min(sigma_t, 1.0))).max()))
    return Outcome({"largest": worst})


def single_scattering():
    """Of a sun behind the camera, and what a ray takes, over 15 decades of density."""
    worst = 0.0
    for sigma_t in 10.0 ** np.linspace(-8, 7, 31):
        medium, points, below, above = column(sigma_t)
        whole = below[0] + above[0]
        ray = RayBatch(np.array([[2.0, 2.0, 41.0]]), np.array([[0.0, 0.0, -1.0]]), np.zeros(1), np.full(1, 43.0))
        segment = Marcher([medium], MarchOptions(1), (), c_int32(0))(ray)
        for found, exact in (
            (segment.alpha[0], -np.expm1(-whole)),
            (segment.single[0, 0, 0, 0], -np.expm1(-2 * whole) / 2),
        ):
            worst = max(worst, abs(float(found) / exact - 1.0))
    return Outcome({"largest": worst})


def peaks():
    """The phase function at and beside its peak, in extended precision."""
    worst = 0.0
    for g in (-0.999, -0.3, 1e-12, 0.5, 0.95, 0.999):
        angle = np.array([0.0, 1e-9, 1e-6, 1e-4, 1e-2, 1.0, 3.0, np.pi])
        cosine = np.cos(angle)
        wide, exact_g = cosine.astype(np.longdouble), np.longdouble(g)
        exact = (1 - exact_g**2) / (4 * np.pi * (1 + exact_g**2 - 2 * exact_g * wide) ** np.longdouble(1.5))
        worst = max(worst, float(np.abs(henyey_greenstein(cosine, g) / exact - 1).max()))
    return Outcome({"largest": worst})


def cones():
    """The phase function's integral over cones around its axis, against its antiderivative."""
    worst = 0.0
    for g in (-0.999, -0.3, 0.5, 0.95, 0.999):
        half = np.array([1e-3, 1e-2, 0.1, 1.0, 3.0])
        exact = (1 - g * g) / (2 * g) * (1 / (1 - g) - 1 / np.sqrt(1 + g * g - 2 * g * np.cos(half)))
        worst = max(worst, float(np.abs(cumulative_phase(1.0, half, g) - exact).max()))
    return Outcome({"largest": worst})


def mass():
    """The mass in the working cube's 256³ cells and in their pyramid, against that of the voxels."""
    volume = placed(np.exp(12.0 * np.random.default_rng(3).random((20, 14, 17))))
    cube = fit_cube(volume)
    cells = mean_density(volume, cube)
    voxel = np.linalg.det(volume.world_from_index[:3, :3])
    truth = volume.density.sum(dtype=np.float64) * voxel / cube.edge**3
    top = float(density_pyramid(cells)[-1][0, 0, 0])
    return Outcome({"cells": float(abs(cells.mean(dtype=np.float64) / truth - 1)), "pyramid": abs(top / truth - 1)})


def half_floats():
    """The viewport's picture, which alone is stored in half precision."""
    values = np.float32(10.0) ** np.linspace(-4, 4.8, 1000, dtype=np.float32)
    return Outcome({"largest": float(np.abs(values.astype(np.float16).astype(np.float32) / values - 1).max())})


STEEP = np.zeros((16, 16, 16), np.float32)
STEEP[4:12, 5:11, 6:13] = 1.0

CASES = [
    *(
        Case(
            "stage",
            f"transmittance to the sun, {name}, σ̂ = {s:g}",
            "double precision",
            shadows(density, s),
            {"root mean square": 0.08, "mean": 0.01},
            quick=s == 1e3,
        )
        for name, density in (("lumpy", blob()), ("hard edges", STEEP))
        for s in (1.0, 30.0, 1e3, 1e6)
    ),
    Case("stage", "optical depth over 256 slices", "double precision", sweep_precision, {"largest": 1e-5}, True),
    Case("stage", "single scattering of a ray", "closed form", single_scattering, {"largest": 0.01}, True),
    Case("stage", "light along the camera ray", "closed form", light_ahead, {"largest": 0.02}, True),
    Case("stage", "peaks of the phase function", "extended precision", peaks, {"largest": 1e-8}, True),
    Case("stage", "phase function over cones", "closed form", cones, {"largest": 1e-6}, True),
    Case("stage", "mass in cells and pyramid", "closed form", mass, {"cells": 1e-4, "pyramid": 1e-4}),
    Case("stage", "half precision in the viewport", "single precision", half_floats, {"largest": 1e-3}, True),
]
