# SPDX-License-Identifier: GPL-3.0-or-later
"""Clouds: at noon, at dusk over water, from inside, and a thunderstorm."""

from pathlib import Path

import numpy as np

from training.procedural.noise import Fractal, Swirl

from . import stage
from .fields import cumulus, heap, ramp, sample


def fair_weather(folder: Path, voxel: float) -> Path:
    """A cumulus, 3.4 units wide."""
    rng = np.random.default_rng(12)
    towers = [(-0.75, 0.0, 0.75, 0.42), (-0.2, 0.15, 1.25, 0.5), (0.35, -0.1, 0.95, 0.45), (0.9, 0.1, 0.5, 0.34)]
    towers += [(-1.2, -0.1, 0.35, 0.26), (0.1, -0.45, 0.45, 0.3)]
    low, high = (-1.8, -1.2, -0.15), (1.8, 1.2, 2.05)
    density = sample(cumulus(rng, heap(rng, towers), 1.0), low, high, voxel)
    path = folder / "cumulus.vdb"
    stage.write_grids(path, {"density": density}, low, voxel)
    return path


def noon(folder: Path, detail: float):
    """A cumulus in the sun."""
    scene = stage.new_scene()
    stage.volume(fair_weather(folder, 0.015 / detail), Density=90.0, Color=(1.0, 1.0, 1.0), Anisotropy=0.8)
    stage.sun((-1.0, -0.12, 0.62), 9.5, (1.0, 0.94, 0.86))
    stage.sky(
        (0.0, (0.55, 0.68, 0.82)),
        (0.1, (0.28, 0.45, 0.75)),
        (0.4, (0.07, 0.19, 0.52)),
        (1.0, (0.03, 0.09, 0.35)),
        strength=0.75,
    )
    stage.camera((0.3, -5.0, -0.5), (0.0, 0.0, 0.88), 43.0)
    return scene


def dusk(folder: Path, detail: float):
    """The cumulus over a calm sea, lit from low at the side."""
    scene = stage.new_scene("CYCLES")
    cloud, _ = stage.volume(fair_weather(folder, 0.015 / detail), Density=90.0, Color=(1.0, 1.0, 1.0), Anisotropy=0.8)
    cloud.location, cloud.rotation_euler.z = (0.3, 4.0, 0.2), 0.5
    stage.sun((0.95, 0.4, 0.14), 12.0, (1.0, 0.42, 0.15))
    stage.sky(
        (0.0, (0.85, 0.36, 0.16)),
        (0.06, (0.6, 0.3, 0.26)),
        (0.2, (0.2, 0.2, 0.36)),
        (0.5, (0.05, 0.09, 0.25)),
        (1.0, (0.02, 0.04, 0.14)),
        strength=0.8,
    )
    water = stage.plane("Sea", 60.0)
    shader = stage.material(water.data, "BsdfPrincipled", Base_Color=(0.005, 0.015, 0.025), Roughness=0.02, IOR=1.33)
    stage.ripples(shader, scale=1.6, height=0.03)
    stage.camera((-0.2, -5.0, 0.5), (0.0, 4.0, 0.72), 34.0)
    return scene


