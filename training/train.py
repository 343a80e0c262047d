# SPDX-License-Identifier: GPL-3.0-or-later
"""Train a network on the files of training.data.targets or, for RPNN, of training.data.lattice_rows.

    nice python -m training.train --network mrpnn --data data/train --held data/test --run runs/mrpnn
    nice python -m training.train --network mrpnn --data data/train data/solids --shares 0.6 0.4 --held data/test \\
        --run runs/tuned --initial inference/weights/mrpnn.onnx --learning-rate 3e-4 --steps 3000

The second command starts from exported weights, whose configuration is kept in that of the new ones, and draws each
step's rows from the folders in the given shares. The data is read into memory; a run resumes from its checkpoint.
Writes to the run's folder: configuration.json; progress.jsonl, loss and error on held-back volumes by step;
checkpoint.pt, from which the run resumes and whose averaged weights are exported; and step-N.pt, copies of it.

The loss is relative L2 on radiance, w (y - t)^2 / (stop_gradient(y)^2 + (m / 2)^2). m is the mean radiance of rows of
like extinction, anisotropy and angle, so that rows dark among their like count little; w falls with the noise of such
rows' targets. It is linear in the targets' noise, so that it converges to their mean. Weights are averaged
exponentially.
"""

import argparse
import json
import math
import pathlib
import time
from dataclasses import dataclass

import numpy as np
import onnx
import torch

from training.data.targets import ANISOTROPY_RANGE, SIGMA_HAT_RANGE, SUNS
from training.files import complete_file
from training.networks import NETWORKS
from training.onnx_graph import linear_layers

STEPS = 12000
BATCH = 4096
LEARNING_RATE = 2e-3
WARM_UP = 500
#: Of matrices; biases do not decay.
WEIGHT_DECAY = 0.1
GRADIENT_NORM = 1.0
#: Edges of the bins over which `typical_radiance` and `trust` take means.
BINS = {
    "sigma_hat": np.geomspace(1.0, 2000.0, 9)[1:-1],
    "gamma": np.linspace(0.0, np.pi, 9)[1:-1],
    "anisotropy": np.array([0.01, 0.4, 0.7, 0.84, 0.9]),
}
TYPICAL_SHARE, MIN_TYPICAL = 0.5, 1e-4
#: Added to the targets' relative squared noise: noise below the network's own error does not matter.
NOISE_FLOOR = 0.1
#: Radiance below which the error on held-back volumes is not relative.
RADIANCE_EPS = 3e-3
AVERAGING = 0.999
#: Albedos of a row that are used each time it is drawn.
ALBEDOS_PER_STEP = 2
BFLOAT16 = bool(torch.cpu.get_capabilities().get("amx_bf16") or torch.cpu.get_capabilities().get("avx512_bf16"))
#: Rows that give the means and deviations by which a network standardises its inputs.
CALIBRATION_ROWS = 100_000


def first_rows(files):
    """int (files + 1,): each file's first row in what `load` returns, and the number of rows."""
    counts = [0]
    for file in files:
        with np.load(file) as data:
            counts.append(len(data["gamma"]))
    return np.cumsum(counts)


def load(files, columns):
    """Rows of all files as tensors: `columns`, those of BINS, albedo, and radiance (rows, halves, albedos)."""
    columns = {*columns, *BINS, "albedo", "radiance"}
    firsts, arrays = first_rows(files), {}
    for file, start, end in zip(files, firsts, firsts[1:]):
        with np.load(file) as data:
            for key in columns:
                values = data[key]
                if key not in arrays:
                    arrays[key] = np.empty((firsts[-1], *values.shape[1:]), values.dtype)
                arrays[key][start:end] = values
    return {key: torch.from_numpy(array) for key, array in arrays.items()}


