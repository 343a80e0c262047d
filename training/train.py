"""Train one of the networks on the files of training.data.targets (or, for RPNN, of training.data.lattice_rows).

    nice python -m training.train --network mrpnn --data data/train --held data/test --run runs/mrpnn
    nice python -m training.train --network mrpnn --data data/train data/solids --shares 0.6 0.4 --held data/test \\
        --run runs/tuned --initial inference/weights/mrpnn.onnx --learning-rate 3e-4 --steps 3000

The second starts from exported weights and draws the rows of a step from several folders in the shares named; the
configuration of those weights is kept in that of the new ones. Both read the data into memory and go on from their
run's checkpoint if there is one. The loss is relative L2 on radiance, w (y - t)^2 / (stop_gradient(y)^2 + (m / 2)^2),
where m is the mean radiance of rows of like optical density, anisotropy and angle: what is dark among its like shows
little; and w is the less the noisier targets of such rows are. It is linear in the targets' noise, so that it converges to
their mean. The exported weights are an
exponential moving average. progress.jsonl holds the loss and the error on held-back volumes against steps; step-N.pt
are early and late checkpoints.
"""

import argparse
import json
import math
import os
import pathlib
import time

import numpy as np
import onnx
import torch

from training.networks import NETWORKS
from training.onnx_graph import linear_layers
from training.data.targets import ANISOTROPY_RANGE, SIGMA_HAT_RANGE, SUNS

STEPS = 12000
BATCH = 4096
LEARNING_RATE = 2e-3
WARM_UP = 500
#: Of matrices; biases are left alone.
WEIGHT_DECAY = 0.1
GRADIENT_NORM = 1.0
#: Edges of the bins over which `typical_radiance` and `trust` take means.
BINS = {
    "sigma_hat": np.geomspace(1.0, 2000.0, 9)[1:-1],
    "gamma": np.linspace(0.0, np.pi, 9)[1:-1],
    "anisotropy": np.array([0.01, 0.4, 0.7, 0.84, 0.9]),
}
TYPICAL_SHARE, TYPICAL_LEAST = 0.5, 1e-4
#: Added to the targets' noise, a share of the loss's scale squared: less than the network itself errs by does not matter.
NOISE_LEAST = 0.1
#: Radiance below which the held-back error is not relative.
RADIANCE_EPS = 3e-3
AVERAGING = 0.999
#: Of a row's albedos, how many are used each time it is drawn.
ALBEDOS_A_STEP = 2
BFLOAT16 = bool(torch.cpu.get_capabilities().get("amx_bf16") or torch.cpu.get_capabilities().get("avx512_bf16"))
#: Rows from which a network that standardises its inputs takes their means and deviations.
CALIBRATION_ROWS = 100_000


def first_rows(files):
    """Of each file the number of its first row when `load` has read them all, and the number of rows: (files + 1,)."""
    counts = [0]
    for file in files:
        with np.load(file) as data:
            counts.append(len(data["gamma"]))
    return np.cumsum(counts)


def load(files, columns):
    """Rows of all files as torch tensors: the columns named, albedo, BINS', and radiance (rows, halves, albedos)."""
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
    """Radiance (A, N), float32, of some rows for albedos (A, N).

    In training, layers multiply in bfloat16 where the processor can; elsewhere that would be slower, not faster.
    """
    with torch.autocast("cpu", torch.bfloat16, enabled=net.training and BFLOAT16):
        return net(*net.inputs(data, rows), albedo)


def bins(data):
    """int (rows,): the bin of BINS that each row lies in."""
    index = np.zeros(len(data["gamma"]), int)
    for name, edges in BINS.items():
        index = index * (len(edges) + 1) + np.digitize(data[name].numpy(), edges)
    return index


