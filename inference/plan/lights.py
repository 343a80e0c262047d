# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lights a render computes as suns, which as lamps, and which as light from everywhere."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..scene.description import Sun, Surface
from ..scene.environment import Environment
from ..scene.lamps import LAMPS, Lamp
from ..scene.settings import Settings
from .directional_lights import directional_lights

Light = Sun | Lamp | Environment

#: Networks beside which there is one for light from everywhere.
ENVIRONMENT_MODELS = frozenset({"mrpnn"})
#: Networks that know lamps: those that read the light along camera rays.
LAMP_MODELS = frozenset({"mrpnn"})
#: Why environments are computed as suns where a scene has surfaces.
SURFACES_SHADOW = "surfaces shadow it"
# Parallel lights that represent an environment where it is not computed as a whole.
DIRECTIONS = 12


def split_lights(
    lights: Sequence[Light], settings: Settings, parallel: str, planned: list[str], left_out: list[str]
) -> tuple[list[Sun], list[Environment]]:
    """Suns, those of the environments' peaks included, and the environments without them.

    parallel: why environments are computed as suns, "" where they need not be. Adds sentences to `planned` and
    `left_out`.
    """
    suns = [light for light in lights if isinstance(light, Sun)]
    bright = []
    for light in lights:
        if isinstance(light, Environment):
            if light.radiance.any():
                bright.append(light)
            else:
                left_out.append(f"{light.name}: it is black")
    if settings.model not in ENVIRONMENT_MODELS:
        parallel = f"the network {settings.model} knows suns alone"
    environments = []
    for environment in bright:
        rest, peaks = environment.without_peaks()
        if peaks:
            planned.append(f"{environment.name}: {len(peaks)} of its peaks as suns")
        suns += peaks
        if parallel:
            found = directional_lights(rest, DIRECTIONS)
            planned.append(f"{environment.name}: as parallel light from {len(found)} directions, since {parallel}")
            suns += found
        else:
            environments.append(rest)
    return suns, environments


@dataclass(frozen=True)
class PredictedSun:
    """A sun whose multiple scattering is predicted, and which of the suns that rays are marched for are its parts.

    sun: with the irradiance of all parts. parts: numbers (n,) of them. shares: float32 (n,), of its light, sum to 1.
    """

    sun: Sun
    parts: list[int]
    shares: np.ndarray

    @classmethod
    def joined(cls, whole: Sun, parts: list[int], suns: Sequence[Sun]) -> "PredictedSun":
        """parts: numbers of some suns."""
        irradiance = np.array([suns[part].irradiance for part in parts])
        light = irradiance.sum(axis=1)
        shares = light / light.sum() if light.any() else np.full(len(parts), 1.0 / len(parts))
        return cls(replace(whole, irradiance=irradiance.sum(axis=0)), parts, shares.astype(np.float32))


def predicted_suns(suns: Sequence[Sun]) -> list[PredictedSun]:
    """The suns with the parts of each soft one joined, in the order of their first parts."""
    wholes: dict[int, tuple[Sun, list[int]]] = {}
    for number, sun in enumerate(suns):
        whole = sun.part_of or sun
        wholes.setdefault(id(whole), (whole, []))[1].append(number)
    return [PredictedSun.joined(whole, parts, suns) for whole, parts in wholes.values()]


def needed_lamps(lights: Sequence[Light], left_out: list[str]) -> list[Lamp]:
    """Lamps that emit light; adds sentences about the others to `left_out`."""
    lamps = [light for light in lights if isinstance(light, LAMPS)]
    left_out += [f"{lamp.name}: its power is 0" for lamp in lamps if not lamp.power.any()]
    return [lamp for lamp in lamps if lamp.power.any()]


def reflects_light(surfaces: Sequence[Surface], settings: Settings, planned: list[str], left_out: list[str]) -> bool:
    """Whether the light that surfaces throw back or emit is rendered; adds sentences to `planned` and `left_out`."""
    shining = [surface.name for surface in surfaces if surface.shines]
    if not shining:
        return False
    names = shining[0] + (f" and {len(shining) - 1} more" if len(shining) > 1 else "")
    if settings.model not in ENVIRONMENT_MODELS:
        left_out.append(f"light of {names}: the network {settings.model} knows suns alone")
        return False
    planned.append(f"light of {names}, as an environment around the middle of the volumes")
    return True
