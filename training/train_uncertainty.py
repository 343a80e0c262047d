# SPDX-License-Identifier: GPL-3.0-or-later
"""Train the network for the error of `mrpnn`, on volumes that `mrpnn` has not seen, and write it as ONNX.

    nice python -m training.train_uncertainty --data data/uncertainty --out inference/weights/uncertainty/mrpnn.onnx

Reads files of training.data.targets. Their two halves A and B are independent, so that (y - A)(y - B) / y^2 for the
prediction y has the squared relative error as its mean, without the targets' noise; it is noisy and may be negative.
The loss log s^2 + (y - A)(y - B) / (y s)^2 has its least mean where s^2 is the mean of that (QLIKE, Patton 2011). Rows
count the less, the noisier rows like them are. Trains without every fifth volume first, on which it compares what is
told with what is found, and then on all of them. Takes a minute.
"""

import argparse
import hashlib
import json
import math
import pathlib

import numpy as np
import torch

from inference.models import weights_file
from inference.network.uncertainty import inputs
from training.evaluate import load_weights
from training.export import save
from training.networks.uncertainty import UncertaintyNet
from training.onnx_graph import Graph
from training.train import RADIANCE_EPS, bins, first_rows, load

STEPS, BATCH, LEARNING_RATE, WEIGHT_DECAY, WARM_UP = 400, 8192, 1e-3, 0.1, 50
#: Deviation beside which the targets' noise counts, and the bound of a row's squared error.
TYPICAL, LARGEST = 0.15, 25.0
#: A volume of so many is held back at first; groups of rows of which what is told is compared with what is found.
HELD, GROUPS = 5, 8


def read_rows(files) -> dict:
    """Of all rows and albedos, in columns: x (N, COLUMNS), squared (N,) relative errors, trust (N,), volume (N,)."""
    net = load_weights(weights_file.WEIGHTS / "mrpnn.onnx").eval()
    data, firsts = load(files, net.columns), first_rows(files)
    rows = torch.arange(firsts[-1])
    with torch.no_grad():
        y = torch.cat([net(*net.inputs(data, part), data["albedo"][part].T).T for part in rows.split(8192)])
    a, b = data["radiance"].unbind(dim=1)
    # Where next to nothing is predicted, the error does not show.
    scale = y**2 + (0.1 * RADIANCE_EPS) ** 2
    squared = ((y - a) * (y - b) / scale).clamp(-LARGEST, LARGEST)
    half_noise = (0.5 * (a - b) ** 2 / scale).clamp(max=LARGEST).numpy()
    index, albedos = bins(data), y.shape[1]
    counts = np.maximum(np.bincount(index), 1)
    noise = np.stack([(np.bincount(index, column) / counts)[index] for column in half_noise.T], axis=1)
    stencil, ray, _, g, gamma = (values.numpy() for values in net.inputs(data, rows))
    found = [inputs(stencil, ray, g, gamma, *map(np.asarray, pair)) for pair in zip(data["albedo"].T, y.T)]
    return {
        "x": torch.from_numpy(np.concatenate(found)),
        "squared": squared.T.reshape(-1),
        "trust": torch.from_numpy((1.0 / (1.0 + (noise / TYPICAL**2) ** 2)).T.astype(np.float32).ravel()),
        "volume": torch.from_numpy(np.tile(np.repeat(np.arange(len(files)), np.diff(firsts)), albedos)),
    }


def loss_of(deviation, squared, trust):
    """Mean loss of rows; all (N,)."""
    return (trust * (2.0 * torch.log(deviation) + squared / deviation**2)).sum() / trust.sum()


def fit(data, arguments) -> UncertaintyNet:
    """The network, trained on rows."""
    torch.manual_seed(arguments.seed)
    net = UncertaintyNet()
    net.calibrate(data["x"])
    optimizer = torch.optim.AdamW(net.parameters(), LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    for step in range(arguments.steps):
        picked = torch.randint(len(data["x"]), (BATCH,))
        loss = loss_of(net(data["x"][picked]), data["squared"][picked], data["trust"][picked])
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        falling = 0.5 + 0.5 * math.cos(math.pi * step / arguments.steps)
        for group in optimizer.param_groups:
            group["lr"] = LEARNING_RATE * min(1.0, (step + 1) / WARM_UP) * falling
        optimizer.step()
    return net


@torch.no_grad()
def compare(net, data):
    """Print the errors that are told and those that are found, root mean squares, from the smallest told on."""
    told, trust = net(data["x"]), data["trust"]
    print(f"loss on volumes held back: {loss_of(told, data['squared'], trust):.3f}")
    print("| told | found |\n|---|---|")
    for rows in told.argsort().chunk(GROUPS):
        weight = trust[rows] / trust[rows].sum()
        squares = ((weight * values[rows]).sum().clamp(min=0.0).sqrt() for values in (told**2, data["squared"]))
        print("| {:.3f} | {:.3f} |".format(*squares), flush=True)


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=pathlib.Path, nargs="+", required=True)
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(options)
    torch.set_num_threads(arguments.threads)
    files = [file for folder in arguments.data for file in sorted(folder.glob("*.npz"))]
    data = read_rows(files)
    held = data["volume"] % HELD == HELD - 1
    if not held.any():
        parser.error(f"at least {HELD} volumes are needed")
    train, test = ({key: values[chosen] for key, values in data.items()} for chosen in (~held, held))
    compare(fit(train, arguments), test)
    net = fit(data, arguments)
    with torch.no_grad():
        typical = net(data["x"]).square().mean().sqrt().item()
    configuration = {
        "network": net.name,
        "of": hashlib.sha256((weights_file.WEIGHTS / "mrpnn.onnx").read_bytes()).hexdigest(),
        "volumes": len(files),
        "rows": len(data["x"]),
        "steps": arguments.steps,
        "batch": BATCH,
        "learning_rate": LEARNING_RATE,
        "weight_decay": WEIGHT_DECAY,
        "seed": arguments.seed,
        "typical": typical,
    }
    graph = Graph()
    net.graph(graph)
    arguments.out.parent.mkdir(parents=True, exist_ok=True)
    save(graph.model(net.name, {"configuration": json.dumps(configuration, sort_keys=True)}), str(arguments.out))


if __name__ == "__main__":
    main()
