"""Where a network is right: bias and error by angle, anisotropy, optical density and kind of volume.

    python -m training.evaluate --held data/test data/solids-test --checkpoint runs/mrpnn/checkpoint.pt

Compares predictions with the targets of held-back volumes at albedo 1. The targets' halves are
independent, so that their noise does not count. --checkpoint may also be an exported `mrpnn`, an ONNX file.
"""

import argparse
import pathlib

import numpy as np
import torch

from training.networks import NETWORKS
from training.train import BATCH, RADIANCE_EPS, first_rows, load, predict, start_from
from training.volumes import make_volume

BINS = {
    "gamma": (0.0, 0.3, 0.6, 1.0, 1.57, 2.2, 2.8, 3.15),
    "anisotropy": (-0.3, 0.0, 0.4, 0.7, 0.85, 0.9, 0.951),
    "sigma_hat": (1, 5, 20, 60, 200, 600, 2001),
}
#: Cells an edge of the volumes that are made to see which kind a seed gives.
KIND_CELLS = 32


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


def groups(files, data):
    """Names, ends and rows (N,) bool of what is told apart: bins of BINS, kinds of volume, all of a folder."""
    for name, edges in BINS.items():
        for low, high in zip(edges[:-1], edges[1:]):
            yield name, f"{low:g}", f"{high:g}", (data[name] >= low) & (data[name] < high)
    counts = np.diff(first_rows(files))
    for name, values in (
        ("kind", [make_volume(int(file.stem), KIND_CELLS).kind for file in files]),
        ("folder", [file.parent.name for file in files]),
    ):
        for value in sorted(set(values)):
            which = np.array(values) == value
            yield name, value, f"{which.sum()} volumes", torch.from_numpy(np.repeat(which, counts))


def predictions(net, data):
    """Predicted radiance (N,) and its targets' halves (2, N), at albedo 1, the first of each row."""
    net.eval()
    with torch.no_grad():
        parts = [
            predict(net, data, rows, torch.ones(1, len(rows)))[0] for rows in torch.arange(len(data["gamma"])).split(BATCH)
        ]
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
    square = (y - a) * (y - b) / (y**2 + RADIANCE_EPS**2)
    print("| quantity | from | to | rows | bias | relative RMSE of a point |\n|---|---|---|---|---|---|")
    for name, low, high, inside in groups(files, data):
        if inside.any():
            bias = y[inside].sum() / (0.5 * (a + b)[inside].sum()) - 1.0
            error = square[inside].mean().clamp(min=0.0).sqrt()
            print(f"| {name} | {low} | {high} | {inside.sum()} | {100 * bias:+.1f} % | {error:.3f} |")


if __name__ == "__main__":
    main()
