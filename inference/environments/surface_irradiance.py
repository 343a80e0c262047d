# SPDX-License-Identifier: GPL-3.0-or-later
"""Irradiance of surfaces at which a medium ends, by the coarse transport: the flux through them."""

from collections.abc import Sequence

import numpy as np

from ..grids.working_cube import Cube
from ..numerics.small_matmul import product
from ..occluders.shadow_map import ShadowMap
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.environment import Environment
from ..source_terms.cell_sources import EnteringLight, SunBeam
from ..transport.discrete_ordinates import DiscreteOrdinates
from ..transport.ordinates import ORDINATE_WEIGHTS, ORDINATES
from .environment_light import environment_lattice, image_in_frame, ordinate_radiance, read_lattice

# Depth behind a surface at which the flux is read, in cells: nothing scatters light back from there.
BEHIND = 0.5
# Flux over fluence below which surfaces see too little of an environment to tell a share of it.
FAINT = 0.05


class SurfaceIrradiance:
    """Irradiance of N points of surfaces in one medium.

    solver: of the medium without what lies behind the surfaces, in its working cube. positions, normals: (N, 3), in the
    world.
    """

    def __init__(self, solver: DiscreteOrdinates, cube: Cube, positions: np.ndarray, normals: np.ndarray) -> None:
        self.solver, self.cube, self.normals = solver, cube, cube.directions(normals)
        self.positions = cube.positions(positions) - BEHIND / len(solver.density) * self.normals

    def scattered(
        self, direction: np.ndarray, shadow_map: ShadowMap | None = None, cancel: CancelToken = NEVER
    ) -> np.ndarray:
        """Irradiance (N,) by the scattered light of a sun of irradiance 1.

        direction: (3,), to the sun in the world. shadow_map: of surfaces, in the world, or None. Raises Cancelled.
        """
        visibility: np.ndarray | float = 1.0
        if shadow_map is not None:
            n, cube = len(self.solver.density), self.cube
            shadow_map = shadow_map.transformed(cube.rotation * cube.edge, cube.centre)
            # The density has been taken from what lies behind surfaces, so that the rest of such a cell is lit.
            visibility = shadow_map.cell_visibility(2 * n).reshape(n, 2, n, 2, n, 2).max(axis=(1, 3, 5))
        return self._flux(self.solver.solve(SunBeam(self.cube.directions(direction), visibility), cancel))

    def share(self, environments: Sequence[Environment], cancel: CancelToken = NEVER) -> np.ndarray:
        """Share (N,) that reaches the points of environments' irradiance, scattered or not. Raises Cancelled."""
        image = image_in_frame(environments, self.cube.rotation)
        towards = Environment(np.zeros((len(image), 2 * len(image), 3), np.float32)).directions()
        # Light from behind a surface does not reach it; which directions are behind it, the nearest axis tells.
        main = np.abs(self.normals).argmax(axis=1)
        facing = np.where(np.take_along_axis(self.normals, main[:, None], axis=1)[:, 0] > 0.0, 1.0, -1.0)
        share = np.zeros(len(self.normals))
        for axis, sign in dict.fromkeys(zip(main.tolist(), facing.tolist())):
            own = (main == axis) & (facing == sign)
            radiance = ordinate_radiance(image * (sign * towards[..., axis, None] > 0.0)).mean(axis=1)
            arriving = 4.0 * np.pi * ORDINATE_WEIGHTS * radiance
            # The ordinates stand for parts of the sphere, which makes the flux smaller, but also without the medium.
            whole = np.maximum(
                product(product(self.normals[own], ORDINATES.T), arriving), max(FAINT * arriving.sum(), 1e-30)
            )
            light = self.solver.solve(EnteringLight(radiance), cancel)
            share[own] = self._flux(light)[own] / whole
        return share

    def _flux(self, light: np.ndarray) -> np.ndarray:
        """Flux (N,) into the surfaces; light: float32 (4, x, y, z), fluence and flux."""
        flux = read_lattice(environment_lattice(light[1:, None]), self.positions)
        return np.maximum(-(flux * self.normals).sum(axis=1), 0.0)
