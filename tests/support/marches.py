# SPDX-License-Identifier: GPL-3.0-or-later
"""Random scenes for camera rays: media bound to grids, lamps, and rays through them."""

from collections.abc import Sequence
from ctypes import c_int32
from dataclasses import dataclass, replace

import numpy as np

from inference import AreaLight, Medium, PointLight, SpotLight, Surface, Volume
from inference.grids.bound_medium import BoundMedium, scattering_channels
from inference.grids.grid import Grid
from inference.marching.lamp_in_media import place_lamp
from inference.marching.marcher import Marcher
from inference.marching.mean_lamp_depth import MeanLampDepth, mean_lamp_depth
from inference.marching.ray_march import LampMarch, MarchOptions, RaySegment
from inference.marching.ray_steps import RayBatch
from inference.occluders.shadow_map import ShadowMap
from inference.runtime.tasks import SERIAL
from inference.scene.lamps import Lamp
from inference.scene.optimizations import ALL
from inference.scene.sparse_grid import SparseGrid
from inference.transport.discrete_ordinates import CELLS
from inference.transport.scattered_fluence import ScatteredFluence


@dataclass(frozen=True)
class MarchScene:
    """Media, what is gathered of them, colour channels whose emission is, rays, and lamps or None."""

    media: list[BoundMedium]
    options: MarchOptions
    channels: list[int]
    rays: RayBatch
    lamps: LampMarch | None = None


@dataclass(frozen=True)
class Recipe:
    """What a random scene is made of.

    voxels: along each axis of a volume. thickness: optical, of a volume whose density is 1. shear: of the voxels.
    projection: of the rays. emission: power of the emission, 0 for none. lamps: kinds of LAMPS, "far" before
    those that are far away. albedo: channels of an albedo that varies, 0 for none. means: whether the optical depths of
    the parts of lamps are averaged at voxels.
    """

    volumes: int = 1
    suns: int = 1
    voxels: tuple[int, int, int] = (24, 20, 17)
    thickness: float = 5.0
    sparse: bool = False
    shear: float = 0.0
    shadows: bool = False
    groups: list[list[int]] | None = None
    features: bool = True
    emission: int = 0
    projection: str = "perspective"
    depth_samples: int = 4
    optimizations: frozenset[str] = ALL - {"faint_rays"}
    kind: str = "lumps"
    lamps: tuple[str, ...] = ()
    albedo: int = 0
    means: bool = False
    detail: int = 1


#: Kinds of lamps.
LAMPS = ("point", "sphere", "soft spot", "square", "disk")


def random_lamp(random: np.random.Generator, kind: str) -> Lamp:
    """A lamp around the origin, or near it."""
    position = random.normal(size=3) * random.choice([0.1, 0.6])
    if kind.startswith("far "):
        position, kind = position * 3.0 / np.linalg.norm(position), kind.removeprefix("far ")
    if kind == "point":
        return PointLight(position, 1.0)
    if kind == "sphere":
        return PointLight(position, 1.0, random.uniform(0.01, 0.4), soft_falloff=random.random() < 0.3)
    if kind == "soft spot":
        angle, blend, radius = random.uniform(0.2, 3.0), random.random(), random.uniform(0.01, 0.4)
        soft_falloff = random.random() < 0.5
        spot = SpotLight(position, random.normal(size=3), 1.0, angle, blend, radius, soft_falloff=soft_falloff)
        if blend < 0.4:
            # Round in a frame that stretches directions across its own.
            across = np.linalg.svd(spot.direction[None])[2][1:] * [[0.5], [1.6]]
            spot = replace(spot, frame=np.stack([*across, spot.direction]))
        return spot
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.linalg.qr(random.normal(size=(3, 3)))[0], position
    return AreaLight(matrix, kind, random.uniform(0.01, 0.5), 1.0, random.choice([np.pi, 1.0]))


