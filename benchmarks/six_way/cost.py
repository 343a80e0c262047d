# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of a flipbook, and what the six light maps of a frame cost beside a render with one sun.

    python -m benchmarks.six_way.cost [--frames 4] [--edge 128] [--depth-samples 4]

A Blender simulation of smoke (51 x 49 x 98 voxels), denser from frame to frame, so that no frame reuses another's work.
"""

import argparse
import time

import numpy as np

from ..fidelity.real_volumes import real_density
from ..support.extension import extension
from ..support.provenance import made_by

PROGRAM = "benchmarks.six_way.cost"
FLIPBOOK = 64


def main(options: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        prog=f"python -m {PROGRAM}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--frames", type=int, default=4)
    parser.add_argument("--edge", type=int, default=128, help="of a tile, pixels")
    parser.add_argument("--depth-samples", type=int, default=4)
    parser.add_argument("--angle", type=float, default=0.0, help="of the suns, degrees")
    arguments = parser.parse_args(options)
    addon = extension()
    inference, maps_of = addon.inference, addon.mrpnn_addon.flipbook.light_maps
    density = real_density("smoke-wind")
    matrix = np.diag([1.0 / len(density)] * 3 + [1.0])
    matrix[:3, 3] = 0.5 / len(density) - 0.5
    world = np.eye(4)
    world[:3, :3], world[:3, 3] = np.array([(1, 0, 0), (0, 0, 1), (0, -1, 0)]).T, (0.0, -3.0, 0.0)
    size = (arguments.edge, arguments.edge)
    camera = inference.Camera(world, projection="orthographic", resolution=size, ortho_scale=1.0)
    settings = inference.Settings(depth_samples=arguments.depth_samples)
    spent, caches = np.zeros((arguments.frames, 2)), [inference.RenderCache() for _ in range(2)]
    # The first frame loads the network.
    for frame in range(-1, arguments.frames):
        volume = inference.Volume(density * (1.0 + 0.01 * frame), matrix)
        volumes = [(volume, inference.Medium(sigma_t=60.0, albedo=0.8))]
        description = addon.mrpnn_addon.scene.reader.SceneDescription(volumes=volumes, camera=camera)
        start = time.process_time()
        maps_of.render_tile(description, settings, np.radians(arguments.angle), cache=caches[0])
        six = time.process_time()
        inference.render(volumes, [inference.Sun((1.0, -1.0, 1.0), np.pi)], camera, settings, cache=caches[1])
        spent[frame] = six - start, time.process_time() - six
    tile, one = np.median(spent, axis=0)
    print("| pixels of a tile | depth samples | processor seconds of a tile | of 64 | beside a render with one sun |")
    print("|---|---|---|---|---|")
    facts = (
        f"{size[0]} × {size[1]}",
        arguments.depth_samples,
        f"{tile:.2f}",
        f"{FLIPBOOK * tile:.0f}",
        f"{tile / one:.1f} ×",
    )
    print("| " + " | ".join(map(str, facts)) + " |")
    print("\n" + made_by(PROGRAM, options))


if __name__ == "__main__":
    main()
