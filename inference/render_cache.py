"""Content-keyed cache shared between renders."""

import threading
from dataclasses import dataclass

from .grids.grid import Grid
from .grids.merge import merge
from .network.network import load_network
from .network.predictor import VolumePredictor
from .runtime.cancellation import NEVER, CancelToken
from .scene.description import Medium, Volume
from .transport.scattered_emission import ScatteredEmission


@dataclass(frozen=True)
class ScatteringGroup:
    """Volumes that the network takes as one medium: a Volume and Medium that stand for them, and what predicts there."""

    volume: Volume
    medium: Medium
    predictor: VolumePredictor


class RenderCache:
    """Networks, grids, predictors and scattered emission of the last render, found again by what they were made from.

    It is never out of date, and its memory is held until it is dropped. Renders on several threads may share one. Every
    method raises Cancelled. any_view: whether lookup lattices are built for all of a volume, to serve other views too,
    rather than for what one view shows of it.
    """

    def __init__(self, any_view: bool = True):
        self.any_view = any_view
        self._lock = threading.Lock()
        self._networks, self._grids, self._merged, self._predictors, self._emission = {}, [], {}, {}, {}

    def network(self, name: str, provider: str, cancel: CancelToken = NEVER):
        """As `load_network`."""
        with cancel.locked(self._lock):
            if (name, provider) not in self._networks:
                self._networks = {(name, provider): load_network(name, provider)}
            return self._networks[name, provider]

    def grids(self, volumes: list[Volume], cancel: CancelToken = NEVER) -> list[Grid]:
        """A Grid of each volume."""
        with cancel.locked(self._lock):
            found = []
            for volume in volumes:
                cancel.check()
                known = next((grid for other, grid in self._grids if _same_volume(other, volume)), None)
                found.append((volume, known or Grid(volume)))
            self._grids = found
            return [grid for _, grid in found]

    def group(self, network, members, grids: list[Grid], number: int, cancel: CancelToken = NEVER) -> ScatteringGroup:
        """One group of volumes.

        members: pairs of Volume and Medium; grids: a Grid of each; number: of the group in its render, whose predecessor
        there is given up.
        """
        with cancel.locked(self._lock):
            volume, medium = members[0] if len(members) == 1 else self._merge(members, grids, number, cancel)
            known: VolumePredictor | None = self._predictors.get(number)
            if known is None or not _serves(known, network, volume, medium):
                self._predictors.pop(number, None)
                known = self._predictors[number] = VolumePredictor(network, volume, medium.anisotropy, cancel)
            return ScatteringGroup(volume, medium, known)

    def scattered_emission(self, members, grids, number: int, cancel: CancelToken = NEVER) -> ScatteredEmission:
        """The light that a group of volumes emits and scatters; arguments as for `group`."""
        with cancel.locked(self._lock):
            known = self._emission.pop(number, None)
            if known is None or not _same_members(known[0], members):
                known = members, ScatteredEmission(grids, [medium for _, medium in members], cancel)
            self._emission[number] = known
            return known[1]

    def keep_groups(self, count: int) -> None:
        """Give up what groups beyond a render's `count` have left."""
        with self._lock:
            for kept in (self._merged, self._predictors, self._emission):
                for number in [number for number in kept if number >= count]:
                    del kept[number]

    def _merge(self, members, grids, number, cancel):
        known = self._merged.pop(number, None)
        if known is None or not _same_members(known[0], members):
            names = " and ".join(volume.name for volume, _ in members)
            known = members, merge(grids, [medium for _, medium in members], names, cancel)
        self._merged[number] = known
        return known[1]


def _same_volume(a: Volume, b: Volume) -> bool:
    """Whether two volumes hold the same density and emission in the same place."""
    return a is b or a.same_content(b)


def _serves(predictor: VolumePredictor, network, volume: Volume, medium: Medium) -> bool:
    """Whether a predictor was made of the same network, volume and anisotropy."""
    return predictor.network is network and predictor.requested_anisotropy == medium.anisotropy and _same_volume(
        predictor.volume, volume)


def _same_members(made_of, members) -> bool:
    """Whether pairs of Volume and Medium are the same, in every number."""
    return len(made_of) == len(members) and all(
        _same_volume(old, new) and before.same_coefficients(after)
        for (old, before), (new, after) in zip(made_of, members))