def random_density(random: np.random.Generator, shape: tuple[int, int, int], kind: str) -> np.ndarray:
    """float32 of a shape: lumps with empty space around, a solid, single voxels, or noise of all magnitudes."""
    axes = [np.linspace(-1.0, 1.0, n) if n > 1 else np.zeros(1) for n in shape]
    r = np.sqrt(sum(axis**2 for axis in np.meshgrid(*axes, indexing="ij")))
    if kind == "solid":
        return np.ones(shape, np.float32)
    if kind == "voxels":
        density = (random.random(shape) > 0.98).astype(np.float32)
        density[tuple(n // 2 for n in shape)] = 1.0
        return density
    if kind == "magnitudes":
        return (10.0 ** random.uniform(-12.0, 0.0, shape) * (random.random(shape) > 0.5)).astype(np.float32) + 1e-20
    density = np.maximum(1.1 - r, 0.0) * random.random(shape) ** 2
    density[density < 0.1] = 0.0
    density[tuple(n // 2 for n in shape)] = 1.0
    return density.astype(np.float32)


def random_scene(seed: int, recipe: Recipe, rays: int = 64) -> MarchScene:
    """A scene that a seed and a recipe determine."""
    random = np.random.default_rng(seed)
    directions = random.normal(size=(recipe.suns, 3))
    # Also along an axis of the voxels.
    directions[0] = np.where(random.random() < 0.2, [0.0, 0.0, -1.0], directions[0])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    media = [_medium(random, recipe, directions, v) for v in range(recipe.volumes)]
    batch = _rays(random, recipe, media, rays)
    if recipe.detail > 1:
        batch = replace(batch, detail=random.integers(1, recipe.detail + 1, len(batch.near)))
    shadow_maps = None
    if recipe.shadows:
        corners = np.concatenate([medium.grid.corners() for medium in media])
        roof = corners.mean(axis=0) + random.normal(size=(3, 3, 3)) * 0.7
        shadow_maps = [ShadowMap([roof], direction, corners) for direction in directions]
    fluence = None
    if recipe.features:
        groups = recipe.groups or [[v] for v in range(recipe.volumes)]
        fluence = [_fluence(random, recipe.suns) for _ in groups]
        if len(groups) > 1:
            fluence[-1] = None
    channels = [0, 1, 2] if seed % 2 else [1]
    options = MarchOptions(
        recipe.depth_samples,
        fluence,
        shadow_maps,
        recipe.groups,
        recipe.optimizations,
        scattering=scattering_channels(media, channels),
        most_detail=recipe.detail,
        suns=directions,
    )
    lamps = _lamps(random, recipe, media) if recipe.lamps else None
    return MarchScene(media, options, channels, batch, lamps)


def _lamps(random: np.random.Generator, recipe: Recipe, media: list[BoundMedium]) -> LampMarch:
    surfaces = [Surface(random.normal(size=(2, 3, 3)) * 0.5)] if recipe.shadows else []
    grids = [medium.grid for medium in media]
    lamps = [place_lamp(random_lamp(random, kind), grids, surfaces) for kind in recipe.lamps]
    fluence = None
    if recipe.features:
        groups = recipe.groups or [[v] for v in range(recipe.volumes)]
        fluence = [_fluence(random, len(lamps)) for _ in groups]
        fluence[0].scales = random.uniform(0.1, 5.0, len(lamps)).tolist()
        if len(groups) > 1:
            fluence[-1] = None
    means: list[MeanLampDepth] = []
    if recipe.means:
        means = [mean_lamp_depth(lamp, media[0], SERIAL) for lamp in lamps]
    return LampMarch(lamps, fluence, random.uniform(0.0, 0.05), means)


def _medium(random: np.random.Generator, recipe: Recipe, directions: np.ndarray, v: int) -> BoundMedium:
    shape = recipe.voxels
    density = random_density(random, shape, recipe.kind)
    linear = np.diag(1.0 / np.array(shape)) + recipe.shear * random.normal(size=(3, 3)) / max(shape)
    matrix = np.eye(4)
    matrix[:3, :3] = linear
    matrix[:3, 3] = -linear @ (0.5 * np.array(shape) - 0.5) + 0.3 * v * random.normal(size=3)
    emission = None
    if recipe.emission:
        emission = random.random((*shape, 3)).astype(np.float32) * (density > 0.3)[..., None]
        if recipe.sparse:
            blocks = SparseGrid.of_dense(density + emission.max(axis=3))
            emission = tuple(_in_blocks(blocks, emission[..., c]) for c in range(3))
            density = _in_blocks(blocks, density)
    elif recipe.sparse:
        density = SparseGrid.of_dense(density)
    scattering = None
    # Of the first volume alone, so that others are beside it whose albedo does not vary.
    if recipe.albedo and not v:
        dense = density.dense() if recipe.sparse else density
        grids = [(dense * random.random(shape)).astype(np.float32) for _ in range(recipe.albedo)]
        scattering = tuple(_in_blocks(density, grid) if recipe.sparse else grid for grid in grids)
    grid = Grid(Volume(density, matrix, f"volume {v}", emission, recipe.emission or 1, scattering))
    medium = Medium(recipe.thickness, emission=2.0)
    return BoundMedium(grid, medium, recipe.thickness * (1.0 + v), grid.sun_depths(list(directions)))


def _in_blocks(blocks: SparseGrid, dense: np.ndarray) -> SparseGrid:
    """A dense array in the blocks of a grid, which hold all of it."""
    values = np.zeros_like(blocks.values)
    low = blocks.first
    padded = np.zeros(8 * np.array(blocks.table.shape), np.float32)
    padded[tuple(slice(a, a + n) for a, n in zip(low, dense.shape))] = dense
    for place in np.argwhere(blocks.table):
        values[blocks.table[tuple(place)]] = padded[tuple(slice(8 * a, 8 * a + 8) for a in place)]
    return blocks.with_values(values)


def _fluence(random: np.random.Generator, suns: int) -> ScatteredFluence:
    lights = []
    for _ in range(suns):
        light = random.random((CELLS, CELLS, CELLS, 4)) - [0.0, 0.5, 0.5, 0.5]
        lights.append((light * 10.0 ** random.uniform(-6.0, 2.0)).astype(np.float16))
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    return ScatteredFluence(turn * CELLS, np.full(3, 0.5 * CELLS), lights, random.uniform(-0.9, 0.9))


def _rays(random: np.random.Generator, recipe: Recipe, media: list[BoundMedium], count: int) -> RayBatch:
    """Rays that meet a medium, with intervals that contain all media."""
    targets = random.normal(size=(4 * count, 3)) * 0.3
    if recipe.projection == "orthographic":
        direction = random.normal(size=3)
        directions = np.tile(direction / np.linalg.norm(direction), (len(targets), 1))
        origins = targets - 3.0 * directions
    elif recipe.projection == "inside":
        origins = np.tile(random.normal(size=3) * 0.1, (len(targets), 1))
        directions = random.normal(size=targets.shape)
        directions[:3] = np.eye(3)
    else:
        eye = random.normal(size=3)
        origins = np.tile(3.0 * eye / np.linalg.norm(eye), (len(targets), 1))
        directions = targets - origins
    directions = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    intervals = [medium.grid.interval(origins, directions) for medium in media]
    near, far = np.full(len(origins), np.inf), np.full(len(origins), -np.inf)
    for enter, leave in intervals:
        enter = np.maximum(enter, 0.0)
        met = enter < leave
        near[met], far[met] = np.minimum(near[met], enter[met]), np.maximum(far[met], leave[met])
    hit = np.flatnonzero(near < far)[:count]
    return RayBatch(origins[hit], directions[hit], near[hit], far[hit])


def march(media: Sequence[BoundMedium], rays: RayBatch, options: MarchOptions) -> RaySegment:
    """What rays gather, without emission."""
    return Marcher(media, options, (), c_int32(0))(rays)
