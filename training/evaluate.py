"""Where the network is right on average: bias by angle, anisotropy and optical density.

    python -m training.evaluate --data data/train --checkpoint runs/first/checkpoint.pt

Compares the mean prediction with the mean target, at albedo 1, over the volumes that training
held back. Single targets are noisy; their means are not.
"""

import argparse
import pathlib

import numpy as np
import torch

from training.networks import MRPNN
from training.train import BATCH, batch_of, load

BINS = {
    "gamma": (0.0, 0.3, 0.6, 1.0, 1.57, 2.2, 2.8, 3.15),
    "anisotropy": (-0.3, 0.0, 0.4, 0.7, 0.85, 0.9, 0.951),
    "sigma_hat": (1, 5, 20, 60, 200, 600, 2001),
}


def predictions(net, data):
    """Predicted and target radiance (N,) at albedo 1, the first of each row."""
    predicted, target = [], []
    with torch.no_grad():
        for rows in torch.arange(len(data["gamma"])).split(BATCH):
            inputs, expected = batch_of(data, rows, torch.zeros(1, len(rows), dtype=torch.long))
            predicted.append(net(*inputs)[0])
            target.append(expected[0])
    return torch.cat(predicted).numpy(), torch.cat(target).numpy()


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--checkpoint", type=pathlib.Path, required=True)
    parser.add_argument("--volumes", type=int, default=24, help="held-back volumes, the first of the data")
    arguments = parser.parse_args(options)
    checkpoint = torch.load(arguments.checkpoint, weights_only=True)
    net = MRPNN()
    net.load_state_dict(checkpoint["averaged"])
    data = load(sorted(arguments.data.glob("*.npz"))[: arguments.volumes])
    predicted, target = predictions(net, data)
    print("| quantity | from | to | rows | bias |\n|---|---|---|---|---|")
    for name, edges in BINS.items():
        values = data[name].numpy()
        for low, high in zip(edges[:-1], edges[1:]):
            inside = (values >= low) & (values < high)
            if inside.any():
                bias = predicted[inside].sum() / target[inside].sum() - 1.0
                print(f"| {name} | {low:g} | {high:g} | {inside.sum()} | {100 * bias:+.1f} % |")


if __name__ == "__main__":
    main()