def typical_radiance(data):
    """(rows, albedos): the mean target of the rows in the same bins, for each of the albedos' columns.

    data: with `radiance` (rows, halves, albedos).
    """
    index = bins(data)
    counts = np.maximum(np.bincount(index), 1)
    means = [np.bincount(index, column.numpy()) / counts for column in data["radiance"].mean(dim=1).T]
    return torch.from_numpy(np.stack(means, axis=1)[index].astype(np.float32)).clamp(min=TYPICAL_LEAST)


def trust(data, typical):
    """(rows, albedos): weights of rows, 1 on the mean, the smaller the noisier the targets of the rows in the same bins.

    Noise is what the two halves of a target differ by; a row's own does not count for more than its share of the bin's, so
    that the loss stays unbiased. Rows of narrow phase functions are up to a hundred times as noisy as others, and what the
    network learns of their noise by heart would show in the others as well. data: as in `typical_radiance`, and what it gave.
    """
    index, weights = bins(data), []
    for (a, b), like in zip(data["radiance"].permute(2, 1, 0).numpy(), typical.T.numpy()):
        noise = np.bincount(index, 0.25 * (a - b) ** 2)
        scale = np.maximum(np.bincount(index, a * b), 0.0) + np.bincount(index, (TYPICAL_SHARE * like) ** 2)
        weights.append((1.0 / (noise / np.maximum(scale, 1e-30) + NOISE_LEAST))[index])
    weights = torch.from_numpy(np.stack(weights, axis=1).astype(np.float32))
    return weights / weights.mean()


def relative_l2(prediction, target, typical, weight):
    scale = prediction.detach() ** 2 + (TYPICAL_SHARE * typical) ** 2
    return (weight * (prediction - target) ** 2 / scale).mean()


