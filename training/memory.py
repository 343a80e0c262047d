# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a network has memorised its data: its error on rows that it was trained on, against targets traced again.

    python -m training.memory --data data/train --checkpoint inference/weights/mrpnn.onnx --every 40

The targets that a network was trained on do not tell its error, since memorised noise counts as if it were true. Of
every 40th volume a third of the points are traced again, with other random numbers and more paths. Prints, at albedo
1 and relative to the prediction: the error against the new targets, which compares with that on held-back volumes;
the noise of the targets trained on; and the share of that noise found in the predictions, with its standard error
over volumes.
"""

import argparse
import pathlib

import numpy as np

from inference.grids.working_cube import fit_cube
from training.data.targets import SUNS
from training.evaluate import load_weights, predictions
from training.procedural.seeded_volume import seeded_volume
from training.tracer.path_tracer import Sampling, Scene, Vertices, trace_points
from training.train import RADIANCE_EPS, load

PATHS = 512
#: One point of so many is traced again.
POINT_STEP = 3
#: Added to seeds, so that no random number is drawn twice.
SEED_OFFSET = 50_000_000


def trace_again(file: pathlib.Path, paths: int = PATHS):
    """Rows of a file of training.data.targets, int (R,), and new targets for them at albedo 1, float32 (halves, R)."""
    seed = int(file.stem)
    volume, _ = seeded_volume(seed)
    density, edge = volume.density, fit_cube(volume).edge
    with np.load(file) as data:
        count = len(data["gamma"]) // SUNS
        points = np.arange(0, count, POINT_STEP)
        suns = data["sun"][::count].astype(float)
        columns = [data[key][points] for key in ("position", "omega", "sigma_hat", "anisotropy")]
    position, omega, sigma_hat, anisotropy = (column.astype(float) for column in columns)
    scene = Scene(density, suns)
    vertices = Vertices(position, omega, sigma_hat / edge, anisotropy, np.ones((len(points), 1)))
    halves = [trace_points(scene, vertices, Sampling(paths // 2, 2 * (seed + SEED_OFFSET) + half)) for half in range(2)]
    rows = (np.arange(SUNS)[:, None] * count + points).ravel()
    # (points, suns, 1) each; a file holds all its points for one sun after the other.
    return rows, np.stack([radiance[..., 0].T.ravel() for radiance in halves])


def remembered(y, trained, again):
    """Sums over rows, float (4,): relative squared error, relative squared noise, noise found in predictions, rows.

    y: (R,) predictions; trained: (R,) targets; again: (2, R), independent of them and of each other.
    """
    scale = y**2 + RADIANCE_EPS**2
    c, d = again
    error = ((y - c) * (y - d) / scale).sum()
    noise = ((trained - c) * (trained - d) / scale).sum()
    # Covariance of predictions with the noise; each half against the other, so that their own noise does not count.
    shared = (0.5 * ((y - c) * (trained - d) + (y - d) * (trained - c)) / scale).sum()
    return np.array([error, noise, shared, len(y)])


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--checkpoint", type=pathlib.Path, required=True)
    parser.add_argument("--every", type=int, default=40, help="trace every so many volumes again")
    parser.add_argument("--paths", type=int, default=PATHS)
    arguments = parser.parse_args(options)
    net = load_weights(arguments.checkpoint)
    found = []
    for file in sorted(arguments.data.glob("*.npz"))[:: arguments.every]:
        rows, again = trace_again(file, arguments.paths)
        y, halves = predictions(net, load([file], net.columns))
        found.append(remembered(y.numpy()[rows], halves.mean(dim=0).numpy()[rows], again))
    if not found:
        parser.error(f"no volumes in {arguments.data}")
    found = np.array(found)

    def summary(sums):
        error, noise, shared, count = sums
        return np.sqrt(max(error, 0.0) / count), np.sqrt(max(noise, 0.0) / count), shared / noise

    error, noise, share = summary(found.sum(axis=0))
    # Jackknife over volumes.
    left = np.array([summary(found.sum(axis=0) - one)[2] for one in found]) if len(found) > 1 else np.zeros(1)
    deviation = np.sqrt((len(left) - 1) * left.var())
    print(
        f"{len(found)} volumes, {int(found[:, 3].sum())} rows: relative RMSE of a point {error:.3f}, noise of the "
        f"targets trained on {noise:.2f}, of which predictions hold {100 * share:.1f} % (+- {100 * deviation:.1f})"
    )


if __name__ == "__main__":
    main()
