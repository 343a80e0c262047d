# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoke and fire: a plume, a camp fire, and an explosion as a sequence of files."""

from pathlib import Path

import numpy as np

from training.procedural.fluid import simulate_smoke
from training.procedural.noise import Fractal, Swirl, sample_grid
from training.procedural.shapes import ball_union

from . import stage
from .fields import ramp, sample

#: Frames of the explosion.
FRAMES = 24


def column(seed: int, cells: int, steps: int):
    """A simulated column of smoke as a field: 1 wide, from z = 0 to 2, its largest density 1."""
    density = simulate_smoke(np.random.default_rng(seed), cells=cells, steps=steps)
    density /= np.quantile(density[density > 0.01], 0.995)
    size, low = 2.0 / density.shape[2], np.array([-0.5, -0.5, 0.0], np.float32)
    curls = Swirl(np.random.default_rng(seed), 9.0, 3, 0.6, steps=3)

    def field(points):
        return np.minimum(sample_grid(curls(points, 0.008), density, low, np.float32(size)), 1.5)

    return field


def plume(folder: Path, detail: float):
    """Dark smoke of a chimney in a low sun."""
    scene = stage.new_scene()
    smoke = column(6, round(64 * detail), round(75 * detail))
    low, high, voxel = (-0.5, -0.5, 0.0), (0.5, 0.5, 2.0), 0.008 / detail
    path = folder / "plume.vdb"
    stage.write_grids(path, {"density": sample(smoke, low, high, voxel)}, low, voxel)
    stage.volume(path, Density=60.0, Color=(0.5, 0.46, 0.43), Anisotropy=0.4)
    stage.sun((1.0, 0.35, 0.35), 12.0, (1.0, 0.72, 0.45))
    stage.sky((0.0, (0.6, 0.4, 0.27)), (0.3, (0.2, 0.24, 0.32)), (1.0, (0.04, 0.08, 0.18)), strength=0.5)
    stage.camera((0.0, -3.6, 0.85), (-0.05, 0.0, 1.12), 46.0)
    return scene


def fire(folder: Path, detail: float):
    """Flames and their smoke, which the flames light."""
    scene = stage.new_scene()
    rising = column(6, round(64 * detail), round(80 * detail))
    rng = np.random.default_rng(9)
    lick, rags = Swirl(rng, 3.0, 3, 0.6, steps=5), Fractal(rng, 1.3, 5, 0.55)
    low, high, voxel = (-1.0, -0.8, 0.0), (1.0, 0.8, 2.2), 0.011 / detail
    stretch, size = np.array([1.0, 1.0, 0.5], np.float32), np.array([2.4, 2.4, 0.95], np.float32)

    def heat(points):
        z = points[:, 2]
        moved = lick(points * stretch, 0.05 * np.clip(2 * z, 0.1, 1)) / stretch
        hot = 1.5 - z + 0.25 * rags(moved * stretch * 1.2)
        return rising((moved / size).astype(np.float32)) * ramp(hot, 0.0, 1.1)

    def smoke(points):
        z = points[:, 2]
        return rising((points / (1.15 * size)).astype(np.float32)) * ramp(z, 0.6, 1.6) * ramp(2.15 - z, 0.0, 1.0)

    flames = np.sqrt(np.clip(sample(heat, low, high, voxel), 0, 1.2))
    density = np.maximum(sample(smoke, low, high, voxel), 0.04 * flames)
    path = folder / "fire.vdb"
    stage.write_grids(path, {"density": density, "temperature": flames, "flame": flames}, low, voxel)
    _, shader = stage.volume(
        path, Density=16.0, Color=(0.7, 0.66, 0.63), Anisotropy=0.3, Temperature_Attribute="temperature"
    )
    shader.inputs["Blackbody Intensity"].default_value = 10.0
    shader.inputs["Temperature"].default_value = 2500.0
    stage.even_world((0.012, 0.016, 0.028))
    stage.camera((0.0, -4.3, 0.8), (0.0, 0.0, 0.94), 42.0)
    return scene


def burst(t: float):
    """Density and temperature of an explosion at the time t from 0 to 1, as fields."""
    rng = np.random.default_rng(33)
    directions = rng.standard_normal((26, 3))
    directions[:, 2] = np.abs(directions[:, 2]) * 0.8 + 0.05
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    reach = rng.uniform(0.35, 1.0, 26)
    radius = 0.28 + 0.62 * t**0.45
    centres = (directions * reach[:, None] * radius * 0.75).astype(np.float32)
    centres[:, 2] += np.float32(0.12 + 0.55 * t)
    radii = (rng.uniform(0.45, 0.75, 26) * radius * 0.75).astype(np.float32)
    lumps, curls = Fractal(rng, 1.1, 5, 0.5, billow=True), Swirl(rng, 2.0, 3, 0.6, steps=4)

    def fields(points):
        # The noise grows with the ball.
        moved = curls(points / radius, 0.03 + 0.06 * t).astype(np.float32)
        distance = ball_union(moved * np.float32(radius), centres, radii, np.float32(0.05))
        crease = lumps(moved)
        depth = -(distance - 0.1 * radius * crease)
        ground = ramp(points[:, 2], 0.0, 0.05)
        return ramp(depth, 0.0, 0.08) * ground, ramp(depth, 0.0, 0.05) * ramp(0.9 - 1.5 * t - crease, 0.0, 1.6) * ground

    return fields


def explosion(folder: Path, detail: float):
    """A fireball that rises, cools and turns to smoke."""
    scene = stage.new_scene()
    low, high, voxel = (-1.4, -1.4, 0.0), (1.4, 1.4, 2.4), 0.019 / detail
    scene.frame_start, scene.frame_end = 1, FRAMES
    for frame in range(1, FRAMES + 1):
        fields = burst((frame - 1) / (FRAMES - 1))
        path = folder / "explosion" / f"explosion_{frame:04}.vdb"
        if not path.exists():
            density, heat = np.moveaxis(sample(lambda points: np.stack(fields(points), 1), low, high, voxel), 3, 0)
            stage.write_grids(path, {"density": density, "temperature": heat}, low, voxel)
    blast, shader = stage.volume(
        folder / "explosion" / "explosion_0001.vdb", Density=30.0, Color=(0.35, 0.32, 0.3), Anisotropy=0.2
    )
    blast.data.is_sequence, blast.data.frame_duration, blast.data.frame_start = True, FRAMES, 1
    shader.inputs["Temperature Attribute"].default_value = "temperature"
    shader.inputs["Blackbody Intensity"].default_value = 150.0
    shader.inputs["Temperature"].default_value = 1900.0
    stage.sun((-0.8, -0.35, 0.5), 4.0, (1.0, 0.8, 0.62))
    stage.sky((0.0, (0.2, 0.15, 0.13)), (0.3, (0.06, 0.08, 0.12)), (1.0, (0.02, 0.03, 0.06)))
    stage.camera((0.0, -3.9, 0.5), (0.0, 0.0, 0.78), 42.0)
    scene.frame_set(8)
    return scene
