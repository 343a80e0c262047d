"""Whether a network has learnt its data by heart: its error on rows that it was trained on, against targets traced anew.

    python -m training.memory --data data/train --checkpoint inference/weights/mrpnn.onnx --every 40

Targets that a network was trained on do not tell its error: what it has learnt of their noise counts as if it were true.
Of every so many volumes a third of the points are traced again, with other random numbers and more paths. Prints, at albedo
1 and relative to the prediction: the error against these, which compares with that at held-back volumes; the noise of the
targets trained on; and the share of that noise which is found in the predictions, with its standard error over volumes.
"""

import argparse
import pathlib

import numpy as np

from inference.grids.working_cube import fit_cube
from inference.grids.optical_depth_sweep import sun_optical_depth
from training.evaluate import load_weights, predictions
from training.tracer.path_tracer import trace_points
from training.data.seeded_volume import seeded_volume
from training.data.targets import SUNS
from training.train import RADIANCE_EPS, load
from training.tracer.transport import prepare

PATHS = 512
#: Of a volume's points, every so many.
POINT_STEP = 3
#: Added to seeds, so that no random number is drawn twice.
AGAIN = 50_000_000


def trace_again(file: pathlib.Path, paths: int = PATHS):
    """Rows of a file of `training.data.targets` that are traced anew, int (R,), and their radiance float32 (halves, R) at albedo 1."""
    seed = int(file.stem)
    volume, _ = seeded_volume(seed)
    density, edge = volume.density, fit_cube(volume).edge
    with np.load(file) as data:
        count = len(data["gamma"]) // SUNS
        points = np.arange(0, count, POINT_STEP)
        suns = data["sun"][::count].astype(float)
        sun_tau = np.stack([sun_optical_depth(density, l * len(density), 1.0) for l in suns])
        columns = [data[key][points] for key in ("position", "omega", "sigma_hat", "anisotropy")]
    position, omega, sigma_hat, anisotropy = (column.astype(float) for column in columns)
    grid, albedos = prepare(density), np.ones((len(points), 1))
    halves = [
        trace_points(grid, suns, sun_tau, position, omega, sigma_hat / edge, anisotropy, albedos, paths // 2, other)
        for other in (2 * (seed + AGAIN), 2 * (seed + AGAIN) + 1)
    ]
    rows = (np.arange(SUNS)[:, None] * count + points).ravel()
    # (points, suns, 1) each; a file holds all its points for one sun after the other.
    return rows, np.stack([np.asarray(radiance)[..., 0].T.ravel() for radiance in halves]).astype(np.float32)


def remembered(y, trained, again):
    """Sums over rows: squared error and squared noise, relative, and the noise that predictions hold, for each.

    y: (R,) predictions; trained: (R,) targets; again: (2, R), independent of them and each other.
    """
    scale = y**2 + RADIANCE_EPS**2
    c, d = again
    error = ((y - c) * (y - d) / scale).sum()
    noise = ((trained - c) * (trained - d) / scale).sum()
    # Where the prediction goes with a target's noise; each half against the other, so that their own does not count.
    shared = (0.5 * ((y - c) * (trained - d) + (y - d) * (trained - c)) / scale).sum()
    return np.array([error, noise, shared, len(y)])


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--checkpoint", type=pathlib.Path, required=True)
    parser.add_argument("--every", type=int, default=40, help="volumes from one that is traced again to the next")
    parser.add_argument("--paths", type=int, default=PATHS)
    arguments = parser.parse_args(options)
    net = load_weights(arguments.checkpoint)
    found = []
    for file in sorted(arguments.data.glob("*.npz"))[:: arguments.every]:
        rows, again = trace_again(file, arguments.paths)
        y, halves = predictions(net, load([file], net.columns))
        found.append(remembered(y.numpy()[rows], halves.mean(dim=0).numpy()[rows], again))
    found = np.array(found)

    def summary(sums):
        error, noise, shared, count = sums
        return np.sqrt(max(error, 0.0) / count), np.sqrt(max(noise, 0.0) / count), shared / noise

    error, noise, share = summary(found.sum(axis=0))
    # Leave one volume out at a time.
    left = np.array([summary(found.sum(axis=0) - one)[2] for one in found]) if len(found) > 1 else np.zeros(1)
    deviation = np.sqrt((len(left) - 1) * left.var())
    print(f"{len(found)} volumes, {int(found[:, 3].sum())} rows: relative RMSE of a point {error:.3f}, noise of the targets trained "
          f"on {noise:.2f}, of which predictions hold {100 * share:.1f} % (+- {100 * deviation:.1f})")


if __name__ == "__main__":
    main()
