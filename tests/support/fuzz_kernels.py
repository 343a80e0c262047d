# SPDX-License-Identifier: GPL-3.0-or-later
"""Run every kernel on volumes whose contents are broken in every way, for compilers' checks to watch.

python -m tests.support.fuzz_kernels LIBRARY SECONDS [SEED]
"""

import ctypes
import sys
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np

from inference import PointLight, Surface, Velocity
from inference.baking.kriging import krige
from inference.baking.light_ahead import light_ahead
from inference.environments.open_depths import OpenDepths
from inference.features.final_gather import FinalGather
from inference.features.mip_lattices import Between
from inference.grids import working_cube
from inference.grids.bound_medium import Flow, Movement
from inference.grids.dense_grid import DenseGrid
from inference.grids.halving import halve
from inference.grids.lamp_optical_depth import LampOpticalDepth
from inference.grids.occupancy import Occupancy
from inference.grids.optical_depth_sweep import sun_optical_depth
from inference.grids.resampling import Placement, resample
from inference.grids.sparse_columns import SparseColumns
from inference.grids.sun_optical_depth import SunOpticalDepth
from inference.grids.working_cube import Cube, mean_density
from inference.kernels import library
from inference.kernels.library import Kernels, call
from inference.marching.light_paths import PathTracer, ScatteringMedia
from inference.marching.marcher import Marcher
from inference.marching.ray_steps import RayBatch
from inference.network.lamp_nearby import (
    LampNearby,
    NearbyPoints,
    NearbyTransport,
    NearLamp,
    SoftStart,
)
from inference.occluders.lamp_shadow_map import LampShadowMap
from inference.occluders.rasterization import rasterize_nearest
from inference.onnx.products import Layer
from inference.scene.emitters import LampSource
from inference.scene.sparse_grid import SparseGrid
from inference.source_terms.cell_sources import SunBeam
from inference.source_terms.forward_peak import forward_peak
from inference.source_terms.lamp_beam import LampInCube
from inference.source_terms.peak_photons import LampInCells, peak_light
from inference.source_terms.wide_light import Lobe, wide_light
from inference.transport.diffusion import couple, solve
from inference.transport.discrete_ordinates import DiscreteOrdinates
from inference.transport.radiance_sweep import sweep_radiance
from inference.transport.scattered_fluence import FluenceLattice
from tests.support.marches import LAMPS, MarchScene, Recipe, random_lamp, random_scene

CELLS = 32
# Eyes of scenes that move.
EYES = 5
STRANGE = np.array([np.nan, np.inf, -np.inf, 1e38, -1e38, 1e-45, -0.0, 2.0**31, -(2.0**31), 2.0**63, 0.5])


def random_recipe(random: np.random.Generator) -> Recipe:
    """A scene of any kind."""
    volumes = int(random.integers(1, 4))
    return Recipe(
        volumes=volumes,
        suns=int(random.integers(1, 4)),
        voxels=tuple(random.integers(1, 24, 3).tolist()),
        thickness=float(10.0 ** random.uniform(-3.0, 8.0)),
        sparse=random.random() < 0.5,
        shear=float(random.choice([0.0, 0.5])),
        shadows=random.random() < 0.3,
        groups=[[0, 1], [2]] if volumes == 3 and random.random() < 0.5 else None,
        features=random.random() < 0.7,
        emission=int(random.choice([0, 1, 4])),
        projection=str(random.choice(["perspective", "orthographic", "inside"])),
        depth_samples=int(random.integers(1, 40)),
        optimizations=frozenset(random.choice(["faint_rays", "empty_space", "behind_opaque"], 2).tolist()),
        kind=str(random.choice(["lumps", "solid", "voxels", "magnitudes"])),
        lamps=tuple(random.choice(LAMPS, random.integers(0, 3)).tolist()),
        detail=int(random.choice([1, 5])),
    )