def inside(folder: Path, detail: float):
    """From a gap in a sea of clouds towards the low sun."""
    scene = stage.new_scene()
    rng = np.random.default_rng(5)
    towers = [
        (rng.uniform(0.75, 2.2) * side, y, rng.uniform(0.3, 1.0), rng.uniform(0.35, 0.6))
        for y in np.arange(-1.0, 4.2, 0.62)
        for side in (-1, 1)
    ]
    towers += [(x, 4.0, 0.5, 0.5) for x in (-0.6, 0.3)]
    low, high, voxel = (-2.4, -1.6, -0.9), (2.4, 4.4, 1.7), 0.026 / detail
    walls = cumulus(rng, heap(rng, towers, 5), 1.0, base=-2.0)
    floor, haze = Fractal(rng, 0.7, 5, 0.5, billow=True), Fractal(rng, 0.6, 4)

    def density(points):
        ground = ramp(-0.45 + 0.16 * floor(points) - points[:, 2], 0.0, 0.12)
        fade = ramp(points[:, 2], -0.9, -0.7)
        mist = 0.006 * np.clip(haze(points), 0, 1) * ramp(0.9 - points[:, 2], 0, 0.8)
        return np.maximum(walls(points), ground * fade) + mist.astype(np.float32)

    path = folder / "inside.vdb"
    stage.write_grids(path, {"density": sample(density, low, high, voxel)}, low, voxel)
    stage.volume(path, Density=45.0, Color=(1.0, 1.0, 1.0), Anisotropy=0.8)
    stage.sun((0.3, 1.0, 0.22), 4.0, (1.0, 0.6, 0.32))
    stage.sky(
        (0.0, (0.8, 0.42, 0.24)),
        (0.15, (0.36, 0.3, 0.4)),
        (0.5, (0.07, 0.13, 0.32)),
        (1.0, (0.03, 0.07, 0.22)),
        strength=0.5,
    )
    stage.camera((0.0, -1.4, 0.25), (0.1, 3.0, 0.35), 62.0)
    return scene


def storm(folder: Path, detail: float):
    """A thunderstorm with an anvil at nightfall, lit from within by a flash."""
    scene = stage.new_scene()
    rng = np.random.default_rng(21)
    towers = [(0.0, 0.0, 1.9, 0.55), (-0.55, 0.1, 1.2, 0.45), (0.5, -0.1, 1.45, 0.45), (0.95, 0.1, 0.7, 0.35)]
    towers += [(-1.0, -0.1, 0.6, 0.34), (0.2, -0.4, 0.8, 0.4)]
    low, high, voxel = (-2.5, -1.5, -0.3), (2.5, 1.5, 2.6), 0.021 / detail
    body = cumulus(rng, heap(rng, towers, 7), 1.0)
    shape, swirl = Fractal(rng, 0.7, 5, 0.55), Swirl(rng, 0.8, 3, 0.6)
    stretch = np.array([0.5, 0.8, 2.0], np.float32)

    def density(points):
        moved = swirl(points, 0.1)
        across = np.hypot((moved[:, 0] - 0.35) / 2.0, moved[:, 1] / 1.2)
        thick = 0.26 * np.sqrt(np.clip(1 - across, 0, None)) + 0.04
        sheet = ramp(1 - np.abs(moved[:, 2] - 2.1 - 0.12 * across) / thick + 0.35 * shape(moved * stretch), 0.0, 0.9)
        anvil = 0.45 * sheet * ramp(1 - across, 0.0, 0.5)
        return np.maximum(body(points), anvil.astype(np.float32))

    path = folder / "storm.vdb"
    stage.write_grids(path, {"density": sample(density, low, high, voxel)}, low, voxel)
    stage.volume(path, Density=70.0, Color=(1.0, 1.0, 1.0), Anisotropy=0.8)
    stage.sun((-0.9, 0.35, 0.12), 1.6, (1.0, 0.45, 0.25))
    stage.lamp("POINT", (0.22, -0.52, 0.8), 55.0, (0.55, 0.68, 1.0), shadow_soft_size=0.05)
    stage.lamp("POINT", (-0.72, -0.28, 0.48), 22.0, (0.65, 0.7, 1.0), shadow_soft_size=0.05)
    stage.sky(
        (0.0, (0.32, 0.16, 0.13)),
        (0.08, (0.14, 0.11, 0.16)),
        (0.4, (0.025, 0.04, 0.1)),
        (1.0, (0.01, 0.015, 0.05)),
        strength=0.5,
    )
    stage.camera((0.0, -6.6, -0.1), (0.1, 0.0, 1.22), 48.0)
    return scene