def held_error(net, data):
    """Root of the mean squared error relative to the prediction, without the targets' noise, and the relative bias.

    The two halves of a target are independent, so that (y - a) (y - b) is the squared error on average.
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
    """(BATCH,) rows: those between limits[i] and limits[i + 1] make up shares[i] of them, on average."""
    limits = torch.as_tensor(limits)
    part = torch.multinomial(torch.as_tensor(shares), BATCH, replacement=True, generator=random)
    place = torch.rand(BATCH, generator=random, dtype=torch.float64)
    return (limits[part] + place * (limits[part + 1] - limits[part])).long()


def start_from(net, path):
    """Give the network the weights of an ONNX file that `training.export` wrote; returns their configuration."""
    model = onnx.load(path)
    net.restore(linear_layers(model))
    return json.loads({entry.key: entry.value for entry in model.metadata_props}["configuration"])


def rate(step: int, steps: int) -> float:
    """Linear warm-up, then cosine decay to zero."""
    if step < WARM_UP:
        return (step + 1) / WARM_UP
    return 0.5 * (1.0 + math.cos(math.pi * (step - WARM_UP) / max(steps - WARM_UP, 1)))


def save(state, path):
    torch.save(state, f"{path}.partial")
    os.replace(f"{path}.partial", path)


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--network", choices=sorted(NETWORKS), required=True)
    parser.add_argument("--data", type=pathlib.Path, nargs="+", required=True, help="folders of rows")
    parser.add_argument("--shares", type=float, nargs="+", help="of each folder in a step's rows, not its rows' number")
    parser.add_argument("--held", type=pathlib.Path, required=True, help="data of held-back volumes")
    parser.add_argument("--run", type=pathlib.Path, required=True)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--initial", type=pathlib.Path, help="weights to start from, an exported ONNX file")
    parser.add_argument("--learning-rate", type=float, default=LEARNING_RATE)
    parser.add_argument("--volumes", type=int, help="train on the first so many files of each folder only")
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--report-every", type=int, default=1000, help="steps between reports and checkpoints")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(options)
    arguments.run.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)

    net, averaged = NETWORKS[arguments.network](), NETWORKS[arguments.network]()
    folders = [sorted(folder.glob("*.npz"))[: arguments.volumes] for folder in arguments.data]
    held_files = sorted(arguments.held.glob("*.npz"))
    for folder, found in zip([*arguments.data, arguments.held], [*folders, held_files], strict=True):
        if not found:
            parser.error(f"no volumes in {folder}")
    if arguments.shares and len(arguments.shares) != len(folders):
        parser.error(f"{len(arguments.shares)} shares for {len(folders)} folders: name one for each")
    files = sum(folders, [])
    train, held = load(files, net.columns), load(held_files, net.columns)
    train["typical"] = typical_radiance(train)
    train["trust"] = trust(train, train["typical"])
    train["radiance"] = train["radiance"].mean(dim=1)
    rows, albedos = train["albedo"].shape
    used = min(ALBEDOS_A_STEP, albedos)
    limits = first_rows(files)[np.cumsum([0, *map(len, folders)])]
    shares = torch.tensor(arguments.shares or np.diff(limits), dtype=torch.float64)
    shares /= shares.sum()
    configuration = {
        "network": arguments.network,
        "anisotropy_range": ANISOTROPY_RANGE,
        "sigma_hat_range": SIGMA_HAT_RANGE,
        "volumes": len(files),
        "first_and_last_volume": [[found[0].stem, found[-1].stem] for found in folders],
        "volumes_a_folder": [len(found) for found in folders],
        "shares": shares.tolist(),
        "held_volumes": [held_files[0].stem, held_files[-1].stem],
        "rows": rows,
        "suns_a_point": SUNS,
        "steps": arguments.steps,
        "batch": BATCH,
        "albedos_a_step": used,
        "learning_rate": arguments.learning_rate,
        "weight_decay": WEIGHT_DECAY,
        "typical_share": TYPICAL_SHARE,
        "noise_least": NOISE_LEAST,
        "averaging": AVERAGING,
        "parameters": sum(p.numel() for p in net.parameters()),
        "seed": arguments.seed,
    } | net.ranges
    if hasattr(net, "calibrate"):
        random = torch.Generator().manual_seed(arguments.seed)
        net.calibrate(*net.inputs(train, torch.randint(rows, (CALIBRATION_ROWS,), generator=random)))
    if arguments.initial:
        if not hasattr(net, "restore"):
            parser.error(f"--initial knows mrpnn alone, not {arguments.network}")
        configuration["initial"] = start_from(net, arguments.initial)
    (arguments.run / "configuration.json").write_text(json.dumps(configuration, indent=1))
    print(json.dumps(configuration), flush=True)

    averaged.load_state_dict(net.state_dict())
    matrices, biases = ([p for p in net.parameters() if (p.dim() > 1) == wide] for wide in (True, False))
    optimizer = torch.optim.AdamW(
        [{"params": matrices}, {"params": biases, "weight_decay": 0.0}], arguments.learning_rate, weight_decay=WEIGHT_DECAY)
    first, path = 0, arguments.run / "checkpoint.pt"
    if path.exists():
        checkpoint = torch.load(path, weights_only=True)
        net.load_state_dict(checkpoint["net"])
        averaged.load_state_dict(checkpoint["averaged"])
        optimizer.load_state_dict(checkpoint["optimizer"])
        first = checkpoint["step"]

    total, since, start = 0.0, 0, time.perf_counter()
    for step in range(first, arguments.steps):
        # Each step draws from its own stream, so that a resumed run takes the same path.
        random = torch.Generator().manual_seed(arguments.seed * 1_000_003 + step)
        picked = draw_rows(limits, shares, random)
        columns = torch.rand(BATCH, albedos, generator=random).argsort(dim=1)[:, :used]
        albedo = train["albedo"][picked].gather(1, columns).T
        target, *scales = (train[key][picked].gather(1, columns).T for key in ("radiance", "typical", "trust"))
        loss = relative_l2(predict(net, train, picked, albedo), target, *scales)
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
            error, bias = held_error(averaged, held)
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
            # Early and late: a checkpoint is kept each time the steps have grown about threefold.
            if done in (1000, 3000, 10000) or done == arguments.steps:
                save(state, arguments.run / f"step-{done}.pt")


if __name__ == "__main__":
    main()