def predict(net, data, rows, albedo):
    """Radiance float32 (A, N) of rows (N,) for albedos (A, N).

    In training, layers multiply in bfloat16 on processors that have it; on others that would be slower.
    """
    with torch.autocast("cpu", torch.bfloat16, enabled=net.training and BFLOAT16):
        return net(*net.inputs(data, rows), albedo)


def bins(data):
    """int (rows,): the bin of BINS that each row falls in."""
    index = np.zeros(len(data["gamma"]), int)
    for name, edges in BINS.items():
        index = index * (len(edges) + 1) + np.digitize(data[name].numpy(), edges)
    return index


def typical_radiance(data):
    """float32 (rows, albedos): mean target of the rows in the same bin, per column of albedos.

    data: with radiance (rows, halves, albedos).
    """
    index = bins(data)
    counts = np.maximum(np.bincount(index), 1)
    means = [np.bincount(index, column.numpy()) / counts for column in data["radiance"].mean(dim=1).T]
    return torch.from_numpy(np.stack(means, axis=1)[index].astype(np.float32)).clamp(min=MIN_TYPICAL)


def trust(data, typical):
    """float32 (rows, albedos): weights of rows, 1 on average, smaller where the targets of the same bin are noisier.

    Noise is the difference of a target's two halves. It is averaged over the bin, since weights that depend on a
    row's own noise would bias the loss. Rows of narrow phase functions are up to a hundred times as noisy as others,
    and what the network memorises of their noise would show in the others as well. data: as for `typical_radiance`;
    typical: its result.
    """
    index, weights = bins(data), []
    for (a, b), like in zip(data["radiance"].permute(2, 1, 0).numpy(), typical.T.numpy()):
        noise = np.bincount(index, 0.25 * (a - b) ** 2)
        scale = np.maximum(np.bincount(index, a * b), 0.0) + np.bincount(index, (TYPICAL_SHARE * like) ** 2)
        weights.append((1.0 / (noise / np.maximum(scale, 1e-30) + NOISE_FLOOR))[index])
    weights = torch.from_numpy(np.stack(weights, axis=1).astype(np.float32))
    return weights / weights.mean()


def relative_l2(prediction, target, typical, weight):
    """Mean of `weight` times the squared error over prediction^2 + (typical / 2)^2; all (A, N)."""
    scale = prediction.detach() ** 2 + (TYPICAL_SHARE * typical) ** 2
    return (weight * (prediction - target) ** 2 / scale).mean()


def held_error(net, data):
    """Root mean squared error relative to the prediction, without the targets' noise, and relative bias.

    The two halves a and b of a target are independent, so that the expectation of (y - a) (y - b) is the squared error.
    """
    squares, predicted, expected, count = 0.0, 0.0, 0.0, 0
    net.eval()
    with torch.no_grad():
        for rows in torch.arange(len(data["gamma"])).split(BATCH):
            y = predict(net, data, rows, data["albedo"][rows].T)
            a, b = data["radiance"][rows].permute(1, 2, 0)
            squares += ((y - a) * (y - b) / (y**2 + RADIANCE_EPS**2)).sum().item()
            predicted += y.sum().item()
            expected += 0.5 * (a + b).sum().item()
            count += y.numel()
    net.train()
    return math.sqrt(max(squares / count, 0.0)), predicted / expected - 1.0


def draw_rows(limits, shares, random):
    """Rows int (BATCH,), of which on average shares[i] lie between limits[i] and limits[i + 1]."""
    limits = torch.as_tensor(limits)
    part = torch.multinomial(torch.as_tensor(shares), BATCH, replacement=True, generator=random)
    place = torch.rand(BATCH, generator=random, dtype=torch.float64)
    return (limits[part] + place * (limits[part + 1] - limits[part])).long()


def start_from(net, path):
    """Load the weights of an ONNX file that training.export wrote into a network; returns their configuration."""
    model = onnx.load(path)
    net.restore(linear_layers(model))
    return json.loads({entry.key: entry.value for entry in model.metadata_props}["configuration"])


