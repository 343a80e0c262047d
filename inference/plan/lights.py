# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lights a render computes as suns, which as lamps, and which as light from everywhere."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from ..models.abilities import abilities
from ..scene.description import Medium, Sun, Surface, Volume
from ..scene.emitters import solid_angles
from ..scene.environment import Environment
from ..scene.lamps import Lamp
from ..scene.light import Families, Light
from ..scene.mesh_light import MeshLight
from ..scene.settings import Settings
from .directional_lights import directional_lights

AnyLight = TypeVar("AnyLight", bound=Light)

# Most surfaces that shine as lamps, the brightest; the others are what the middle of the volumes sees of them, as are
# those larger than the volumes which fill more of its view than so many steradians.
MESH_LIGHTS, AROUND = 8, 2.5
# Share of the fluence in any volume that lamps may have together and be skipped.
FAINT = 1e-4
# Middles of the eighths of a grid, over its size: where the light in a volume is measured.
EIGHTHS = np.array(np.meshgrid(*[(0.25, 0.75)] * 3)).reshape(3, -1).T
# Parallel lights that represent an environment where it is not computed as a whole.
DIRECTIONS = 12


def split_lights(
    lights: Sequence[Light], settings: Settings, planned: list[str], left_out: list[str]
) -> tuple[list[Sun], list[Environment]]:
    """Suns, those of the environments' peaks included, and the environments without them.

    Networks that know suns alone take environments as suns, too. Adds sentences to `planned` and `left_out`.
    """
    families = Families.of(lights)
    suns, bright = families.suns, shining(families.environments, left_out)
    parallel = not abilities(settings.model).every_light
    environments = []
    for environment in bright:
        rest, peaks = environment.without_peaks()
        if peaks:
            planned.append(f"{environment.name}: {len(peaks)} of its peaks as suns")
        suns += peaks
        if parallel:
            parallel_suns = directional_lights(rest, DIRECTIONS)
            planned.append(
                f"{environment.name}: as parallel light from {len(parallel_suns)} directions, since the network "
                f"{settings.model} knows suns alone"
            )
            suns += parallel_suns
        else:
            environments.append(rest)
    return suns, environments


def shining(lights: Sequence[AnyLight], left_out: list[str]) -> list[AnyLight]:
    """Lights that give light; adds sentences about the others to `left_out`."""
    left_out += [f"{light.name}: {light.darkness}" for light in lights if light.darkness]
    return [light for light in lights if not light.darkness]


def linking(lights: Sequence[Light], names: Sequence[str]) -> np.ndarray:
    """Whether lights light objects of some names, 0 or 1: float64 (objects, lights)."""
    lit = [[light.lights(name) for light in lights] for name in names]
    return np.array(lit, np.float64).reshape(len(names), len(lights))


def linked_lights(lights: Sequence[AnyLight], names: Sequence[str], left_out: list[str]) -> list[AnyLight]:
    """Lights that light any object of some names; adds sentences about the others to `left_out`."""
    lit_any = [any(light.lights(name) for name in names) for light in lights]
    left_out += [f"{light.name}: it lights nothing that is rendered" for light, lit in zip(lights, lit_any) if not lit]
    return [light for light, lit in zip(lights, lit_any) if lit]


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
        irradiance = np.array([suns[number].irradiance for number in parts])
        light = irradiance.sum(axis=1)
        shares = light / light.sum() if light.any() else np.full(len(parts), 1.0 / len(parts))
        return cls(
            replace(whole, irradiance=irradiance.sum(axis=0), receivers=suns[parts[0]].receivers),
            parts,
            shares.astype(np.float32),
        )


def predicted_suns(suns: Sequence[Sun]) -> list[PredictedSun]:
    """The suns with the parts of each soft one joined, in the order of their first parts."""
    wholes: dict[int, tuple[Sun, list[int]]] = {}
    for number, sun in enumerate(suns):
        whole = sun.part_of or sun
        wholes.setdefault(id(whole), (whole, []))[1].append(number)
    return [PredictedSun.joined(whole, parts, suns) for whole, parts in wholes.values()]


