# SPDX-License-Identifier: GPL-3.0-or-later
"""A procedural volume with lights of every kind and albedos that vary, drawn from a seed.

All is in the frame of the volume's cube, [-1/2, 1/2]^3, and follows from the seed. Suns have irradiance 1, lamps a
radiant intensity of 1 per sr, environments a mean radiance of 1. Emission is at most 1 per cube edge of path length.
"""

from dataclasses import dataclass

import numpy as np

from inference import PointLight, SpotLight
from training.data.environments import random_environment
from training.data.targets import ALBEDOS, draw_albedos, draw_anisotropy, draw_sigma, rays_towards, unit_vectors
from training.procedural.noise import Fractal
from training.procedural.seeded_volume import seeded_volume
from training.tracer.density_grid import DensityGrid
from training.tracer.light_paths import AlbedoField, Lights, LitMedium
from training.tracer.path_tracer import sample_scattering_points

MEDIA, SUNS, ENVIRONMENTS = 4, 2, 4
#: Lamps, in order; and the fields of emission.
LAMPS = ("outside", "edge", "inside", "soft", "spot")
EMISSIONS = ("glowing density", "flame")
#: How the albedo of a medium varies: not at all, in soft and in sharp patches, along an axis, or with the density.
ALBEDO_KINDS = ("uniform", "soft", "sharp", "slope", "density")
#: Part of the points that are drawn around lamps, and their distances from these, in cube edges.
AROUND_LAMPS, LAMP_DISTANCES = 0.25, (0.004, 0.3)
#: Edge of the lattice of means by which a field is recognised.
MARK = 8


@dataclass(frozen=True)
class LightScene:
    """density: float32 (N, N, N), of largest value 1. media: LitMedium each. albedo_kinds: of the media."""

    seed: int
    density: np.ndarray
    lights: Lights
    media: tuple[LitMedium, ...]
    albedo_kinds: tuple[str, ...]

    def marks(self) -> dict[str, np.ndarray]:
        """Means over MARK^3 blocks of the density, the emission and the albedos' masks, float32.

        They tell whether a volume made anew is the one that was traced, whatever the last bits are.
        """
        masks = [np.zeros_like(self.density) if m.albedo.mask is None else m.albedo.mask for m in self.media]
        return {
            "density_blocks": _block_means(self.density),
            "emission_blocks": np.stack([_block_means(field) for field in np.moveaxis(self.lights.emission, 3, 0)]),
            "mask_blocks": np.stack([_block_means(mask) for mask in masks]),
        }

    def parameters(self) -> dict[str, np.ndarray]:
        """What a file keeps of the scene, beside positions and radiance."""
        lamps, media = self.lights.lamps, self.media
        spots = [isinstance(lamp, SpotLight) for lamp in lamps]
        return {
            "seed": np.int64(self.seed),
            "cells": np.int64(len(self.density)),
            "sigma": np.float32([medium.sigma for medium in media]),
            "anisotropy": np.float32([medium.anisotropy for medium in media]),
            "albedo_kind": np.array(self.albedo_kinds),
            "albedo_low": np.float32([medium.albedo.low for medium in media]),
            "albedo_high": np.float32([medium.albedo.high for medium in media]),
            "suns": self.lights.suns.astype(np.float32),
            "lamp_kind": np.array(LAMPS),
            "lamp_position": np.float32([lamp.position for lamp in lamps]),
            "lamp_radius": np.float32([lamp.radius for lamp in lamps]),
            "lamp_soft_falloff": np.array([lamp.soft_falloff for lamp in lamps]),
            "lamp_direction": np.float32([lamp.direction if spot else (0, 0, 0) for lamp, spot in zip(lamps, spots)]),
            "lamp_angle": np.float32([lamp.angle if spot else 2 * np.pi for lamp, spot in zip(lamps, spots)]),
            "lamp_blend": np.float32([lamp.blend if spot else 0 for lamp, spot in zip(lamps, spots)]),
            "environments": self.lights.environments.astype(np.float16),
            "emission_kind": np.array(EMISSIONS),
            **self.marks(),
        }


@dataclass(frozen=True)
class LightPoints:
    """Vertices of camera paths. positions, omega: (P, 3), omega along the ray; medium, lamp: int (P,).

    lamp: number of the lamp around which a point was drawn; -1 where a camera ray scatters first.
    """

    positions: np.ndarray
    omega: np.ndarray
    medium: np.ndarray
    lamp: np.ndarray