def spoil(random: np.random.Generator, values: np.ndarray) -> None:
    """Replace some of the values, in place."""
    flat = values.reshape(-1)
    if not flat.size:
        return
    places = random.integers(0, len(flat), max(len(flat) // 20, 1))
    if values.dtype.kind == "f":
        with np.errstate(over="ignore"):
            flat[places] = random.choice(STRANGE, len(places)).astype(values.dtype)
    else:
        flat[places] = random.integers(np.iinfo(values.dtype).min, np.iinfo(values.dtype).max, len(places))


def contents(scene: MarchScene) -> list[np.ndarray]:
    """Every array of a scene that a volume, a light or a surface fills."""
    found = []
    for medium in scene.media:
        grids = [medium.grid.density, *medium.grid.emission]
        found += [grid.values if isinstance(grid, SparseGrid) else grid.padded for grid in grids]
        found += [grid.table for grid in grids if isinstance(grid, SparseGrid)]
        for depth in medium.sun_depths:
            columns = depth.columns
            found.append(columns.offsets)
            found += [columns.tiles, columns.table] if isinstance(columns, SparseColumns) else [columns.depths]
    found += [shadow_map.heights for shadow_map in scene.options.shadow_maps or []]
    for fluence in scene.options.fluence or []:
        found += fluence.lights if fluence is not None else []
    if scene.lamps is not None:
        for lamp in scene.lamps.lamps:
            found += [pyramid.depths for each in lamp.depths for depth in each for pyramid in depth.pyramids]
            found += [shadow_map.distances for shadow_map in lamp.shadow_maps or []]
        for fluence in scene.lamps.fluence or []:
            found += fluence.lights if fluence is not None else []
    return found


def spoiled_rays(random: np.random.Generator, rays: RayBatch) -> RayBatch:
    """Rays from anywhere to anywhere."""
    arrays = [values.copy() for values in (rays.origins, rays.directions, rays.near, rays.far)]
    for values in arrays:
        if random.random() < 0.4:
            spoil(random, values)
    detail = rays.detail
    if detail is not None and random.random() < 0.4:
        detail = detail.copy()
        spoil(random, detail)
    return RayBatch(*arrays, detail, rays.eyes)


def movement(random: np.random.Generator) -> Movement | None:
    """How a volume moves in front of EYES, with velocities of any kind."""
    if random.random() < 0.2:
        return None
    frames = np.eye(4)[:3] + random.normal(0.0, 0.1, (EYES, 3, 4))
    shape = tuple(random.integers(1, 12, 3).tolist())
    parts = random.normal(0.0, 10.0 ** random.uniform(-3.0, 30.0), (3, *shape)).astype(np.float32)
    matrix = np.diag([*random.uniform(0.01, 1.0, 3), 1.0])
    velocity = Velocity(tuple(parts), matrix, random.normal(size=(3, 3)), (-0.5, 0.5))
    flow = Flow(velocity, Flow.grids_of(velocity), random.uniform(-1.0, 1.0, EYES))
    for grid in flow.grids:
        spoil(random, grid.padded)
    return Movement(frames, flow if random.random() < 0.8 else None)


def march(random: np.random.Generator) -> None:
    """Rays through a scene of any kind."""
    scene = random_scene(int(random.integers(1 << 32)), random_recipe(random), 8)
    eyes = None
    if random.random() < 0.4:
        scene = replace(scene, media=[replace(medium, motion=movement(random)) for medium in scene.media])
        eyes = random.integers(0, EYES, len(scene.rays.near))
    scene = replace(scene, rays=replace(scene.rays, eyes=eyes))
    options = replace(scene.options, at_start=random.random() < 0.3)
    march = Marcher(scene.media, options, scene.channels, ctypes.c_int32(0), scene.lamps)
    for array in contents(scene):
        if random.random() < 0.6:
            spoil(random, array)
    march(scene.rays)
    for medium in scene.media:
        if medium.flows and random.random() < 0.5:
            medium.motion.flow.velocities(spoiled(random, (11, 3), np.float64), random.integers(0, EYES, 11))
    rays = spoiled_rays(random, scene.rays)
    finite = np.flatnonzero(
        np.isfinite(rays.near)
        & np.isfinite(rays.far)
        & (np.abs(rays.far - rays.near) < 1e3)
        & (np.abs(rays.directions).max(axis=1) < 1e3)
    )
    march(rays.take(finite))
    march.march_steps(rays, np.full(len(rays.near), 64))


def spoiled(random: np.random.Generator, shape: tuple[int, ...], dtype: type = np.float32) -> np.ndarray:
    """Numbers of any kind."""
    values = (random.random(shape) * 10.0 ** random.uniform(-6.0, 6.0)).astype(dtype)
    if random.random() < 0.6:
        spoil(random, values)
    return values


def direction(random: np.random.Generator) -> np.ndarray:
    """Towards a sun, sometimes along an axis."""
    found = random.normal(size=3) * (random.random(3) < 0.8)
    return found / np.linalg.norm(found) if found.any() else np.array([0.0, -1.0, 0.0])


def random_grid(random: np.random.Generator) -> DenseGrid | SparseGrid:
    """A grid of any kind, with contents of any kind."""
    shape = tuple(random.integers(1, 40, 3).tolist())
    values = spoiled(random, shape)
    if random.random() < 0.5:
        return DenseGrid(values)
    return SparseGrid.of_dense(np.where(random.random(shape) < 0.02, values, 0.0).astype(np.float32))


def spoil_blocks(random: np.random.Generator, grid: DenseGrid | SparseGrid) -> None:
    """Let a sparse grid's table name blocks that there are not."""
    if isinstance(grid, SparseGrid) and random.random() < 0.5:
        spoil(random, grid.table)


def columns(random: np.random.Generator) -> None:
    """Columns along a sun's rays, and depths at cells."""
    grid, towards = random_grid(random), direction(random)
    spoil_blocks(random, grid)
    depth, points = SunOpticalDepth(grid, towards), spoiled(random, (3, int(random.integers(1, 60))))
    # Which decides how much is integrated.
    depth.peak = float(random.random())
    depth(points, float(10.0 ** random.uniform(-3.0, 5.0)), may_be_outside=random.random() < 0.5)
    if isinstance(grid, DenseGrid):
        sun_optical_depth(grid.padded, towards, 0.1)


def transport(random: np.random.Generator) -> None:
    """Light on coarse cells."""
    n = int(random.choice([4, 6, 8, 16]))
    triangles = random.normal(size=(3, 3, 3)) * 0.3 if random.random() < 0.5 else None
    density, sigma = spoiled(random, (n, n, n)), float(10.0 ** random.uniform(-3.0, 5.0))
    DiscreteOrdinates(density, sigma, float(random.uniform(-0.9, 0.9)), triangles).solve(SunBeam(direction(random)))
    shape = tuple(random.integers(1, 12, 3).tolist())
    extinction, emission = (spoiled(random, shape, np.float64) for _ in range(2))
    sweep_radiance(extinction, emission, 0.1, int(random.choice([2, 4, 6])))
    light_ahead(spoiled(random, shape), spoiled(random, (int(random.integers(1, 4)), *shape)), direction(random))
    known, asked = (random.integers(0, np.prod(shape), n) for n in (int(random.integers(0, 40)), 20))
    values = spoiled(random, (len(np.unique(known)), int(random.integers(1, 5))))
    krige(shape, np.unique(known), values, spoiled(random, values.shape[1:]), asked)
    equation = couple(spoiled(random, shape, np.float64), 0.1)
    solve(equation, spoiled(random, shape, np.float64))


def pyramid(random: np.random.Generator) -> None:
    """Means over cells, their levels, and lattices made of them."""
    grid, matrix = random_grid(random), np.diag([*random.uniform(0.5, 2.0, 3), 1.0])
    if random.random() < 0.3:
        matrix[:3, :3] += random.normal(size=(3, 3)) * 0.3
    else:
        spoil_blocks(random, grid)
    shape = np.array(grid.shape)
    density = grid if isinstance(grid, SparseGrid) else np.ascontiguousarray(grid.padded[1:-2, 1:-2, 1:-2])
    volume = SimpleNamespace(density=density, world_from_index=matrix)
    cube = Cube(np.eye(3), random.normal(size=3), float(random.uniform(0.1, 3.0) * shape.max()), 0 * shape, shape)
    level = mean_density(volume, cube)
    part = level[:14, :18, :10] if random.random() < 0.5 else spoiled(random, (14, 18, 10))
    halve(part, np.empty((7, 9, 5), np.float32))
    source, fine = tuple(random.integers(2, 9, 3).tolist()), tuple(random.integers(1, 20, 3).tolist())
    between = Between.of([random.uniform(-3.0, 12.0, n) for n in fine], source)
    names = [name for name in ("density", "depth", "visibility") if random.random() < 0.8]
    grids = {name: between.described(spoiled(random, source)) for name in names}
    scales = 10.0 ** random.uniform(-6.0, 6.0, 3)
    scratch = np.empty(2 * fine[2] + source[2], np.float32)
    packed = np.empty(fine, np.uint16)
    call(
        "fill_lattice",
        shape=np.array(fine),
        density_scale=scales[0],
        density_step=scales[1],
        depth_scale=scales[2],
        least_visible=0.1,
        packed=packed,
        scratch=scratch,
        **grids,
    )


def resampling(random: np.random.Generator) -> None:
    """Values of a grid at other voxels, anywhere."""
    grid = random_grid(random)
    filled, peaks = random.random(grid.cells().shape) < 0.7, grid.cell_peaks()
    spoil_blocks(random, grid)
    linear, offset, places = (
        spoiled(random, (3, 3), np.float64),
        spoiled(random, (3,), np.float64),
        random.normal(size=(8, 3)),
    )
    out = np.empty(random.integers(1, 12, 3), np.float32)
    placement = Placement(linear, offset, places)
    resample(
        grid,
        int(random.integers(1, 5)),
        Occupancy(filled, peaks, grid.cell, grid.cells_first),
        placement,
        out,
    )


def lamps(random: np.random.Generator) -> None:
    """Optical depths around a lamp, at points anywhere, and its light in coarse cells."""
    grid, linear = random_grid(random), np.diag(random.uniform(1.0, 40.0, 3))
    if random.random() < 0.3:
        linear += random.normal(size=(3, 3))
    # The density within spheres is read by numpy.
    radius = random.choice([0.0, random.uniform(0.0, 1.0)])
    if not radius:
        spoil_blocks(random, grid)
    source = LampSource(*random.normal(size=(2, 3)), radius, random.random() < 0.5)
    depth = LampOpticalDepth(grid, linear, random.normal(size=3), source)
    if radius:
        spoil_blocks(random, grid)
    for pyramid in depth.pyramids:
        if random.random() < 0.3:
            spoil(random, pyramid.depths)
    depth(spoiled(random, (3, int(random.integers(1, 200)))), float(10.0 ** random.uniform(-3.0, 5.0)))
    cube = Cube(np.linalg.qr(random.normal(size=(3, 3)))[0], random.normal(size=3), 1.5, np.zeros(3), np.ones(3))
    low, high = np.full(3, -0.5), np.full(3, 0.5)
    emitters = random_lamp(random, str(random.choice(LAMPS))).emitters(low, high, 4)
    shadow_maps = None
    if random.random() < 0.3:
        roof = [Surface(random.normal(size=(2, 3, 3)))]
        shadow_maps = [LampShadowMap(roof, emitter.position, 32) for emitter in emitters]
        spoil(random, shadow_maps[0].distances)
    n = int(random.choice([4, 8, 16]))
    solver = DiscreteOrdinates(spoiled(random, (n, n, n)), float(10.0 ** random.uniform(-3.0, 5.0)), 0.3, None)
    LampInCube(emitters, cube, shadow_maps, b"", random.normal(size=3))(solver)


def gathering(random: np.random.Generator) -> None:
    """Light gathered around camera rays, at points anywhere."""
    n, m, count = (int(random.integers(1, most)) for most in (24, 12, 40))
    density, depth = (spoiled(random, (n, n, n)) for _ in range(2))
    medium = float(10.0 ** random.uniform(-3.0, 8.0)), float(random.uniform(-0.99, 0.99))
    gather = FinalGather.of(density, depth, spoiled(random, (m, m, m, 4)), medium)
    gather(spoiled(random, (count, 3)), spoiled(random, (count, 3, 3)))


def opened(random: np.random.Generator) -> None:
    """Depths out of the cube from points anywhere."""
    n, m, count = int(random.integers(1, 24)), int(random.integers(3, 12)), int(random.integers(1, 100))
    levels = [spoiled(random, (size, size, size)) for size in (2 * n, n)]
    OpenDepths(levels, spoiled(random, (50, m, m, m)))(spoiled(random, (count, 3)) - np.float32(0.5))


def nearby(random: np.random.Generator) -> None:
    """Light of lamps nearby at points anywhere."""
    n, count = int(random.integers(3, 12)), int(random.integers(1, 40))
    anisotropy = float(random.choice([-1.0, 1.0]) * random.uniform(0.05, 0.99))
    lamps, cells = [], []
    for _ in range(int(random.integers(1, 4))):
        place = random.normal(size=3)
        emitters = PointLight(tuple(place), 1.0, 0.1).emitters(np.full(3, -0.5), np.full(3, 0.5))
        start = SoftStart(0.1, float(random.random()), spoiled(random, (64,))) if random.random() < 0.5 else None
        lamps.append(NearLamp(emitters, float(random.random()), place, start))
        cells.append((spoiled(random, (n, n, n, 20)), 2.0))
    transport = NearbyTransport(cells, spoiled(random, (n, n, n, 4)) if len(lamps) > 1 else None)
    density, box = FluenceLattice(spoiled(random, (n, n, n, 1))), (np.full(3, -0.5), np.full(3, 0.5))
    points = NearbyPoints(*(spoiled(random, (count, 3)) for _ in range(3)), spoiled(random, (len(lamps), count)))
    LampNearby(1.0, {0.9: transport}, lamps, anisotropy, density, box, 0.01).radiance(0.9, points)


def scattering(random: np.random.Generator) -> None:
    """Light that scatters in cells around a lamp."""
    shape = tuple(random.integers(1, 12, 3).tolist())
    peak = forward_peak(float(random.uniform(-0.99, 0.99)))
    closed = (random.random((3, *shape)) < 0.2).astype(np.uint8) if random.random() < 0.5 else None
    lamp = LampInCells(spoiled(random, shape), spoiled(random, shape), random.normal(size=3) * 10.0, closed, 0.9)
    peak_light(lamp, peak, photons=300)
    lobes = [Lobe(spoiled(random, shape), spoiled(random, (3, *shape)), float(random.random())) for _ in range(2)]
    wide_light(spoiled(random, shape), 0.9, lobes, peak)


def paths(random: np.random.Generator) -> None:
    """Light paths through a scene of any kind, from anywhere."""
    recipe = replace(random_recipe(random), lamps=(), suns=1, features=False, shadows=False)
    scene = random_scene(int(random.integers(1 << 32)), recipe, 4)
    for medium in scene.media:
        medium.medium.anisotropy = float(random.uniform(-0.999, 0.999))
    tracer = PathTracer(ScatteringMedia(scene.media, scene.channels))
    for array in [*contents(scene), *(majorants.peaks for majorants in tracer.majorants)]:
        if random.random() < 0.6:
            spoil(random, array)
    rays = spoiled_rays(random, scene.rays)
    numbers = random.integers(-(1 << 62), 1 << 62, len(rays.near))
    tracer.trace(rays, numbers, 3)


def products(random: np.random.Generator) -> None:
    """Matrices of any size and contents."""
    rows, inner, columns = random.integers(0, 60, 3).tolist()
    layer = Layer(spoiled(random, (inner, columns)), spoiled(random, (columns,)), bool(random.integers(2)))
    layer(spoiled(random, (rows, inner)), spoiled(random, (rows, columns)) if random.integers(2) else None)


def rasters(random: np.random.Generator) -> None:
    """Triangles of any contents on rasters of any size."""
    size, count = random.integers(1, 80, 2), int(random.integers(1, 50))
    corners = spoiled(random, (count, 3, 2), np.float64) * random.choice([1.0, 50.0])
    rasterize_nearest(corners, spoiled(random, (count, 3), np.float64), size)


KINDS = (
    march,
    lamps,
    columns,
    transport,
    pyramid,
    resampling,
    gathering,
    opened,
    nearby,
    scattering,
    paths,
    products,
    rasters,
)


def fuzz(path: str, seconds: float, seed: int) -> int:
    """Run as many cases as fit in the time, of each kind in turn; returns how many."""
    # Cells of the working cube: few, so that many cases fit.
    working_cube.LEVEL0_CELLS = CELLS
    kernels, end, count = Kernels(path), time.monotonic() + seconds, 0
    library.load_kernels = lambda: kernels
    with np.errstate(all="ignore"):
        while time.monotonic() < end:
            KINDS[count % len(KINDS)](np.random.default_rng(seed + count))
            count += 1
    return count


if __name__ == "__main__":
    print(fuzz(sys.argv[1], float(sys.argv[2]), int(sys.argv[3]) if len(sys.argv) > 3 else 0), "cases")