def rate(step: int, steps: int) -> float:
    """Factor of the learning rate: linear warm-up, then cosine decay to zero."""
    if step < WARM_UP:
        return (step + 1) / WARM_UP
    return 0.5 * (1.0 + math.cos(math.pi * (step - WARM_UP) / max(steps - WARM_UP, 1)))


def save(state, path):
    with complete_file(path) as file:
        torch.save(state, file)


@dataclass
class Data:
    """Rows to train on and held-back rows, as `load` returns them.

    train also holds `typical` and `trust`, (rows, albedos), and the mean of the halves as `radiance`.
    limits: int (folders + 1,), first row of each folder; shares: float64 (folders,), of each folder in a step's rows.
    facts: entries of the configuration.
    """

    train: dict
    held: dict
    limits: np.ndarray
    shares: torch.Tensor
    facts: dict


def read_data(arguments, columns, parser) -> Data:
    """The data that the command line names; ends the program with a message where a folder is empty."""
    folders = [sorted(folder.glob("*.npz"))[: arguments.volumes] for folder in arguments.data]
    held_files = sorted(arguments.held.glob("*.npz"))
    for folder, found in zip([*arguments.data, arguments.held], [*folders, held_files], strict=True):
        if not found:
            parser.error(f"no volumes in {folder}")
    if arguments.shares and len(arguments.shares) != len(folders):
        parser.error(f"{len(arguments.shares)} shares for {len(folders)} folders: name one for each")
    files = sum(folders, [])
    train, held = load(files, columns), load(held_files, columns)
    train["typical"] = typical_radiance(train)
    train["trust"] = trust(train, train["typical"])
    train["radiance"] = train["radiance"].mean(dim=1)
    limits = first_rows(files)[np.cumsum([0, *map(len, folders)])]
    shares = torch.tensor(arguments.shares or np.diff(limits), dtype=torch.float64)
    shares /= shares.sum()
    facts = {
        "volumes": len(files),
        "first_and_last_volume": [[found[0].stem, found[-1].stem] for found in folders],
        "volumes_a_folder": [len(found) for found in folders],
        "shares": shares.tolist(),
        "held_volumes": [held_files[0].stem, held_files[-1].stem],
        "rows": len(train["albedo"]),
        "suns_a_point": SUNS,
    }
    return Data(train, held, limits, shares, facts)


def parse_options(parser, options):
    parser.add_argument("--network", choices=sorted(NETWORKS), required=True)
    parser.add_argument("--data", type=pathlib.Path, nargs="+", required=True, help="folders of rows")
    parser.add_argument("--shares", type=float, nargs="+", help="of each folder in a step; default: its rows")
    parser.add_argument("--held", type=pathlib.Path, required=True, help="folder of held-back rows")
    parser.add_argument("--run", type=pathlib.Path, required=True, help="folder for checkpoints and progress")
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--initial", type=pathlib.Path, help="weights to start from, an exported ONNX file")
    parser.add_argument("--learning-rate", type=float, default=LEARNING_RATE)
    parser.add_argument("--volumes", type=int, help="train on the first so many files of each folder only")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--report-every", type=int, default=1000, help="steps between reports and checkpoints")
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args(options)


