# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of bakes: two clouds of about 363 000 voxels, and smoke as Blender imports it.

    python -m benchmarks.cost.bakes [--rounds 2]

The clouds are procedural ones that no training has seen, in one sun. A row has the seconds of a bake with other
directions, without them, and without a camera, for the mean over directions: each the least of so many rounds. The
smoke is that of `benchmarks.cost.imported_smoke` with a density of 3, in a sun and the grey World of a new file; its
seconds include the file that is written. Needs bpy.
"""

import argparse
import functools
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from inference import Settings, Sun, bake

from ..fidelity.views import View, ViewSpec, held_back_density, traced_view
from ..support.extension import extension
from ..support.provenance import made_by

PROGRAM = "benchmarks.cost.bakes"
# Seed, voxels along an edge, where the sun is, and anisotropy.
CLOUDS = {"cloud": (1_000_014, 110, "side", 0.857), "ragged cloud": (1_000_023, 114, "back", 0.5)}
# Optical density of the clouds, and pixels along an edge of their picture.
DENSITY, SIZE = 100.0, 512
SMOKE_DENSITY = 3.0


def cloud(name: str) -> View:
    """One of CLOUDS, seen by a camera."""
    seed, cells, light, anisotropy = CLOUDS[name]
    spec = ViewSpec(name, light, DENSITY, (1.0, 1.0, 1.0), anisotropy, SIZE, 0)
    return traced_view(name, spec, functools.partial(held_back_density, seed, cells), Path())


def bake_cloud(view: View, camera: bool, directional: bool) -> None:
    """Bake a cloud's light, without anything that earlier bakes computed."""
    shown = view.camera(SIZE) if camera else None
    bake(view.volumes(), [Sun(view.sun, 1.0)], shown, Settings(directional=directional))


def smoke_scene() -> Any:
    """The smoke in a sun and the World of a new file."""
    import bpy

    from . import imported_smoke
    from .forecast import grey

    scene = imported_smoke.make_scene(100)
    grey(scene)
    shader = bpy.data.materials["Smoke"].node_tree.nodes["Principled Volume"]
    shader.inputs["Density"].default_value = SMOKE_DENSITY
    return scene


def bake_smoke(scene: Any, directional: bool) -> None:
    """Read a scene, bake it and write the file."""
    from tests.support import blender_scenes as scenes

    addon = extension().mrpnn_addon
    described = addon.scene.reader.read_frame(scenes.depsgraph())
    settings = replace(scene.mrpnn.settings(), directional=directional)
    with tempfile.TemporaryDirectory() as folder:
        addon.baking.bake_job.bake_scene(described, settings, addon.baking.bake_job.BakeTarget(folder))


def least(work: Callable[[], None], rounds: int) -> float:
    """The least processor seconds of some work."""
    found = []
    for _ in range(rounds):
        start = time.process_time()
        work()
        found.append(time.process_time() - start)
    return min(found)


def main() -> None:
    """The command of the docstring."""
    parser = argparse.ArgumentParser(prog=PROGRAM, description=__doc__.split("\n")[0])
    parser.add_argument("--rounds", type=int, default=2)
    options = parser.parse_args()
    extension()
    print("| scene | voxels | bake, processor seconds | without other directions | ratio | without a camera |")
    print("|---|---|---|---|---|---|")
    for name in CLOUDS:
        view = cloud(name)
        ways = ((True, True), (True, False), (False, False))
        full, near, mean = (least(functools.partial(bake_cloud, view, *way), options.rounds) for way in ways)
        voxels = np.count_nonzero(view.density())
        print(f"| {name} | {voxels} | {full:.1f} | {near:.1f} | {full / near:.1f} | {mean:.1f} |", flush=True)
    scene = smoke_scene()
    full, near = (least(functools.partial(bake_smoke, scene, way), options.rounds) for way in (True, False))
    print(f"| smoke in a sun and a grey World | | {full:.1f} | {near:.1f} | {full / near:.1f} | |", flush=True)
    print(made_by(PROGRAM))


if __name__ == "__main__":
    main()