def light_scene(seed: int) -> tuple[LightScene, np.random.Generator]:
    """The scene of a seed, and the generator that draws its points."""
    volume, _ = seeded_volume(seed)
    density, random = volume.density, np.random.default_rng([seed, 54])
    lights = Lights(
        unit_vectors(random, SUNS),
        _draw_lamps(random, density),
        _draw_environments(random),
        np.stack([_glowing_density(random, density), _flame(random, density)], axis=3),
    )
    sigmas, anisotropies = draw_sigma(random, MEDIA), draw_anisotropy(random, MEDIA)
    # Half of the media have one albedo, the others one that varies.
    kinds = ["uniform"] * (MEDIA // 2) + list(random.choice(ALBEDO_KINDS[1:], MEDIA - MEDIA // 2, replace=False))
    kinds = [str(kind) for kind in random.permutation(kinds)]
    media = [
        LitMedium(float(sigma), float(g), _draw_albedo(random, density, kind))
        for sigma, g, kind in zip(sigmas, anisotropies, kinds)
    ]
    return LightScene(seed, density, lights, tuple(media), tuple(kinds)), random


def draw_light_points(scene: LightScene, grid: DensityGrid, random, count: int) -> LightPoints:
    """Up to `count` points: where camera rays scatter first, and around lamps; sorted by medium."""
    near = int(round(AROUND_LAMPS * count))
    medium = random.integers(len(scene.media), size=count)
    half = (count - near) // 2
    omega = np.concatenate([rays_towards(random, scene.lights.suns, half), unit_vectors(random, count - near - half)])
    sigma = np.float32([m.sigma for m in scene.media])[medium[: count - near]]
    seen, valid = sample_scattering_points(grid, sigma, omega.astype(np.float32), scene.seed)
    around, ways, lamp = _around_lamps(random, scene, near)
    positions, omega = np.concatenate([seen[valid], around]), np.concatenate([omega[valid], ways])
    medium = np.concatenate([medium[: count - near][valid], medium[count - near :][: len(around)]])
    lamp = np.concatenate([np.full(int(valid.sum()), -1), lamp])
    order = np.argsort(medium, kind="stable")
    return LightPoints(positions[order].astype(np.float32), omega[order].astype(np.float32), medium[order], lamp[order])


def _around_lamps(random, scene: LightScene, count: int):
    """Positions and ray directions (P, 3) near lamps, where the medium is, and lamps' numbers (P,); P <= count."""
    tries = 16 * count
    lamp = random.integers(len(LAMPS), size=tries)
    low, high = np.log(LAMP_DISTANCES)
    offset = unit_vectors(random, tries) * np.exp(random.uniform(low, high, (tries, 1)))
    centre = np.array([lamp.position for lamp in scene.lights.lamps])
    positions = centre[lamp] + offset
    cells = len(scene.density)
    inside = np.abs(positions).max(axis=1) < 0.5
    index = ((positions + 0.5) * cells).astype(int).clip(0, cells - 1)
    chosen = np.flatnonzero(inside & (scene.density[tuple(index.T)] > 1e-3))[:count]
    # The angle between the ray and the direction to the lamp is uniform, as it is for suns.
    towards = -offset[chosen] / np.linalg.norm(offset[chosen], axis=1, keepdims=True)
    across = np.cross(towards, unit_vectors(random, len(chosen)))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    gamma = random.uniform(0.0, np.pi, (len(chosen), 1))
    return positions[chosen], np.cos(gamma) * towards + np.sin(gamma) * across, lamp[chosen]


def _draw_lamps(random, density: np.ndarray) -> tuple[PointLight | SpotLight, ...]:
    """One of each of LAMPS."""
    cells, power = len(density), 4.0 * np.pi
    filled = (np.argwhere(density > random.choice([0.02, 0.3])) + 0.5) / cells - 0.5
    middle = filled.mean(axis=0)

    def radius(probability: float) -> float:
        return float(np.exp(random.uniform(np.log(0.004), np.log(0.15)))) if random.random() < probability else 0.0

    def place(where: str) -> np.ndarray:
        if where == "inside":
            return filled[random.integers(len(filled))] + random.uniform(-0.5, 0.5, 3) / cells
        way = unit_vectors(random, 1)[0]
        far = max(float(((filled - middle) @ way).max()), 0.1)
        away = np.exp(random.uniform(np.log(0.05), np.log(2.0))) if where == "outside" else random.uniform(-0.03, 0.03)
        return middle + (far + away) * way

    def point(where: str, probability: float) -> PointLight:
        return PointLight(place(where), power, radius(probability), soft_falloff=bool(random.random() < 0.6))

    where = str(random.choice(["outside", "edge", "inside"]))
    at = place(where)
    aim = filled[random.integers(len(filled))] - at if where != "inside" else random.normal(size=3)
    spot = SpotLight(
        at,
        aim if np.linalg.norm(aim) > 1e-6 else np.array([0.0, 0.0, 1.0]),
        power,
        float(np.radians(random.uniform(15.0, 150.0))),
        float(random.uniform(0.0, 1.0)),
        radius(0.5),
        soft_falloff=bool(random.random() < 0.6),
    )
    return point("outside", 0.3), point("edge", 0.4), point("inside", 0.6), point("inside", 1.0), spot


def _draw_environments(random) -> np.ndarray:
    """Float32 (ENVIRONMENTS, H, 2H), of values that half precision holds: even light first, then skies and lobes."""
    drawn = [random_environment(random) for _ in range(ENVIRONMENTS - 1)]
    return np.stack([np.ones_like(drawn[0]), *drawn]).astype(np.float16).astype(np.float32)


def _points(cells: int) -> np.ndarray:
    axis = ((np.arange(cells) + 0.5) / cells - 0.5).astype(np.float32)
    return np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)


