# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes with all that the network for every light is trained on but the traced light, and today's predictions."""

from dataclasses import dataclass

import numpy as np

from inference import Medium, SpotLight, Sun, predict_multiple
from inference.grids.grid import Grid
from inference.plan.precision import in_range
from inference.scene.description import Volume
from inference.scene.environment import Environment
from inference.scene.spot_cone import SpotCone
from inference.transport.scattered_emission import ScatteredEmission
from training.data.light_fields import Cells, Transport
from training.data.light_scene import LAMPS, LightScene, draw_light_points, light_scene
from training.tracer.density_grid import prepare
from training.tracer.light_paths import LitMedium, Paths, PathScene

#: Kinds of light that are compared.
KINDS = ("sun", *(f"lamp {name}" for name in LAMPS), "environment", "emission")
#: Largest value of the transport's fields in half precision.
HALF_RANGE = 3e4


@dataclass(frozen=True)
class LightTable:
    """Of K lights, in the order of `Lights`. number: int (K,), of the environment or the emission, else 0.

    family: int (K,), 0 of suns, 1 of lamps, 2 of environments, 3 of emission. kind: int (K,), of KINDS. towards:
    float32 (K, 3), of suns. lamp: float32 (K, 11), centre, intensity, radius, whether its falloff is soft, axis of its
    cone, cosine at which that begins and the difference over which it grows to 1.
    """

    family: np.ndarray
    kind: np.ndarray
    number: np.ndarray
    towards: np.ndarray
    lamp: np.ndarray

    @classmethod
    def of(cls, scene: LightScene) -> "LightTable":
        """Of the lights of a scene."""
        lights = scene.lights
        counts = len(lights.suns), len(lights.lamps), len(lights.environments), lights.emission.shape[3]
        family = np.repeat(np.arange(4), counts)
        number = np.concatenate([np.zeros(counts[0] + counts[1], int), np.arange(counts[2]), np.arange(counts[3])])
        kind = np.select([family == 0, family == 2, family == 3], [0, len(KINDS) - 2, len(KINDS) - 1])
        towards, lamp = np.tile(np.float32([0.0, 0.0, 1.0]), (len(family), 1)), np.zeros((len(family), 11), np.float32)
        lamp[:, 9:] = -2.0, 1.0
        towards[: counts[0]] = lights.suns
        for k, one in enumerate(lights.lamps, counts[0]):
            kind[k] = 1 + k - counts[0]
            soft = float(one.soft_falloff and one.radius > 0.0)
            lamp[k, :6] = *one.position, one.power[0] / (4.0 * np.pi), one.radius, soft
            if isinstance(one, SpotLight):
                cone = SpotCone(one.direction, float(np.cos(0.5 * one.angle)), one.blend)
                lamp[k, 6:] = *cone.axis, cone.cosine, cone.width
        return cls(family, kind, number, towards, lamp)


@dataclass(frozen=True)
class MediumRows:
    """One medium of a volume, P points and J pairs of a light and a channel of albedo.

    positions, omega: float32 (P, 3). jobs: int (J, 2). fields: float16 (J, 8, 64, 64, 64) of `Transport.solve`, over
    scales, float32 (J,). mask: of `Cells`. paths: from the points.
    """

    medium: LitMedium
    positions: np.ndarray
    omega: np.ndarray
    jobs: np.ndarray
    fields: np.ndarray
    scales: np.ndarray
    mask: np.ndarray | None
    paths: Paths


@dataclass(frozen=True)
class VolumeRows:
    """A volume: cells and lights of its scene, environments (W, H, 2H), and its media."""

    seed: int
    density: np.ndarray
    emission: np.ndarray
    environments: np.ndarray
    lights: LightTable
    media: list[MediumRows]


def choose_jobs(random: np.random.Generator, table: LightTable, channels: int) -> np.ndarray:
    """Lights and channels int (J, 2) for one medium: two channels each of a sun, three lamps, a sky and an emission."""
    chosen = [
        light
        for family, count in enumerate((1, 3, 1, 1))
        for light in random.choice(np.flatnonzero(table.family == family), count, replace=False)
    ]
    return np.array([(light, c) for light in chosen for c in random.choice(channels, 2, replace=False)])


