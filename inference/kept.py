"""What one render leaves for the next: found again by what it was made from, so never out of date."""

import contextlib
import copy
import threading
from typing import List

import numpy as np

from .glow import Glow
from .grid import Grid
from .multiple import MultipleField
from .network import load_network
from .overlap import merge
from .scene import Sun, Volume
from .sparse_grid import SparseGrid
from .work import Work

SECONDS_A_LOOK = 0.05


class Kept:
    """The network, the grids with their optical depths towards suns, and the fields of the last render.

    Renders on several threads may share one: each gets grids of its own, and predicts alone.
    any_view: build fields for all of a volume, so that they serve from wherever it is looked at.
    """

    def __init__(self, any_view: bool = True):
        self.any_view = any_view
        self._lock = threading.Lock()
        self._networks, self._grids, self._fields, self._glows = {}, [], {}, {}

    def network(self, name: str, provider: str):
        """As `load_network`."""
        if (name, provider) not in self._networks:
            self._networks = {(name, provider): load_network(name, provider)}
        return self._networks[name, provider]

    def grids(self, volumes: List[Volume], suns: List[Sun], work: Work) -> List[Grid]:
        """A Grid of each volume with all suns, for the caller alone. Raises Cancelled."""
        found = []
        for volume in volumes:
            work.check()
            work.progress(0.0, f"shadows of {volume.name}")
            known = next((grid for other, grid in self._grids if _same(other, volume)), None)
            grid = copy.copy(known) if known else Grid(volume)
            depths = {bytes(direction): depth for direction, depth in zip(grid.sun_directions, grid.sun_depths)}
            grid.sun_directions, grid.sun_depths = [], []
            for sun in suns:
                work.check()
                grid.add_sun(sun.direction, work.check, depths)
            found.append((volume, grid))
        self._grids = found
        return [grid for _, grid in found]

    @contextlib.contextmanager
    def predicting(self, work: Work):
        """Inside, no other thread uses the fields. Raises Cancelled while it waits for that."""
        while not self._lock.acquire(timeout=SECONDS_A_LOOK):
            work.check()
        try:
            yield
        finally:
            self._lock.release()

    def field(self, network, groups, number: int, grids, check=lambda: None) -> MultipleField:
        """The field of one of a render's groups of volumes that are seen as one.

        groups: lists of pairs of Volume and Medium; grids: a Grid of each of this group's; check: asked often while it
        is made.
        """
        pairs = groups[number]
        self._fields = {n: kept for n, kept in self._fields.items()
                        if n < len(groups) and (n != number or _serves(*kept, network, pairs))}
        if number not in self._fields:
            volume, medium = pairs[0]
            if len(pairs) > 1:
                names = " and ".join(volume.name for volume, _ in pairs)
                volume, medium = merge(grids, [medium for _, medium in pairs], names, check)
            self._fields[number] = pairs, MultipleField(network, volume, medium, check)
        field = self._fields[number][1]
        if len(pairs) == 1:
            field.volume, field.medium = pairs[0]
        return field

    def glow(self, groups, number: int, grids, check=lambda: None) -> Glow:
        """The light that one of a render's groups of volumes emits and scatters; arguments as of `field`."""
        pairs = groups[number]
        self._glows = {n: kept for n, kept in self._glows.items()
                       if n < len(groups) and (n != number or _alike(kept[0], pairs))}
        if number not in self._glows:
            self._glows[number] = pairs, Glow(grids, [medium for _, medium in pairs], check)
        return self._glows[number][1]


def _same(a: Volume, b: Volume) -> bool:
    """Whether two volumes hold the same density and emission in the same place."""
    return a is b or (np.array_equal(a.world_from_index, b.world_from_index) and a.emission_power == b.emission_power
                      and _equal([a.density, *a.emission_channels()], [b.density, *b.emission_channels()]))


def _equal(some, others) -> bool:
    return len(some) == len(others) and all(
        a is b or (a.equals(b) if isinstance(a, SparseGrid) else np.array_equal(a, b)) for a, b in zip(some, others))


def _serves(made_of, field: MultipleField, network, pairs) -> bool:
    """Whether a field that was made of some pairs of Volume and Medium serves for others."""
    if field.system is not network or len(made_of) != len(pairs):
        return False
    if len(pairs) > 1:
        return _alike(made_of, pairs)
    (old, before), (new, after) = made_of[0], pairs[0]
    return _same(old, new) and before.anisotropy == after.anisotropy


def _alike(made_of, pairs) -> bool:
    """Whether pairs of Volume and Medium are the same, in every number."""
    return len(made_of) == len(pairs) and all(
        _same(old, new) and before.anisotropy == after.anisotropy and before.emission == after.emission
        and np.array_equal(before.sigma_t, after.sigma_t) and np.array_equal(before.albedo, after.albedo)
        for (old, before), (new, after) in zip(made_of, pairs))
