# SPDX-License-Identifier: GPL-3.0-or-later
"""RPNN's inputs for the rows of training data that it can learn from.

    python -m training.data.lattice_rows --data data/train --out data/rpnn-train

Reads the files of training.data.targets and writes one of the same name for each that has rows of RPNN's anisotropy,
with these rows and, of their albedos, the one that is 1: the arrays `lattice` float16 (rows, 10, 225), `gamma`,
`anisotropy`, `sigma_hat`, `albedo` (rows, 1) and `radiance` (rows, halves, 1), which the trainer reads as it reads
the others'. Volumes are generated again from their seeds. Files that exist are left alone.
"""

import argparse
import pathlib

import numpy as np

from inference.features.mip_lattices import density_pyramid
from inference.grids.working_cube import fit_cube, mean_density
from training.files import write_rows
from training.networks import RPNN
from training.procedural.seeded_volume import seeded_volume
from training.rpnn.lattice_predictor import density_feature
from training.rpnn.rpnn_lattice import make_sun_lattice, read_lattices, refined_levels

ANISOTROPY = np.float32(RPNN.ranges["anisotropy_range"][0])
#: Relative rounding of half precision, which keeps 11 bits.
HALF_STEP = 2.0**-10


def lattice_rows(seed: int, data) -> dict:
    """Arrays of the rows in `data`, a file of training.data.targets, that have RPNN's anisotropy.

    Raises ValueError where the seed's volume is not the one that the rows were made from.
    """
    rows = np.flatnonzero(data["anisotropy"] == ANISOTROPY)
    volume, _ = seeded_volume(seed)
    cube = fit_cube(volume)
    levels = refined_levels(density_pyramid(mean_density(volume, cube)))
    lattice = make_sun_lattice()
    density = read_lattices(
        lattice,
        levels,
        cube.positions(data["position"][rows]),
        cube.directions(data["omega"][rows]),
        cube.directions(data["sun"][rows]),
    )
    sigma_hat = data["sigma_hat"][rows]
    features = density_feature(sigma_hat[:, None, None], density)
    # Stencil and smallest lattice both read mip 0 at the point itself.
    centre = np.abs(lattice.points).sum(axis=1).argmin()
    stored = data["features"][rows, 0, 0]
    # A point within rounding of a cell's border may fall on either side.
    if not (np.isclose(features[:, 0, centre], stored, rtol=HALF_STEP, atol=1e-4).mean() > 0.99):
        raise ValueError("the seed no longer gives the volume that these rows are about; make the data anew")
    if not np.all(data["albedo"][rows, 0] == 1.0):
        raise ValueError("the first albedo of these rows is not 1")
    return {
        "lattice": features.astype(np.float16),
        "gamma": data["gamma"][rows],
        "anisotropy": data["anisotropy"][rows],
        "sigma_hat": sigma_hat,
        "albedo": data["albedo"][rows, :1],
        "radiance": data["radiance"][rows, ..., :1],
    }


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    arguments = parser.parse_args(options)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for file in sorted(arguments.data.glob("*.npz")):
        with np.load(file) as data:
            if np.any(data["anisotropy"] == ANISOTROPY):
                try:
                    write_rows(arguments.out / file.name, lambda: lattice_rows(int(file.stem), data))
                except ValueError as error:
                    parser.error(f"{file}: {error}")


if __name__ == "__main__":
    main()
