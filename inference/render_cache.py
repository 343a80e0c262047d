# SPDX-License-Identifier: GPL-3.0-or-later
"""Content-keyed cache shared between renders."""

import threading
import weakref
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from .grids.bound_medium import BoundMedium
from .grids.grid import Grid, Voxels
from .grids.merge import join, merge
from .grids.working_cube import fit_cube
from .marching.joined_lamps import PredictedLamp
from .marching.lamp_in_media import LampInMedia, lamp_key, place_lamp
from .marching.mean_lamp_depth import MeanLampDepth, mean_lamp_depth
from .network.environment_network import EnvironmentNetwork, load_environment_network
from .network.interfaces import System
from .network.network import load_network
from .network.predictor import VolumePredictor
from .network.uncertainty import UncertaintyNetwork, has_uncertainty, load_uncertainty_network
from .plan.overlap import group_name
from .plan.resolution import USUAL, Coarser
from .runtime.cancellation import NEVER, CancelToken
from .runtime.tasks import Tasks
from .scene.description import Medium, Surface, Volume
from .scene.lamps import Lamp
from .transport.scattered_emission import ScatteredEmission

Loaded = TypeVar("Loaded")
# Volumes with their media.
Members = Sequence[tuple[Volume, Medium]]


@dataclass(frozen=True)
class ScatteringGroup:
    """Volumes that the network treats as one medium: a Volume and Medium that represent them, and their predictor."""

    volume: Volume
    medium: Medium
    predictor: VolumePredictor