def _noise(random, cells: int, octaves: int, frequencies=(1.0, 4.0)) -> np.ndarray:
    """Fractal noise (N, N, N) of mean 0 and standard deviation 1."""
    noise = Fractal(random, random.uniform(*frequencies), octaves, random.uniform(0.4, 0.6))
    return noise(_points(cells)).reshape((cells,) * 3)


def _smoothstep(x: np.ndarray) -> np.ndarray:
    t = np.clip(x, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _draw_albedo(random, density: np.ndarray, kind: str) -> AlbedoField:
    if kind == "uniform":
        albedos = draw_albedos(random, 1)[0]
        return AlbedoField(albedos, albedos)
    cells = len(density)
    if kind in ("soft", "sharp"):
        width = random.uniform(1.0, 3.0) if kind == "soft" else 0.05
        mask = _smoothstep(
            (_noise(random, cells, 2 if kind == "soft" else 3) - random.uniform(-0.7, 0.7)) / width + 0.5
        )
    elif kind == "slope":
        along = (_points(cells) @ unit_vectors(random, 1)[0]).reshape(density.shape)
        mask = _smoothstep(along / random.uniform(0.05, 0.8) + 0.5)
    else:
        mask = density ** random.uniform(0.3, 1.5)
    if random.random() < 0.5:
        mask = 1.0 - mask
    # One channel that is almost white, as in coloured smoke, and others down to any albedo.
    high = 1.0 - 10.0 ** random.uniform(-3.0, -0.5, ALBEDOS)
    low = high * (1.0 - random.uniform(0.0, 1.0, ALBEDOS) ** 2)
    low[0] = high[0] * random.uniform(0.8, 1.0)
    swap = random.random(ALBEDOS) < 0.5
    return AlbedoField(np.where(swap, high, low), np.where(swap, low, high), mask.astype(np.float32))


def _glowing_density(random, density: np.ndarray) -> np.ndarray:
    """Emission of the medium itself: of all of it, of patches, or of its dense cores."""
    field = density ** random.uniform(0.7, 3.0)
    if random.random() < 0.6:
        field = field * _smoothstep(_noise(random, len(density), 3) - random.uniform(-1.0, 1.0))
    return (field / max(float(field.max()), 1e-6)).astype(np.float32)


def _flame(random, density: np.ndarray) -> np.ndarray:
    """Emission apart from the density: a few lumps, in the medium, beside it and where there is none."""
    cells = len(density)
    points = _points(cells)
    filled = (np.argwhere(density > 0.02) + 0.5) / cells - 0.5
    field = np.zeros(len(points), np.float32)
    for _ in range(random.integers(1, 4)):
        centre = filled[random.integers(len(filled))] + random.normal(0.0, 0.05, 3)
        size = random.uniform(0.02, 0.2) * np.exp(random.uniform(-0.5, 0.5, 3))
        square = (((points - centre.astype(np.float32)) / size.astype(np.float32)) ** 2).sum(axis=1)
        field += float(random.uniform(0.2, 1.0)) * np.exp(-square)
    field = field.reshape(density.shape) * np.exp(random.uniform(0.0, 0.8) * _noise(random, cells, 4, (2.0, 6.0)))
    field = np.maximum(field / field.max() - 0.02, 0.0)
    return (field / field.max()).astype(np.float32)


def _block_means(field: np.ndarray) -> np.ndarray:
    for axis in range(3):
        parts = np.array_split(np.moveaxis(field, axis, 0), MARK)
        field = np.moveaxis(np.stack([part.mean(axis=0, dtype=np.float64) for part in parts]), 0, axis)
    return field.astype(np.float32)
