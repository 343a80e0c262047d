# SPDX-License-Identifier: GPL-3.0-or-later
"""What a frame of Bake Animation takes beside a single bake, and whether memory stays flat.

    python -m benchmarks.cycles.baked_frames [--frames 100] [--voxels 100]

A sun turns about a cloud of so many voxels along an edge, so that each frame is baked. Prints processor seconds per
frame, files included, over those of a single bake, and how much memory the process gained after the first tenth of the
frames, over a frame's file. Needs bpy.
"""

import argparse
import os
import tempfile
import time
from dataclasses import replace
from pathlib import Path

from ..support.extension import load_extension
from ..support.provenance import made_by

PROGRAM = "benchmarks.cycles.baked_frames"
PAGE = os.sysconf("SC_PAGE_SIZE")


def memory() -> int:
    """Bytes that the process holds."""
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE


def main() -> None:
    """The command of the docstring."""
    parser = argparse.ArgumentParser(prog=PROGRAM, description=__doc__.split("\n")[0])
    parser.add_argument("--frames", type=int, default=100)
    parser.add_argument("--voxels", type=int, default=100)
    options = parser.parse_args()
    addon = load_extension()
    from tests.support import blender_scenes as scenes
    from training.procedural.volumes import make_volume

    baking, scene = addon.mrpnn_addon.baking, scenes.empty_scene()
    read_frame, bake_scene = addon.mrpnn_addon.scene.reader.read_frame, baking.bake_job.bake_scene
    with tempfile.TemporaryDirectory() as folder:
        density = make_volume(1_000_011, options.voxels).density
        path = scenes.write_vdb(Path(folder), density, scenes.centred(len(density), 2.0))
        scenes.add_volume(scene, path, Density=20.0, Color=(1.0,) * 4, Anisotropy=0.5)
        sun, _ = scenes.add_sun(scene), scenes.add_camera(scene)
        settings = replace(scene.mrpnn.settings(), directional=True)
        sequence = baking.light_sequence.LightSequence(os.path.join(folder, "frames"))

        def bake(frame: int, target: object) -> object:
            sun.rotation_euler[0] = 0.02 * frame
            return bake_scene(read_frame(scenes.depsgraph(), goes_on=True), settings, target)

        # The first bake loads the network.
        bake(-1, baking.bake_job.BakeTarget(os.path.join(folder, "first")))
        start = time.process_time()
        bake(-2, baking.bake_job.BakeTarget(os.path.join(folder, "single")))
        single, start, held = time.process_time() - start, time.process_time(), 0
        for frame in range(options.frames):
            sequence.add(replace(bake(frame, sequence.target), frame=frame))
            if frame == options.frames // 10:
                held = memory()
        each = (time.process_time() - start) / options.frames
        size = os.path.getsize(sequence.frames[-1].volumes[0].path)
        print("| frames | a frame over a single bake | single bake, processor seconds | memory gained, files |")
        print("|---|---|---|---|")
        print(f"| {options.frames} | {each / single:.2f} | {single:.1f} | {(memory() - held) / size:.1f} |", flush=True)
    print(made_by(PROGRAM))
    addon.unregister()


if __name__ == "__main__":
    main()
