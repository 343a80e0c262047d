# SPDX-License-Identifier: GPL-3.0-or-later
"""Bias and error of a network by angle, anisotropy, extinction, thickness and kind of volume.

    python -m training.evaluate --held data/test data/solids-test --checkpoint runs/mrpnn/checkpoint.pt

Compares predictions with the targets of held-back volumes at albedo 1 and prints a table. The targets' halves are
independent, so that their noise does not count; a column of its own gives it, relative to the predictions, and the last
line its correlation between suns. --checkpoint may also be an exported `mrpnn`, an ONNX file.
"""

import argparse
import pathlib

import numpy as np
import torch
from scipy.ndimage import distance_transform_edt

from evaluation.error import error_text
from training.data.targets import SUNS
from training.networks import NETWORKS
from training.procedural.volumes import make_volume
from training.train import BATCH, RADIANCE_EPS, first_rows, load, predict, start_from

BINS = {
    "gamma": (0.0, 0.3, 0.6, 1.0, 1.57, 2.2, 2.8, 3.15),
    "anisotropy": (-0.3, 0.0, 0.4, 0.7, 0.85, 0.9, 0.951),
    "sigma_hat": (1, 5, 20, 60, 200, 600, 2001),
}
#: Radii of the largest ball inside a volume's filled cells, in cube edges.
THICKNESS = (0.0, 0.05, 0.1, 0.2, 0.3, 1.0)
#: Cells per edge of the volumes that are generated again to find their kinds and thicknesses.
CELLS = 48


def load_weights(path: pathlib.Path):
    """The network of a checkpoint or of an exported file."""
    if path.suffix == ".onnx":
        net = NETWORKS["mrpnn"]()
        start_from(net, path)
        return net
    checkpoint = torch.load(path, weights_only=True)
    net = NETWORKS[checkpoint["configuration"]["network"]]()
    net.load_state_dict(checkpoint["averaged"])
    return net


def thickness(density: np.ndarray) -> float:
    """Radius of the largest ball inside the filled cells of a volume (n, n, n), in cube edges."""
    return distance_transform_edt(density > 0).max() / len(density)


def groups(files, data):
    """Quantity, bin's ends and rows, bool (N,), of each line of the table: BINS, thickness, kind of volume, folder."""
    volumes, counts = [make_volume(int(file.stem), CELLS) for file in files], np.diff(first_rows(files))
    values = {name: (data[name].numpy(), edges) for name, edges in BINS.items()}
    values["thickness"] = np.repeat([thickness(volume.density) for volume in volumes], counts), THICKNESS
    for name, (value, edges) in values.items():
        for low, high in zip(edges[:-1], edges[1:]):
            yield name, f"{low:g}", f"{high:g}", (value >= low) & (value < high)
    labels = {"kind": [volume.kind for volume in volumes], "folder": [file.parent.name for file in files]}
    for name, label in labels.items():
        for one in sorted(set(label)):
            which = np.array(label) == one
            yield name, one, f"{which.sum()} volumes", np.repeat(which, counts)


def noise_correlation(noise, firsts) -> float:
    """Mean correlation of two suns' noise at one point. noise: (N,) of all rows; firsts (files + 1,): `first_rows`."""
    # A file holds all its points for one sun after the other.
    suns = np.concatenate([noise[i:j].reshape(SUNS, -1) for i, j in zip(firsts, firsts[1:])], axis=1)
    products = suns @ suns.T
    own = np.trace(products)
    return float((products.sum() - own) / (own * (SUNS - 1)))


def predictions(net, data):
    """Predicted radiance (N,) and the halves of its targets (2, N) at albedo 1, the first of each row's albedos."""
    net.eval()
    with torch.no_grad():
        batches = torch.arange(len(data["gamma"])).split(BATCH)
        parts = [predict(net, data, rows, torch.ones(1, len(rows)))[0] for rows in batches]
    return torch.cat(parts), data["radiance"][:, :, 0].T


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--held", type=pathlib.Path, nargs="+", required=True)
    parser.add_argument("--checkpoint", type=pathlib.Path, required=True)
    arguments = parser.parse_args(options)
    net = load_weights(arguments.checkpoint)
    files = [file for folder in arguments.held for file in sorted(folder.glob("*.npz"))]
    data = load(files, net.columns)
    y, (a, b) = predictions(net, data)
    scale = y**2 + RADIANCE_EPS**2
    # The halves differ by twice the deviation of their mean.
    square, noise = (y - a) * (y - b) / scale, 0.25 * (a - b) ** 2 / scale
    print("| quantity | from | to | rows | bias | relative RMSE of a point | noise of its target |")
    print("|---|---|---|---|---|---|---|")
    for name, low, high, chosen in groups(files, data):
        inside = torch.from_numpy(chosen)
        if inside.any():
            bias = y[inside].sum() / (0.5 * (a + b)[inside].sum()) - 1.0
            error, noisy = (values[inside].mean().clamp(min=0.0).sqrt() for values in (square, noise))
            share = f"{inside.sum()} | {100 * bias:+.1f} %"
            print(f"| {name} | {low} | {high} | {share} | {error_text(error)} | {noisy:.2f} |")
    shared = noise_correlation(((a - b) / scale.sqrt()).numpy().astype(np.float64), first_rows(files))
    print(f"\nnoise of two suns' targets at one point: correlation {shared:.2f}")


if __name__ == "__main__":
    main()
