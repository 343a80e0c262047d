# SPDX-License-Identifier: GPL-3.0-or-later
"""Several distant lamps whose light is gathered, and predicted, as that of a single lamp of many parts."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from ..grids.bound_medium import BoundMedium
from ..grids.lamp_optical_depth import LampOpticalDepth
from ..occluders.lamp_shadow_map import LampShadowMap
from ..scene.emitters import Emitter
from .lamp_in_media import LampInMedia


@dataclass(frozen=True)
class JoinedLamps:
    """Lamps outside the volumes, in about the same direction as these see them: a lamp of power 1.

    lamps: n of them. middle: (3,) of the volumes.
    """

    lamps: Sequence[LampInMedia]
    middle: np.ndarray

    @property
    def count(self) -> int:
        """As of LampInMedia."""
        return len(self.lamps)

    @cached_property
    def power(self) -> np.ndarray:
        """Power (3,) of all of them, W."""
        return np.sum([lamp.lamp.power for lamp in self.lamps], axis=0)

    @cached_property
    def powers(self) -> np.ndarray:
        """Power (n,) of each lamp over the sum."""
        powers = np.array([lamp.lamp.power.sum() for lamp in self.lamps])
        return powers / powers.sum() if powers.any() else np.full(len(powers), 1.0 / len(powers))

    @cached_property
    def emitters(self) -> list[Emitter]:
        """As of LampInMedia: those of all of them."""
        return [
            emitter.dimmed(float(power)) for lamp, power in zip(self.lamps, self.powers) for emitter in lamp.emitters
        ]

    @property
    def depths(self) -> list[list[LampOpticalDepth]]:
        """As of LampInMedia."""
        return [depths for lamp in self.lamps for depths in lamp.depths]

    @property
    def shadow_maps(self) -> list[LampShadowMap] | None:
        """As of LampInMedia; surfaces shadow the volumes from all of the lamps or from none."""
        shadow_maps = [shadow_map for lamp in self.lamps for shadow_map in lamp.shadow_maps or []]
        return shadow_maps or None

    @cached_property
    def reach(self) -> float:
        """As of LampInMedia, around the centre."""
        away = [np.linalg.norm(emitter.position - self.centre) + emitter.extent for emitter in self.emitters]
        return float(max(away))

    def smooth(self, media: Sequence[BoundMedium]) -> float:
        """As of LampInMedia."""
        return min(lamp.smooth(media) for lamp in self.lamps)

    def within(self, volumes: Sequence[int]) -> "JoinedLamps":
        """As of LampInMedia."""
        return replace(self, lamps=[lamp.within(volumes) for lamp in self.lamps])

    @cached_property
    def coarse(self) -> list[Emitter]:
        """As of LampInMedia."""
        return [emitter.dimmed(float(power)) for lamp, power in zip(self.lamps, self.powers) for emitter in lamp.coarse]

    @cached_property
    def coarse_shadow_maps(self) -> list[LampShadowMap | None] | None:
        """As of LampInMedia, None for the emitters that nothing shadows."""
        shadow_maps: list[LampShadowMap | None] = []
        for lamp in self.lamps:
            shadow_maps += lamp.coarse_shadow_maps or [None] * len(lamp.coarse)
        return shadow_maps if any(shadow_map is not None for shadow_map in shadow_maps) else None

    @cached_property
    def key(self) -> bytes:
        """As of LampInMedia."""
        digest = hashlib.blake2b(self.powers.tobytes(), digest_size=16)
        for lamp in self.lamps:
            digest.update(lamp.key)
        return digest.digest()

    @cached_property
    def centre(self) -> np.ndarray:
        """(3,), where most of their light seems to come from, in the world."""
        away = np.array([lamp.centre for lamp in self.lamps]) - self.middle
        distance, light = np.linalg.norm(away, axis=1), self.shares(self.middle[None])[0]
        direction = light @ (away / distance[:, None])
        return self.middle + direction / (np.linalg.norm(direction) * (light @ (1.0 / distance)))

    def fluence(self, points: np.ndarray) -> np.ndarray:
        """As of LampInMedia."""
        return np.sum([power * lamp.fluence(points) for lamp, power in zip(self.lamps, self.powers)], axis=0)

    def reference(self, points: np.ndarray) -> np.ndarray:
        """As of LampInMedia."""
        return self._references(points).sum(axis=1)

    def shares(self, points: np.ndarray) -> np.ndarray:
        """Fractions float32 (N, n) of the light at points (N, 3) that each lamp gives, without attenuation."""
        references = self._references(points)
        return (references / np.maximum(references.sum(axis=1), 1e-300)[:, None]).astype(np.float32)

    def _references(self, points: np.ndarray) -> np.ndarray:
        references = [power * lamp.reference(points) for lamp, power in zip(self.lamps, self.powers)]
        return np.stack(references, axis=1)


#: What is predicted as one lamp.
PredictedLamp = LampInMedia | JoinedLamps


def predicted_lamps(
    lamps: Sequence[LampInMedia], clusters: Sequence[Sequence[int]], middle: np.ndarray
) -> list[PredictedLamp]:
    """One lamp for each cluster of lamps, by number; middle: (3,) of the volumes."""
    return [
        lamps[cluster[0]] if len(cluster) == 1 else JoinedLamps([lamps[k] for k in cluster], middle)
        for cluster in clusters
    ]
