# SPDX-License-Identifier: GPL-3.0-or-later
"""A volume's density as networks read it at their stencils."""

import threading

import numpy as np

from ..grids.working_cube import Cube, extent
from ..numerics.alike import alike
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import AnyTasks
from ..scene.description import Volume
from .mip_lattices import Lattices, density_lattices, inner_cells, padded_pyramid
from .stencil import Stencil


class DensityReader:
    """The padded pyramid of a volume, and its lattices for the last optical thickness. Safe on several threads.

    extent: lowest and highest coordinates (3,), in the cube's frame, of points with density. Raises Cancelled.
    """

    def __init__(self, volume: Volume, cube: Cube, stencil: Stencil, cancel: CancelToken = NEVER):
        self.stencil, self.extent = stencil, extent(volume, cube)
        self.padded = padded_pyramid(volume, cube, stencil, cancel)
        self._lock = threading.Lock()
        self._lattices: tuple[tuple[float, ...], Lattices] | None = None

    def level(self, m: int) -> np.ndarray:
        """The cells of level m that lie in the cube."""
        return inner_cells(self.padded[m], m, self.stencil)

    def lattices(self, sigma_hat: float, tasks: AnyTasks) -> Lattices:
        """As `density_lattices`; they serve every light. Raises Cancelled."""
        key = alike(sigma_hat)
        with tasks.cancel.locked(self._lock):
            if self._lattices is None or self._lattices[0] != key:
                # Released before building new ones.
                self._lattices = None
                lattices = density_lattices(self.padded, sigma_hat, self.stencil, self.extent, tasks.each)
                self._lattices = key, lattices
            return self._lattices[1]