def draw_batch(data: Data, random):
    """Rows int (BATCH,) of a step, and their albedo, target, typical radiance and weight, each (albedos, BATCH)."""
    train, albedos = data.train, data.train["albedo"].shape[1]
    rows = draw_rows(data.limits, data.shares, random)
    columns = torch.rand(BATCH, albedos, generator=random).argsort(dim=1)[:, : min(ALBEDOS_PER_STEP, albedos)]
    return rows, *(train[key][rows].gather(1, columns).T for key in ("albedo", "radiance", "typical", "trust"))


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    arguments = parse_options(parser, options)
    arguments.run.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)

    net, averaged = NETWORKS[arguments.network](), NETWORKS[arguments.network]()
    data = read_data(arguments, net.columns, parser)
    rows, albedos = data.train["albedo"].shape
    configuration = {
        "network": arguments.network,
        "anisotropy_range": ANISOTROPY_RANGE,
        "sigma_hat_range": SIGMA_HAT_RANGE,
        **data.facts,
        "steps": arguments.steps,
        "batch": BATCH,
        "albedos_a_step": min(ALBEDOS_PER_STEP, albedos),
        "learning_rate": arguments.learning_rate,
        "weight_decay": WEIGHT_DECAY,
        "typical_share": TYPICAL_SHARE,
        "noise_least": NOISE_FLOOR,
        "averaging": AVERAGING,
        "parameters": sum(p.numel() for p in net.parameters()),
        "seed": arguments.seed,
    } | net.ranges
    if hasattr(net, "calibrate"):
        random = torch.Generator().manual_seed(arguments.seed)
        net.calibrate(*net.inputs(data.train, torch.randint(rows, (CALIBRATION_ROWS,), generator=random)))
    if arguments.initial:
        if not hasattr(net, "restore"):
            parser.error(f"--initial works for mrpnn only, not for {arguments.network}")
        configuration["initial"] = start_from(net, arguments.initial)
    (arguments.run / "configuration.json").write_text(json.dumps(configuration, indent=1))
    print(json.dumps(configuration), flush=True)

    averaged.load_state_dict(net.state_dict())
    matrices, biases = ([p for p in net.parameters() if (p.dim() > 1) == wide] for wide in (True, False))
    groups = [{"params": matrices}, {"params": biases, "weight_decay": 0.0}]
    optimizer = torch.optim.AdamW(groups, arguments.learning_rate, weight_decay=WEIGHT_DECAY)
    first, path = 0, arguments.run / "checkpoint.pt"
    if path.exists():
        checkpoint = torch.load(path, weights_only=True)
        net.load_state_dict(checkpoint["net"])
        averaged.load_state_dict(checkpoint["averaged"])
        optimizer.load_state_dict(checkpoint["optimizer"])
        first = checkpoint["step"]

    total, since, start = 0.0, 0, time.perf_counter()
    for step in range(first, arguments.steps):
        # Each step draws from a stream of its own, so that a resumed run takes the same path.
        picked, albedo, target, typical, weight = draw_batch(
            data, torch.Generator().manual_seed(arguments.seed * 1_000_003 + step)
        )
        loss = relative_l2(predict(net, data.train, picked, albedo), target, typical, weight)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), GRADIENT_NORM)
        for group in optimizer.param_groups:
            group["lr"] = arguments.learning_rate * rate(step, arguments.steps)
        optimizer.step()
        with torch.no_grad():
            keep = min(AVERAGING, (1 + step) / (10 + step))
            torch._foreach_lerp_(list(averaged.parameters()), list(net.parameters()), 1.0 - keep)
        total, since = total + loss.item(), since + 1
        done = step + 1
        if done % arguments.report_every == 0 or done == arguments.steps:
            error, bias = held_error(averaged, data.held)
            line = {"step": done, "loss": total / since, "held_rmse": error, "held_bias": bias}
            line["seconds"] = time.perf_counter() - start
            print(json.dumps(line), flush=True)
            with open(arguments.run / "progress.jsonl", "a") as log:
                log.write(json.dumps(line) + "\n")
            total, since = 0.0, 0
            state = {
                "step": done,
                "net": net.state_dict(),
                "averaged": averaged.state_dict(),
                "optimizer": optimizer.state_dict(),
                "configuration": configuration | {"step": done, "held_rmse": error, "held_bias": bias},
            }
            save(state, path)
            # A copy each time the steps have grown about threefold.
            if done in (1000, 3000, 10000) or done == arguments.steps:
                save(state, arguments.run / f"step-{done}.pt")


if __name__ == "__main__":
    main()
