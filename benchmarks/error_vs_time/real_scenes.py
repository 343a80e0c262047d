# SPDX-License-Identifier: GPL-3.0-or-later
"""The scenes of `benchmarks.error_vs_time.real_sizes`, chosen before anything was measured, and their references.

References are the project's own path tracer's, in two independent halves, kept on disk and continued where they were
stopped.
"""

import functools
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from inference import Medium
from training.tracer.density_grid import prepare
from training.tracer.exits import decode_directions, trace_camera_exits
from training.tracer.path_tracer import PinholeCamera, Sampling, Scene, trace_pixels

from ..fidelity.views import (
    GREY,
    POSITION,
    SIGMA_HAT,
    VOLUMES,
    View,
    ViewSpec,
    held_back_density,
    independent_density,
    sun_direction,
)
from ..support.extension import ROOT

FOLDER = ROOT / "data" / "real_sizes"
CELLS = 192
FOV = 40.0
#: Paths per pixel and half that are traced before they are stored.
BATCH = 4
#: Radiance of the sky from where the vertical component of a direction is the first value to where it is the second.
SKY_HEIGHTS, SKY_RADIANCE, SKY_COLOUR = (-0.2, 1.0), (0.02, 0.1), (0.45, 0.65, 1.0)


@dataclass(frozen=True)
class RealScene:
    """A volume in the sun, of irradiance 1, and under a sky or none.

    spec: what is seen; its size is the width in pixels, its samples the paths per pixel in each half.
    rows: pixels down. fov: degrees across. folder: where references and images are kept.
    """

    name: str
    spec: ViewSpec
    rows: int
    fov: float = FOV
    sky: bool = False
    folder: Path = FOLDER

    def view(self) -> View:
        """The scene as `benchmarks.cycles` and `benchmarks.fidelity` take it."""
        if self.spec.volume in VOLUMES:
            density = functools.partial(held_back_density, VOLUMES[self.spec.volume], CELLS)
            up, position = (0.0, 0.0, 1.0), np.array(POSITION)
        else:  # its second axis is up
            density = functools.partial(independent_density, self.spec.volume)
            up, position = (0.0, 1.0, 0.0), np.array([POSITION[0], POSITION[2], -POSITION[1]])
        sun = sun_direction(self.spec.light, position, up)
        return View(self.name, self.spec, density, sun, position, up, self.fov, lambda view: halves(self))


def _spec(volume: str, light: str, anisotropy: float, samples: int, size: int = 512) -> ViewSpec:
    return ViewSpec(volume, light, SIGMA_HAT, GREY, anisotropy, size, samples)


SCENES = (
    RealScene("cloud, side, G 0.857", _spec("cloud1", "side", 0.857, 512), 512),
    RealScene("cloud, front, G 0.5", _spec("cloud2", "front", 0.5, 128), 512),
    RealScene("smoke, back, G 0.857", _spec("smoke", "back", 0.857, 512), 512),
    RealScene("smoke, side, G 0", _spec("smoke", "side", 0.0, 512), 512),
    RealScene("cloud and sky, side, G 0.857", _spec("cloud3", "side", 0.857, 256), 512, sky=True),
    RealScene("cloud, back, G 0.857, 1080 rows", _spec("cloud4", "back", 0.857, 64, 1920), 1080, fov=60.0),
)


def sky(directions: np.ndarray) -> np.ndarray:
    """Radiance (..., 3) of the sky in unit directions (..., 3)."""
    (low, high), (least, most) = SKY_HEIGHTS, SKY_RADIANCE
    share = np.clip((directions[..., 2] - low) / (high - low), 0.0, 1.0)
    return (least + (most - least) * share)[..., None] * np.array(SKY_COLOUR)


def _file(scene: RealScene) -> Path:
    return scene.folder / f"{scene.name.replace(', ', '-').replace(' ', '_')}.npz"


def halves(scene: RealScene) -> np.ndarray:
    """float64 (2, H, W, 4): radiance and alpha of two independent halves, of what is traced so far."""
    with np.load(_file(scene)) as data:
        return data["sums"].astype(np.float64) / int(data["paths"])


def traced(scene: RealScene) -> int:
    """Paths per pixel in each half that are on disk."""
    if not _file(scene).exists():
        return 0
    with np.load(_file(scene)) as data:
        return int(data["paths"])


def trace(scene: RealScene, paths: int, told: Callable[[str], None] = print) -> None:
    """Trace until each half has so many paths per pixel."""
    done, view = traced(scene), scene.view()
    if done >= paths:
        return
    grid = prepare(view.density())
    shape = (2, scene.rows, scene.spec.size, 4)
    sums = halves(scene) * done if done else np.zeros(shape)
    scene.folder.mkdir(parents=True, exist_ok=True)
    while done < paths:
        for half in (0, 1):
            sums[half] += BATCH * _batch(scene, view, grid, 1 + 2 * (done // BATCH) + half)
        done += BATCH
        partial = _file(scene).with_suffix(".partial")
        with open(partial, "wb") as file:
            np.savez(file, sums=sums.astype(np.float32), paths=done)
        os.replace(partial, _file(scene))
        told(f"{scene.name}: {done} of {paths} paths")


def _batch(scene: RealScene, view: View, grid, seed: int) -> np.ndarray:
    """One image (H, W, 4) of BATCH paths a pixel."""
    spec = scene.spec
    camera = PinholeCamera(tuple(view.position), (0.0, 0.0, 0.0), view.up, view.fov, spec.size, scene.rows)
    medium = Medium(spec.sigma_hat, spec.albedo, spec.anisotropy)
    image = trace_pixels(Scene(grid, view.sun), camera, medium, Sampling(BATCH, seed)).astype(np.float64)
    if scene.sky:
        # Albedo 1: what a path finds where it leaves is what the pixel receives.
        exits, _, hit = trace_camera_exits(grid, camera, spec.sigma_hat, spec.anisotropy, Sampling(BATCH, seed))
        found = hit[..., None] * sky(decode_directions(exits.directions))
        image[..., :3] += found.mean(axis=1).reshape(*image.shape[:2], 3)
    return image