class RenderCache:
    """Networks, grids, predictors and scattered emission of earlier renders, keyed by what they were made from.

    Never out of date, as long as the arrays of rendered volumes are not modified in place. Safe to share between
    renders on several threads. Holds every network that was asked for, and the rest as of the last render, until it is
    dropped. Every method raises Cancelled.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._networks: dict[Hashable, Any] = {}
        self._grids: list[tuple[Volume, Grid]] = []
        self._lamps: list[tuple[Sequence[Grid], LampInMedia]] = []
        self._mean_depths: dict[tuple[bytes, float], tuple[Grid, MeanLampDepth]] = {}
        self._used_depths: set[tuple[bytes, float]] = set()
        self._merged: dict[int, tuple[Members, tuple[Volume, Medium]]] = {}
        self._joined: list[tuple[float, Members, tuple[Volume, Medium]]] = []
        self._predictors: dict[int, VolumePredictor] = {}
        self._instances: weakref.WeakValueDictionary[Hashable, VolumePredictor] = weakref.WeakValueDictionary()
        self._emission: dict[int, tuple[Members, ScatteredEmission]] = {}

    def network(self, name: str, provider: str, cancel: CancelToken = NEVER) -> System:
        """As `load_network`; loads each network once per provider."""
        return self._loaded(load_network, name, provider, cancel=cancel)

    def environment_network(self, model: str, provider: str, cancel: CancelToken = NEVER) -> EnvironmentNetwork:
        """As `load_environment_network`; loads each network once per provider."""
        return self._loaded(load_environment_network, model, provider, cancel=cancel)

    def uncertainty_network(self, model: str, cancel: CancelToken = NEVER) -> UncertaintyNetwork | None:
        """As `load_uncertainty_network`, once; None where none stands beside a network."""
        return self._loaded(load_uncertainty_network, model, cancel=cancel) if has_uncertainty(model) else None

    def _loaded(self, load: Callable[..., Loaded], *names: str, cancel: CancelToken) -> Loaded:
        with cancel.locked(self._lock):
            if (load, names) not in self._networks:
                self._networks[load, names] = load(*names)
            return self._networks[load, names]

    def grids(self, volumes: Sequence[Volume], cancel: CancelToken = NEVER) -> list[Grid]:
        """Grid of each volume."""
        with cancel.locked(self._lock):
            found = []
            voxels = {grid.voxels.source.voxels_key: grid.voxels for _, grid in self._grids}
            places: dict[bytes, list[tuple[Volume, Grid]]] = {}
            for other, grid in self._grids:
                places.setdefault(other.world_from_index.tobytes(), []).append((other, grid))
            for volume in volumes:
                cancel.check()
                here = places.get(volume.world_from_index.tobytes(), ())
                known = next((grid for other, grid in here if _same_volume(other, volume)), None)
                grid = known or Grid(volume, voxels.get(volume.voxels_key) or Voxels(volume))
                voxels[volume.voxels_key] = grid.voxels
                found.append((volume, grid))
            self._grids = found
            return [grid for _, grid in found]

    def lamps(
        self,
        lamps: Sequence[Lamp],
        shares: np.ndarray,
        grids: Sequence[Grid],
        surfaces: Sequence[Surface] = (),
        cancel: CancelToken = NEVER,
    ) -> list[LampInMedia]:
        """As `place_lamp`, of each lamp and its share of the light."""
        with cancel.locked(self._lock):
            found: list[LampInMedia] = []
            for lamp, share in zip(lamps, shares):
                key = lamp_key(lamp, grids, surfaces, share)
                known = (placed for others, placed in self._lamps if placed.key == key and _same_grids(others, grids))
                placed = next(known, None)
                if placed is None:
                    placed = place_lamp(lamp, grids, surfaces, cancel, share)
                # Its power may have changed.
                found.append(replace(placed, lamp=lamp))
            self._lamps = [(grids, placed) for placed in found]
            # Those of the last render.
            self._mean_depths = {key: self._mean_depths[key] for key in self._used_depths}
            self._used_depths.clear()
            return found

    def mean_lamp_depth(self, lamp: PredictedLamp, medium: BoundMedium, tasks: Tasks) -> MeanLampDepth:
        """As the function of that name, for a lamp in one medium alone."""
        key = lamp.key, medium.sigma_t
        with tasks.cancel.locked(self._lock):
            known = self._mean_depths.pop(key, None)
            if known is None or known[0] is not medium.grid:
                known = medium.grid, mean_lamp_depth(lamp, medium, tasks)
            self._mean_depths[key] = known
            self._used_depths.add(key)
            return known[1]

    def group(
        self,
        network: System,
        members: Members,
        grids: Sequence[Grid],
        number: int,
        coarser: Coarser = USUAL,
        cancel: CancelToken = NEVER,
    ) -> ScatteringGroup:
        """The ScatteringGroup of some volumes.

        grids: Grid of each member. number: of the group in its render; replaces the group that had it before.
        """
        with cancel.locked(self._lock):
            volume, medium = members[0] if len(members) == 1 else self._merge(members, grids, number, cancel)
            known: VolumePredictor | None = self._predictors.get(number)
            if known is None or known.resolution != coarser or not _serves(known, network, volume, medium):
                self._predictors.pop(number, None)
                bounds = grids[0].voxels.filled if len(grids) == 1 else None
                cube = replace(fit_cube(volume, bounds), finest=coarser.density)
                key = id(network), volume.voxels_key, cube.in_voxels(volume)
                like = self._instances.get((*key, medium.anisotropy), self._instances.get(key))
                known = VolumePredictor(network, volume, medium.anisotropy, cancel, cube, like, coarser.transport)
                self._predictors[number] = self._instances[*key, medium.anisotropy] = self._instances[key] = known
            return ScatteringGroup(volume, medium, known)

    def joined(
        self, wanted: Sequence[tuple[Members, str, float]], cancel: CancelToken = NEVER
    ) -> list[tuple[Volume, Medium]]:
        """As `join`, of some volumes each; wanted: volumes, the name and the edge of voxels of each."""
        with cancel.locked(self._lock):
            found = []
            for members, name, edge in wanted:
                alike = (known for known in self._joined if known[0] == edge and _same_members(known[1], members))
                known = next(alike, None)
                if known is None:
                    voxels = {volume.voxels_key: Voxels(volume) for volume, _ in members}
                    grids = [Grid(volume, voxels[volume.voxels_key]) for volume, _ in members]
                    known = edge, members, join(grids, [medium for _, medium in members], name, edge, cancel)
                found.append(known)
            self._joined = found
            return [pair for _, _, pair in found]

    def scattered_emission(
        self,
        members: Members,
        grids: Sequence[Grid],
        number: int,
        cancel: CancelToken = NEVER,
    ) -> ScatteredEmission:
        """Light that a group of volumes emits and scatters; arguments as for `group`."""
        with cancel.locked(self._lock):
            known = self._emission.pop(number, None)
            if known is None or not _same_members(known[0], members):
                known = members, ScatteredEmission(grids, [medium for _, medium in members], cancel)
            self._emission[number] = known
            return known[1]

    def keep_groups(self, count: int) -> None:
        """Drop the groups from number `count` on."""
        with self._lock:
            groups: tuple[dict[int, Any], ...] = self._merged, self._predictors, self._emission
            for cached in groups:
                for number in [number for number in cached if number >= count]:
                    del cached[number]

    def _merge(
        self,
        members: Members,
        grids: Sequence[Grid],
        number: int,
        cancel: CancelToken,
    ) -> tuple[Volume, Medium]:
        """Members of a group as one medium."""
        known = self._merged.pop(number, None)
        if known is None or not _same_members(known[0], members):
            known = members, merge(grids, [medium for _, medium in members], group_name(members), cancel)
        self._merged[number] = known
        return known[1]


def _same_grids(a: Sequence[Grid], b: Sequence[Grid]) -> bool:
    return len(a) == len(b) and all(one is other for one, other in zip(a, b))


def _same_volume(a: Volume, b: Volume) -> bool:
    """Whether two volumes hold equal density and emission at the same place."""
    return a is b or a.same_content(b)


def _serves(predictor: VolumePredictor, network: System, volume: Volume, medium: Medium) -> bool:
    """Whether a predictor was made from the same network, volume and anisotropy."""
    return (
        predictor.network is network
        and predictor.requested_anisotropy == medium.anisotropy
        and _same_volume(predictor.volume, volume)
    )


def _same_members(made_of: Members, members: Members) -> bool:
    """Whether pairs of Volume and Medium are equal in every number."""
    return len(made_of) == len(members) and all(
        _same_volume(old, new) and before.same_coefficients(after)
        for (old, before), (new, after) in zip(made_of, members)
    )
