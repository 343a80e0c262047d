# SPDX-License-Identifier: GPL-3.0-or-later
"""What the fields cost that rays and networks read.

    python -m benchmarks.cost.fields [--voxels 128] [--runs 5]

Processor seconds of the calling thread, the least of several runs.
"""

import argparse
import time
from collections.abc import Callable

import numpy as np

from inference.features.mip_lattices import density_lattices, padded_pyramid
from inference.grids.dense_grid import DenseGrid
from inference.grids.grid import Grid
from inference.grids.merge import resampled
from inference.grids.sun_optical_depth import SunOpticalDepth
from inference.grids.working_cube import fit_cube
from inference.kernels.library import load_kernels
from inference.network.network import load_network
from inference.scene.sparse_grid import SparseGrid
from inference.source_terms.cell_sources import SunBeam
from inference.transport.discrete_ordinates import CELLS, DiscreteOrdinates
from inference.transport.radiance_sweep import sweep_radiance

from ..support.provenance import made_by
from .speed import cloud

PROGRAM = "benchmarks.cost.fields"
SUN, SIGMA_HAT, ANISOTROPY = np.array([0.64, 0.48, -0.6]), 100.0, 0.857
# Cells of scattered emission along an edge, and its directions along an edge of a face.
EMISSION_CELLS, FACE = 32, 6


def stages(voxels: int) -> dict[str, Callable[[], object]]:
    """What is measured, by name."""
    volume, stencil = cloud(voxels), load_network("mrpnn").points
    cube, grid, dense = fit_cube(volume), Grid(volume), DenseGrid(volume.density)
    sparse = SparseGrid.of_dense(volume.density)
    pyramid = padded_pyramid(volume, cube, stencil)
    coarse = np.ascontiguousarray(
        pyramid[2][tuple([slice((len(pyramid[2]) - CELLS) // 2, None)] * 3)][:CELLS, :CELLS, :CELLS]
    )
    few = coarse[: 2 * EMISSION_CELLS : 2, : 2 * EMISSION_CELLS : 2, : 2 * EMISSION_CELLS : 2].astype(np.float64)
    solver = DiscreteOrdinates(coarse, SIGMA_HAT, ANISOTROPY)
    return {
        "sun columns": lambda: SunOpticalDepth(dense, SUN),
        "sun columns, sparse": lambda: SunOpticalDepth(sparse, SUN),
        "density pyramid": lambda: padded_pyramid(volume, cube, stencil),
        "lattices": lambda: density_lattices(pyramid, SIGMA_HAT, stencil),
        "discrete ordinates": lambda: solver.solve(SunBeam(SUN)),
        "emission sweep": lambda: sweep_radiance(100.0 * few, few, 1.0 / 32, FACE),
        "merged volumes": lambda: resampled(
            grid, grid.density, volume.world_from_index, np.array(volume.density.shape)
        ),
    }


def main(arguments=None) -> int:
    parser = argparse.ArgumentParser(prog=f"python -m {PROGRAM}", description=__doc__.splitlines()[0])
    parser.add_argument("--voxels", type=int, default=128, help="along an edge of the volume")
    parser.add_argument("--runs", type=int, default=5, help="of each stage, of which the fastest counts")
    chosen = parser.parse_args(arguments)
    print(f"{chosen.voxels}^3 voxels, kernels for {load_kernels().name}")
    for name, work in stages(chosen.voxels).items():
        best = np.inf
        for _ in range(chosen.runs):
            start = time.thread_time()
            work()
            best = min(best, time.thread_time() - start)
        print(f"{name:22}{1e3 * best:>9.1f} ms", flush=True)
    print(made_by(PROGRAM, arguments, models=["mrpnn"]))
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
