# SPDX-License-Identifier: GPL-3.0-or-later
"""What the fields cost that rays and networks read: the compiled kernels beside their twins in numpy.

    python -m benchmarks.cost.fields [--voxels 128] [--runs 5]

Processor seconds of the calling thread, the least of several runs, alternately compiled and in numpy. The twins are
the shortest statements of the same, not fast ones.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from inference.features.mip_lattices import build_lattices, padded_pyramid
from inference.grids.dense_grid import DenseGrid
from inference.grids.grid import Grid
from inference.grids.merge import resampled
from inference.grids.sun_optical_depth import SunOpticalDepth
from inference.grids.working_cube import fit_cube
from inference.kernels.library import Kernels, load_kernels
from inference.network.network import load_network
from inference.scene.sparse_grid import SparseGrid
from inference.transport.discrete_ordinates import CELLS, DiscreteOrdinates
from inference.transport.radiance_sweep import sweep_radiance

from ..support.provenance import made_by
from .speed import cloud

PROGRAM = "benchmarks.cost.fields"
SUN, SIGMA_HAT, ANISOTROPY = np.array([0.64, 0.48, -0.6]), 100.0, 0.857
# Cells of scattered emission along an edge, and its directions along an edge of a face.
EMISSION_CELLS, FACE = 32, 6


def stages(voxels: int) -> dict[str, Callable[[Kernels | None], object]]:
    """What is measured, by name."""
    volume, stencil = cloud(voxels), load_network("mrpnn").points
    cube, grid, dense = fit_cube(volume), Grid(volume), DenseGrid(volume.density)
    sparse = SparseGrid.of_dense(volume.density)
    pyramid = padded_pyramid(volume, cube, stencil)
    coarse = np.ascontiguousarray(
        pyramid[2][tuple([slice((len(pyramid[2]) - CELLS) // 2, None)] * 3)][:CELLS, :CELLS, :CELLS]
    )
    few = coarse[: 2 * EMISSION_CELLS : 2, : 2 * EMISSION_CELLS : 2, : 2 * EMISSION_CELLS : 2].astype(np.float64)
    solvers: dict[bool, DiscreteOrdinates] = {}

    def light(kernels: Kernels | None) -> object:
        compiled = kernels is not None
        if compiled not in solvers:
            solvers[compiled] = DiscreteOrdinates(coarse, SIGMA_HAT, ANISOTROPY, None, kernels)
        return solvers[compiled].light(SUN)

    return {
        "sun columns": lambda kernels: SunOpticalDepth(dense, SUN, kernels=kernels),
        "sun columns, sparse": lambda kernels: SunOpticalDepth(sparse, SUN, kernels=kernels),
        "density pyramid": lambda kernels: padded_pyramid(volume, cube, stencil, kernels=kernels),
        "lattices": lambda kernels: build_lattices(pyramid, SIGMA_HAT, stencil, kernels=kernels),
        "discrete ordinates": light,
        "emission sweep": lambda kernels: sweep_radiance(100.0 * few, few, 1.0 / 32, FACE, kernels=kernels),
        "merged volumes": lambda kernels: resampled(
            grid, grid.density, volume.world_from_index, np.array(volume.density.shape), kernels=kernels
        ),
    }


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=__doc__.splitlines()[0])
    parser.add_argument("--voxels", type=int, default=128, help="along an edge of the volume")
    parser.add_argument("--runs", type=int, default=5, help="of each stage, of which the fastest counts")
    chosen = parser.parse_args(arguments)
    kernels = load_kernels()
    print(f"{chosen.voxels}^3 voxels, kernels for {kernels.name}")
    print(f"{'':22}{'numpy':>12}{'compiled':>12}{'ratio':>8}")
    for name, work in stages(chosen.voxels).items():
        best = [np.inf, np.inf]
        for _ in range(chosen.runs):
            for place, used in enumerate((None, kernels)):
                start = time.thread_time()
                work(used)
                best[place] = min(best[place], time.thread_time() - start)
        print(f"{name:22}{1e3 * best[0]:>9.1f} ms{1e3 * best[1]:>9.1f} ms{best[0] / best[1]:>8.1f}", flush=True)
    print(made_by(PROGRAM, arguments, models=["mrpnn"]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
