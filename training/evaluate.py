"""Where a network is right: bias and error by angle, anisotropy and optical density.

    python -m training.evaluate --held data/test --checkpoint runs/mrpnn/checkpoint.pt

Compares predictions with the targets of held-back volumes at albedo 1. The targets' halves are
independent, so that their noise does not count.
"""

import argparse
import pathlib

import torch

from training.networks import NETWORKS
from training.train import BATCH, RADIANCE_EPS, load, predict

BINS = {
    "gamma": (0.0, 0.3, 0.6, 1.0, 1.57, 2.2, 2.8, 3.15),
    "anisotropy": (-0.3, 0.0, 0.4, 0.7, 0.85, 0.9, 0.951),
    "sigma_hat": (1, 5, 20, 60, 200, 600, 2001),
}


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
    parser.add_argument("--held", type=pathlib.Path, required=True)
    parser.add_argument("--checkpoint", type=pathlib.Path, required=True)
    arguments = parser.parse_args(options)
    checkpoint = torch.load(arguments.checkpoint, weights_only=True)
    net = NETWORKS[checkpoint["configuration"]["network"]]()
    net.load_state_dict(checkpoint["averaged"])
    data = load(sorted(arguments.held.glob("*.npz")), net.columns)
    y, (a, b) = predictions(net, data)
    square = (y - a) * (y - b) / (y**2 + RADIANCE_EPS**2)
    print("| quantity | from | to | rows | bias | relative RMSE of a point |\n|---|---|---|---|---|---|")
    for name, edges in BINS.items():
        for low, high in zip(edges[:-1], edges[1:]):
            inside = (data[name] >= low) & (data[name] < high)
            if inside.any():
                bias = y[inside].sum() / (0.5 * (a + b)[inside].sum()) - 1.0
                error = square[inside].mean().clamp(min=0.0).sqrt()
                print(f"| {name} | {low:g} | {high:g} | {inside.sum()} | {100 * bias:+.1f} % | {error:.3f} |")


if __name__ == "__main__":
    main()