def without_faint(
    lamps: Sequence[Lamp], others: Sequence[Sun | Environment], boxes: Mapping[str, np.ndarray], left_out: list[str]
) -> list[Lamp]:
    """Lamps without those too weak or too far to matter beside all light; adds sentences about these to `left_out`.

    others: all other lights. boxes: corners (8, 3) of each volume's box, by its name.
    """
    if not lamps:
        return []
    most, total = np.zeros((len(boxes), len(lamps))), np.zeros(len(boxes))
    for v, (name, corners) in enumerate(boxes.items()):
        low, high = corners.min(axis=0), corners.max(axis=0)
        middle = 0.5 * (low + high)[None]
        total[v] = sum(light.mean_fluence() for light in others if light.lights(name))
        for k, lamp in enumerate(lamps):
            if lamp.lights(name):
                nearest, power = np.clip(lamp.centre, low, high)[None], float(lamp.power.mean())
                most[v, k] = power * sum(emitter.brightest(nearest)[0] for emitter in lamp.emitters(low, high, 1))
                total[v] += power * sum(emitter.fluence(middle)[0] for emitter in lamp.emitters(low, high, 1))
    # What a lamp gives somewhere may be all light, if it gives the middle none.
    shares = (most / np.maximum(np.maximum(total[:, None], most), 1e-300)).max(axis=0, initial=0.0)
    order = np.argsort(shares, kind="stable")
    faint = set(order[np.cumsum(shares[order]) <= FAINT].tolist())
    left_out += [f"{lamps[k].name}: too weak or too far to be seen beside other light" for k in sorted(faint)]
    return [lamp for k, lamp in enumerate(lamps) if k not in faint]


def lamp_shares(
    lamps: Sequence[Lamp], others: Sequence[Sun | Environment], boxes: Mapping[str, np.ndarray]
) -> np.ndarray:
    """Largest share (K,) of all light that each lamp gives at any of 8 points of a volume that it faces, shadows aside.

    others, boxes: as of `without_faint`.
    """
    shares = np.zeros(len(lamps))
    for name, corners in boxes.items() if lamps else ():
        low, high = corners.min(axis=0), corners.max(axis=0)
        points, lit = low + EIGHTHS * (high - low), [k for k, lamp in enumerate(lamps) if lamp.lights(name)]
        rest = sum(light.mean_fluence() for light in others if light.lights(name))
        given, most = np.zeros((2, len(lit), len(points)))
        for row, k in enumerate(lit):
            for emitter in lamps[k].emitters(low, high, 1):
                given[row] += float(lamps[k].power.mean()) * emitter.fluence(points)
                most[row] += float(lamps[k].power.mean()) * emitter.brightest(points)
        total = rest + given.sum(axis=0) - given + most
        shares[lit] = np.maximum(shares[lit], (most / np.maximum(total, 1e-300)).max(axis=1))
    return shares


def brightest_light(lights: Sequence[Light], volumes: Sequence[tuple[Volume, Medium]]) -> list[Light]:
    """The light that gives the volumes the most fluence, shadows aside; none if none lights any of them."""
    light_in_volumes = np.zeros(len(lights))
    for volume, _ in volumes:
        index = EIGHTHS * volume.density.shape - 0.5
        points = index @ volume.world_from_index[:3, :3].T + volume.world_from_index[:3, 3]
        for number, light in enumerate(lights):
            if light.lights(volume.name):
                light_in_volumes[number] += light.fluence_at(points).mean()
    return [lights[int(light_in_volumes.argmax())]] if light_in_volumes.any() else []


def mesh_lights(surfaces: Sequence[Surface], corners: np.ndarray) -> list[MeshLight]:
    """Surfaces that emit light and are lamps; corners: (N, 3), of the volumes."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    middle, glowing = 0.5 * (low + high), []
    for surface in surfaces:
        if not surface.emission.any() or not len(surface.triangles):
            continue
        light = MeshLight(surface)
        seen = solid_angles(surface.triangles - middle).sum() / (2.0 if light.closed else 1.0)
        if light.power.any() and (seen < AROUND or light.extent < (high - low).max()):
            square = max(float(((light.centre - middle) ** 2).sum()), float(((high - low) ** 2).sum()) / 4.0)
            glowing.append((float(light.power.mean()) / square, light))
    brightest = sorted(range(len(glowing)), key=lambda number: -glowing[number][0])[:MESH_LIGHTS]
    return [glowing[number][1] for number in sorted(brightest)]


def without_lamps(surfaces: Sequence[Surface], lamps: Sequence[Lamp]) -> list[Surface]:
    """Surfaces, those that are lamps without their emission."""
    return [
        replace(surface, emission=0.0) if any(surface is lamp.body for lamp in lamps) else surface
        for surface in surfaces
    ]


def reflects_light(surfaces: Sequence[Surface], settings: Settings, planned: list[str], left_out: list[str]) -> bool:
    """Whether the light that surfaces throw back or emit is rendered; adds sentences to `planned` and `left_out`."""
    lit = [surface.name for surface in surfaces if surface.shines]
    if not lit:
        return False
    names = lit[0] + (f" and {len(lit) - 1} more" if len(lit) > 1 else "")
    if not abilities(settings.model).every_light:
        left_out.append(f"light of {names}: the network {settings.model} knows suns alone")
        return False
    planned.append(f"light of {names}, as light from all around the volumes")
    return True
