# SPDX-License-Identifier: GPL-3.0-or-later
"""Path-traced radiance of lights of every kind at points of procedural volumes, apart from what networks read.

    nice python -m training.data.light_targets --out data/lights --volumes 20000-20999 1000100-1000149

With --gpu an NVIDIA GPU traces, several hundred times as fast as a core.
Writes one file per volume, `data/lights/0020000.npz` and so on. Files that exist are left alone, so that the command
can be stopped (Ctrl+C or SIGTERM) and started again. Several ranges take turns in proportion to their lengths, so that
the files are a balanced set whenever it stops. Held-back volumes (seeds from 1 000 000 on) have a quarter of the
points and HELD_BACK_PATHS times the paths.

The seed decides everything. `training.data.light_scene` makes the volume, its media and its lights from it.
`read_traces` reads a file together with its scene, and raises ValueError if the seed now makes another scene. P is the
number of points, C of albedo channels, M of media, and K of lights: suns, lamps, W environments and E emissions.

| array | dtype and shape | content |
|---|---|---|
| position, omega | float32 (P, 3) | point and ray direction, in the volume's cube |
| medium | uint8 (P,) | number of the point's medium |
| lamp | int8 (P,) | lamp around which the point was drawn, -1 where a camera ray scatters first |
| radiance | float32 (P, K, C, 2) | scattered at least twice, in two independent halves, without the vertex's albedo |
| once | float32 (P, W + E, 2) | scattered at the point alone, of environments and emissions |
| paths | int64 | paths per point, of both halves together |
| sigma, anisotropy | float32 (M,) | extinction per cube edge where the density is 1, mean cosine |
| albedo_kind, albedo_low, albedo_high | text (M,), float32 (M, C) | albedo where the mask is 0 and where it is 1 |
| suns, lamp_..., environments, emission_kind | | of `LightScene.parameters` |
| ..._blocks | float32 (..., 8, 8, 8) | block means of density, emission and masks, which `read_traces` compares |
"""

import argparse
import pathlib
import signal
import sys
import time

import numpy as np

from training.data.light_scene import LightScene, draw_light_points, light_scene
from training.data.targets import parse_range
from training.files import complete_file
from training.procedural.volumes import HELD_BACK
from training.tracer.density_grid import prepare
from training.tracer.gpu_paths import available, trace_on_gpu
from training.tracer.light_paths import PathScene, trace_paths
from training.tracer.path_tracer import Sampling

POINTS, PATHS, HELD_BACK_PATHS = 1024, 192, 6
#: Largest difference of a field's block means and parameters where it is still the same.
TOLERANCE = 1e-3


def make_traces(
    seed: int, points: int = POINTS, paths: int = PATHS, threads: int = 1, gpu: bool = False
) -> dict[str, np.ndarray]:
    """The arrays of one volume that the module describes. gpu: whether a GPU traces, from other random numbers."""
    scene, random = light_scene(seed)
    grid = prepare(scene.density)
    at = draw_light_points(scene, grid, random, points)
    traced, jobs = PathScene.of(grid, scene.lights), []
    for number, medium in enumerate(scene.media):
        own = np.flatnonzero(at.medium == number)
        starts = traced.paths(medium, (at.positions[own], at.omega[own]))
        for half in range(2):
            jobs.append((starts, Sampling(paths // 2, (2 * seed + half) * len(scene.media) + number)))
    found = trace_on_gpu(jobs) if gpu else [trace_paths(*job, threads) for job in jobs]
    count, channels = scene.lights.count, len(scene.media[0].albedo.low)
    free = len(scene.lights.environments) + scene.lights.emission.shape[3]
    radiance = np.empty((len(at.medium), count, channels, 2), np.float32)
    once = np.empty((len(at.medium), free, 2), np.float32)
    for number in range(len(scene.media)):
        own = np.flatnonzero(at.medium == number)
        for half in range(2):
            radiance[own, ..., half], once[own, :, half] = found[2 * number + half]
    return {
        **scene.parameters(),
        "position": at.positions,
        "omega": at.omega,
        "medium": at.medium.astype(np.uint8),
        "lamp": at.lamp.astype(np.int8),
        "radiance": radiance,
        "once": once,
        "paths": np.int64(2 * (paths // 2)),
    }


def read_traces(path: pathlib.Path) -> tuple[LightScene, dict[str, np.ndarray]]:
    """The scene and the arrays of a file. Raises ValueError where its seed makes another scene by now."""
    with np.load(path) as data:
        arrays = {key: data[key] for key in data.files}
    scene, _ = light_scene(int(arrays["seed"]))
    for name, values in scene.parameters().items():
        known = arrays[name]
        same = known.shape == values.shape
        if same and values.dtype.kind == "f":
            same = np.allclose(known.astype(float), values.astype(float), rtol=TOLERANCE, atol=TOLERANCE)
        elif same:
            same = np.array_equal(known, values)
        if not same:
            raise ValueError(f"{path}: seed {scene.seed} makes another scene by now: {name} differs")
    return scene, arrays


def in_turns(ranges: list[range]) -> list[int]:
    """Seeds of all ranges, so that every part from the first on holds about the same share of each."""
    return [
        seed for _, seed in sorted(((k + 0.5) / len(seeds), seed) for seeds in ranges for k, seed in enumerate(seeds))
    ]


def main(options=None):
    parser = argparse.ArgumentParser(
        prog="python -m training.data.light_targets",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--volumes", type=parse_range, nargs="+", required=True, help="seeds, FIRST-LAST, in turns")
    parser.add_argument("--points", type=int, default=POINTS)
    parser.add_argument("--paths", type=int, default=PATHS, help="per point, in two halves")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--gpu", action="store_true", help="trace on an NVIDIA GPU")
    arguments = parser.parse_args(options)
    if arguments.gpu and not available():
        parser.error("--gpu: numba finds no NVIDIA GPU")
    arguments.out.mkdir(parents=True, exist_ok=True)
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        for seed in in_turns(arguments.volumes):
            path = arguments.out / f"{seed:07d}.npz"
            if path.exists():
                continue
            start = time.process_time()
            held_back = seed >= HELD_BACK.start
            points = max(arguments.points // 4, 1) if held_back else arguments.points
            paths = arguments.paths * (HELD_BACK_PATHS if held_back else 1)
            arrays = make_traces(seed, points, paths, arguments.threads, arguments.gpu)
            with complete_file(path) as file:
                np.savez_compressed(file, **arrays)
            seconds = time.process_time() - start
            print(f"{path.name}: {len(arrays['medium'])} points in {seconds:.1f} s", flush=True)
    except KeyboardInterrupt:
        sys.exit("stopped; start the command again to go on")


if __name__ == "__main__":
    main()
