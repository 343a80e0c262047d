# SPDX-License-Identifier: GPL-3.0-or-later
"""Train the network for the error of `mrpnn`, on volumes that `mrpnn` has not seen, and write it as ONNX.

    nice python -m training.train_uncertainty --data data/uncertainty --out inference/weights/uncertainty/mrpnn.onnx

Reads files of training.data.targets. Their two halves A and B are independent, so that (y - A)(y - B) / y^2 for the
prediction y has the squared relative error as its mean, without the targets' noise; it is noisy and may be negative.
The loss log s^2 + (y - A)(y - B) / (y s)^2 has its least mean where s^2 is the mean of that (QLIKE, Patton 2011). Rows
count the less, the noisier rows like them are. Every fifth volume is held back; the steps at which the loss on them is
least are kept. Takes minutes.
"""

import argparse
import copy
import hashlib
import json
import pathlib

import numpy as np
import torch

from inference.network import weights_file
from inference.network.uncertainty import inputs
from training.evaluate import load_weights
from training.export import save
from training.networks.uncertainty import UncertaintyNet
from training.onnx_graph import Graph
from training.train import RADIANCE_EPS, bins, first_rows, load, rate

STEPS, BATCH, LEARNING_RATE, WEIGHT_DECAY = 4000, 8192, 2e-3, 0.02
#: Deviation beside which the targets' noise counts, and the bound of a row's squared error.
TYPICAL, LARGEST = 0.15, 25.0
REPORT_EVERY = 200
#: A volume of so many is held back.
HELD = 5


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
    stencil, ray, g, gamma = (values.numpy() for values in net.inputs(data, rows))
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


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=pathlib.Path, nargs="+", required=True)
    parser.add_argument("--out", required=True)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(options)
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)
    files = [file for folder in arguments.data for file in sorted(folder.glob("*.npz"))]
    data = read_rows(files)
    held = data["volume"] % HELD == HELD - 1
    if held.all() or not held.any():
        parser.error(f"at least {HELD} volumes are needed")
    train, test = ({key: values[chosen] for key, values in data.items()} for chosen in (~held, held))
    net = UncertaintyNet()
    net.calibrate(data["x"])
    optimizer = torch.optim.AdamW(net.parameters(), LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    best, kept = (float("inf"), 0), None
    for step in range(arguments.steps):
        picked = torch.randint(len(train["x"]), (BATCH,))
        loss = loss_of(net(train["x"][picked]), train["squared"][picked], train["trust"][picked])
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        for group in optimizer.param_groups:
            group["lr"] = LEARNING_RATE * rate(step, arguments.steps)
        optimizer.step()
        done = step + 1
        if done % REPORT_EVERY == 0 or done == arguments.steps:
            with torch.no_grad():
                deviation = net(test["x"])
                found = loss_of(deviation, test["squared"], test["trust"]).item()
            told, true = (
                (test["trust"] * values).sum() / test["trust"].sum() for values in (deviation**2, test["squared"])
            )
            if found < best[0]:
                best, kept = (found, done), copy.deepcopy(net.state_dict())
            print(f"{done:6d} {found:.4f} told {told.sqrt():.3f} true {true.clamp(min=0).sqrt():.3f}", flush=True)
    net.load_state_dict(kept)
    with torch.no_grad():
        typical = net(data["x"]).square().mean().sqrt().item()
    configuration = {
        "network": net.name,
        "of": hashlib.sha256((weights_file.WEIGHTS / "mrpnn.onnx").read_bytes()).hexdigest(),
        "volumes": len(files),
        "rows": len(data["x"]),
        "steps": arguments.steps,
        "kept_step": best[1],
        "held_loss": best[0],
        "typical": typical,
        "seed": arguments.seed,
    }
    graph = Graph()
    net.graph(graph)
    save(graph.model(net.name, {"configuration": json.dumps(configuration, sort_keys=True)}), arguments.out)


if __name__ == "__main__":
    main()
