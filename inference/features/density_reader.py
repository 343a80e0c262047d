# SPDX-License-Identifier: GPL-3.0-or-later
"""A volume's density as networks read it at their stencils."""

import threading
import weakref

import numpy as np

from ..grids.working_cube import Cube, extent
from ..numerics.alike import alike
from ..runtime.cancellation import NEVER, CancelToken
from ..runtime.tasks import AnyTasks
from ..scene.description import Volume
from .mip_lattices import Lattices, ThinnerLattices, density_lattices, inner_cells, padded_pyramid
from .stencil import Stencil

# Instances that differ by less than this factor in optical thickness share lattices.
SHARED_RANGE = 16.0


class DensityReader:
    """The padded pyramid of a volume, and its lattices for the last optical thickness. Safe on several threads.

    stencil: whose points read it; levels finer than its finest are empty. extent: lowest and highest coordinates (3,),
    in the cube's frame, of points with density. readers: instances that read it, perhaps of several sizes. Raises
    Cancelled.
    """

    def __init__(self, volume: Volume, cube: Cube, stencil: Stencil, cancel: CancelToken = NEVER):
        self.stencil, self.extent = stencil, extent(volume, cube)
        self.padded = padded_pyramid(volume, cube, stencil, cancel)
        self.readers: weakref.WeakSet[object] = weakref.WeakSet()
        self._lock = threading.Lock()
        self._lattices: tuple[tuple[float, ...], Lattices] | None = None
        # Those in use, by the optical thickness for which they were built.
        self._shared: weakref.WeakValueDictionary[float, Lattices] = weakref.WeakValueDictionary()

    def level(self, m: int) -> np.ndarray:
        """The cells of level m that lie in the cube, or of the finest."""
        m = max(m, self.stencil.finest)
        return inner_cells(self.padded[m], m, self.stencil)

    def lattices(self, sigma_hat: float, tasks: AnyTasks) -> Lattices:
        """As `density_lattices`; they serve every light. Raises Cancelled."""
        key = alike(sigma_hat)
        with tasks.cancel.locked(self._lock):
            if len(self.readers) > 1:
                thickest = SHARED_RANGE ** float(np.ceil(np.log(max(sigma_hat, 1e-30)) / np.log(SHARED_RANGE)))
                known = self._shared.get(thickest)
                if known is None:
                    known = density_lattices(self.padded, thickest, self.stencil, self.extent, tasks.each)
                    self._shared[thickest] = known
                return ThinnerLattices(known, sigma_hat / thickest)
            if self._lattices is None or self._lattices[0] != key:
                # Released before building new ones.
                self._lattices = None
                lattices = density_lattices(self.padded, sigma_hat, self.stencil, self.extent, tasks.each)
                self._lattices = key, lattices
            return self._lattices[1]