def make_volume(seed: int, points: int, jobs=None) -> VolumeRows:
    """Everything but the traced light. jobs: (J, 2) of every medium, or None for some at random."""
    scene, random = light_scene(seed)
    grid = prepare(scene.density)
    at, table, cells = draw_light_points(scene, grid, random, points), LightTable.of(scene), Cells.of(scene)
    traced, transport, media = PathScene.of(grid, scene.lights), Transport(scene, cells), []
    for m, (medium, mask) in enumerate(zip(scene.media, cells.masks)):
        own = np.flatnonzero(at.medium == m)
        asked = choose_jobs(random, table, len(medium.albedo.low)) if jobs is None else np.asarray(jobs)
        fields, scales = np.empty((len(asked), 8, *cells.coarse.shape), np.float16), np.empty(len(asked), np.float32)
        for j, (light, channel) in enumerate(asked):
            solved = transport.solve(medium, mask, int(light), int(channel))
            # Near lamps light is far brighter than elsewhere.
            scales[j] = max(float(np.abs(solved).max()) / HALF_RANGE, 1e-30)
            fields[j] = solved / scales[j]
        vertices = at.positions[own], at.omega[own]
        media.append(MediumRows(medium, *vertices, asked, fields, scales, mask, traced.paths(medium, vertices)))
    return VolumeRows(seed, cells.density, cells.emission, scene.lights.environments, table, media)


class Today:
    """Predicts the light of one scene in one medium by what the renderer uses, for three channels of albedo."""

    def __init__(self, scene: LightScene, medium: LitMedium, channels) -> None:
        self.scene, self.channels = scene, list(channels)
        low, high, mask = (
            *(np.float32(v)[self.channels] for v in (medium.albedo.low, medium.albedo.high)),
            medium.albedo.mask,
        )
        albedo = low if mask is None else low + mask[..., None] * (high - low)
        cells = len(scene.density)
        world = np.diag([1.0 / cells] * 3 + [1.0])
        world[:3, 3] = 0.5 / cells - 0.5
        self.volume = Volume(scene.density, world)
        self.medium = Medium(medium.sigma, np.clip(albedo, 0.0, 1.0), medium.anisotropy)

    def __call__(self, light: int, positions: np.ndarray, omega: np.ndarray) -> np.ndarray:
        """Of a light by its number, at points: float32 (P, 3), scattered at least twice, of emission at least once."""
        lights = self.scene.lights
        skies = [Environment(image[..., None].repeat(3, axis=2)) for image in lights.environments]
        known = [*(Sun(sun, np.ones(3)) for sun in lights.suns), *lights.lamps, *skies]
        if light < len(known):
            return predict_multiple(self.volume, self.medium, known[light], positions, omega)
        emission = lights.emission[..., light - len(known), None].repeat(3, axis=3)
        glowing, medium = in_range(
            Volume(self.volume.density, self.volume.world_from_index, emission=emission), self.medium
        )
        scattered = ScatteredEmission([Grid(glowing)], [medium])
        return scattered.scattered(range(3), positions, omega, medium.anisotropy).T


def predict_today(seed: int, points: int, jobs) -> list[np.ndarray]:
    """Today's predictions float32 (J, P) at the points of `make_volume`, of each medium; jobs: of up to 3 channels."""
    scene, random = light_scene(seed)
    at = draw_light_points(scene, prepare(scene.density), random, points)
    jobs, found = np.asarray(jobs), []
    known = np.unique(jobs[:, 1])
    channels = np.resize(known, 3)
    for m, medium in enumerate(scene.media):
        own = np.flatnonzero(at.medium == m)
        today, values = Today(scene, medium, channels), np.zeros((len(jobs), len(own)), np.float32)
        for light in np.unique(jobs[:, 0]) if len(own) else ():
            predicted = today(int(light), at.positions[own], at.omega[own])
            for j in np.flatnonzero(jobs[:, 0] == light):
                values[j] = predicted[:, np.searchsorted(known, jobs[j, 1])]
        found.append(values)
    return found
