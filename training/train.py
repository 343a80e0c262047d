"""Train MRPNN on the files of training.targets.

    nice python -m training.train --data data/train --run runs/first --steps 20000

Reads the data into memory, holds the first volumes back for validation, and goes on from
the run's checkpoint if there is one, with whatever volumes there are by then. The loss is relative L2 on radiance,
(y - t)^2 / (stop_gradient(y)^2 + eps^2): linear in the targets' noise, so that it
converges to their mean. The exported weights are an exponential moving average.
"""

import argparse
import json
import math
import os
import pathlib
import time

import numpy as np
import torch

from training.networks import MRPNN
from training.targets import ALBEDOS, ANISOTROPY_RANGE, PATHS, POINTS, SIGMA_HAT_RANGE, SUNS

BATCH = 4096
LEARNING_RATE = 2e-3
WARM_UP = 500
WEIGHT_DECAY = 1e-4
GRADIENT_NORM = 1.0
RADIANCE_EPS = 3e-3
AVERAGING = 0.999
# Of a row's albedos, how many are used each time it is drawn.
ALBEDOS_A_STEP = 2

def load(files):
    """All rows of the files as torch tensors."""
    counts = []
    for file in files:
        with np.load(file) as data:
            counts.append(len(data["gamma"]))
    total, start, arrays = sum(counts), 0, {}
    for file, count in zip(files, counts):
        with np.load(file) as data:
            for key in data.files:
                if key not in arrays:
                    arrays[key] = np.empty((total, *data[key].shape[1:]), data[key].dtype)
                arrays[key][start : start + count] = data[key]
        start += count
    return {key: torch.from_numpy(array) for key, array in arrays.items()}


def batch_of(data, rows, columns):
    """Network inputs and targets of some rows; columns (A, rows) pick the albedos."""
    features = data["features"][rows].float().transpose(0, 1).contiguous()
    albedo = data["albedo"][rows].T.gather(0, columns)
    radiance = data["radiance"][rows].T.gather(0, columns)
    return (features, data["anisotropy"][rows], data["gamma"][rows], albedo), radiance


def relative_l2(prediction, target):
    scale = prediction.detach() ** 2 + RADIANCE_EPS**2
    return ((prediction - target) ** 2 / scale).mean()


def validate(net, data):
    """Mean relative L2 and relative bias of the mean radiance, over the held-back volumes."""
    loss, predicted, expected, count = 0.0, 0.0, 0.0, 0
    with torch.no_grad():
        for rows in torch.arange(len(data["gamma"])).split(BATCH):
            columns = torch.arange(ALBEDOS)[:, None].expand(-1, len(rows))
            inputs, target = batch_of(data, rows, columns)
            prediction = net(*inputs)
            loss += relative_l2(prediction, target).item() * len(rows)
            predicted += prediction.sum().item()
            expected += target.sum().item()
            count += len(rows)
    return loss / count, predicted / expected - 1.0


def rate(step: int, steps: int) -> float:
    """Linear warm-up, then cosine decay to zero."""
    if step < WARM_UP:
        return (step + 1) / WARM_UP
    return 0.5 * (1.0 + math.cos(math.pi * (step - WARM_UP) / max(steps - WARM_UP, 1)))


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--run", type=pathlib.Path, required=True)
    parser.add_argument("--steps", type=int, default=20000)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--validation", type=int, default=24, help="volumes held back")
    parser.add_argument("--report-every", type=int, default=500, help="steps between reports and checkpoints")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(options)
    arguments.run.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)

    files = sorted(arguments.data.glob("*.npz"))
    if len(files) <= arguments.validation:
        parser.error(f"{arguments.data} holds {len(files)} volumes; more than {arguments.validation} are needed")
    train, held = load(files[arguments.validation :]), load(files[: arguments.validation])
    rows = len(train["gamma"])
    configuration = {
        "network": "mrpnn",
        "anisotropy_range": ANISOTROPY_RANGE,
        "sigma_hat_range": SIGMA_HAT_RANGE,
        "volumes": [files[arguments.validation].stem, files[-1].stem],
        "validation_volumes": [files[0].stem, files[arguments.validation - 1].stem],
        "rows": rows,
        "points_a_volume": POINTS,
        "suns_a_point": SUNS,
        "paths_a_point": PATHS,
        "steps": arguments.steps,
        "batch": BATCH,
        "albedos_a_step": ALBEDOS_A_STEP,
        "learning_rate": LEARNING_RATE,
        "weight_decay": WEIGHT_DECAY,
        "radiance_eps": RADIANCE_EPS,
        "averaging": AVERAGING,
        "seed": arguments.seed,
    }
    (arguments.run / "configuration.json").write_text(json.dumps(configuration, indent=1))
    print(json.dumps(configuration), flush=True)

    net, averaged = MRPNN(), MRPNN()
    averaged.load_state_dict(net.state_dict())
    optimizer = torch.optim.AdamW(net.parameters(), lr=LEARNING_RATE, weight_decay=WEIGHT_DECAY)
    first, path = 0, arguments.run / "checkpoint.pt"
    if path.exists():
        checkpoint = torch.load(path, weights_only=True)
        net.load_state_dict(checkpoint["net"])
        averaged.load_state_dict(checkpoint["averaged"])
        optimizer.load_state_dict(checkpoint["optimizer"])
        first = checkpoint["step"]

    total, start = 0.0, time.perf_counter()
    for step in range(first, arguments.steps):
        # Each step draws from its own stream, so that a resumed run takes the same path.
        random = torch.Generator().manual_seed(arguments.seed * 1_000_003 + step)
        picked = torch.randint(rows, (BATCH,), generator=random)
        columns = torch.rand(BATCH, ALBEDOS, generator=random).argsort(dim=1)[:, :ALBEDOS_A_STEP].T
        inputs, target = batch_of(train, picked, columns)
        loss = relative_l2(net(*inputs), target)
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), GRADIENT_NORM)
        for group in optimizer.param_groups:
            group["lr"] = LEARNING_RATE * rate(step, arguments.steps)
        optimizer.step()
        with torch.no_grad():
            keep = min(AVERAGING, (1 + step) / (10 + step))
            for slow, fast in zip(averaged.parameters(), net.parameters()):
                slow.lerp_(fast, 1.0 - keep)
        total += loss.item()
        if (step + 1) % arguments.report_every == 0 or step + 1 == arguments.steps:
            held_loss, held_bias = validate(averaged, held)
            seconds = time.perf_counter() - start
            line = {"step": step + 1, "loss": total / arguments.report_every, "held_loss": held_loss}
            line |= {"held_bias": held_bias, "seconds": seconds}
            print(json.dumps(line), flush=True)
            with open(arguments.run / "progress.jsonl", "a") as log:
                log.write(json.dumps(line) + "\n")
            total = 0.0
            state = {
                "step": step + 1,
                "net": net.state_dict(),
                "averaged": averaged.state_dict(),
                "optimizer": optimizer.state_dict(),
                "configuration": configuration | {"step": step + 1, "held_loss": held_loss, "held_bias": held_bias},
            }
            torch.save(state, f"{path}.partial")
            os.replace(f"{path}.partial", path)


if __name__ == "__main__":
    main()
