# SPDX-License-Identifier: GPL-3.0-or-later
"""Train the network for light from everywhere on the files of training.data.environment_targets.

    nice python -m training.train_environment --data data/exits --held data/exits-held --run runs/environment

Reads the data into memory; a run resumes from its checkpoint. The loss is L2 on the radiance that each volume's
environments scatter, of mean 1: on single scattering, and on all scattering for several albedos. As in a picture,
errors are relative to the mean over a medium's points, times what is left of even light at that albedo. The loss is
linear in the targets' noise, and the mean is not biased by what the network cannot know.

A step takes the rows of some views: points of one medium whose rays go roughly one way. To the points' errors it adds
the square of each view's bias, relative to its mean radiance, times `--view-weight`: of all that is wrong at the points
of a view, a picture shows most what they have in common.
"""

import argparse
import json
import math
import pathlib
import time

import numpy as np
import torch

from inference.environments.blurred_environment import blurred, read_image
from inference.environments.environment_light import direction_radiance
from inference.network import environment_features as features
from training.files import complete_file
from training.networks.environment import WIDTH, EnvironmentNet
from training.tracer.exits import decode_directions
from training.train import start_from

STEPS, LEARNING_RATE, WARM_UP, WEIGHT_DECAY = 8000, 2e-3, 300, 0.05
#: Views in a step, rows of each, and what the square of their biases counts beside that of the points' errors.
VIEWS, VIEW_ROWS, VIEW_WEIGHT = 64, 32, 16.0
AVERAGING = 0.999
#: Of a row's albedos the first is 1.
ALBEDOS = 4
#: Lower bounds of what errors are relative to: what is left of even light, and means over a medium's points.
LEAST_EVEN, LEAST_MEAN = 0.02, 0.2


def environment_values(images: np.ndarray, codes: np.ndarray) -> np.ndarray:
    """Radiance float32 (N, K, E) of environments (E, H, 2H) in directions (N, K) as `Exits` codes them."""
    rows, columns = images.shape[1:]
    d = decode_directions(np.arange(65536, dtype=np.uint16))
    row = np.clip(((0.5 - np.arcsin(np.clip(d[:, 2], -1, 1)) / np.pi) * rows).astype(int), 0, rows - 1)
    column = (np.arctan2(d[:, 1], d[:, 0]) * (columns / (2 * np.pi)) % columns).astype(int) % columns
    table = np.ascontiguousarray(images.astype(np.float32)[:, row, column].T)
    return table[codes]


def read_file(path: pathlib.Path, seed: int) -> dict:
    """Inputs, candidates and targets of one volume's rows."""
    with np.load(path) as data:
        d = {key: data[key] for key in data.files}
    images = d["environments"].astype(np.float32)
    depths, omega = d["depths"].astype(np.float32), d["omega"]
    sigma_hat, g = d["sigma_hat"], d["anisotropy"]
    opened = features.OpenMeans(depths, features.lobe_weights(omega), sigma_hat)
    light, absorbed = (np.moveaxis(d[name].astype(np.float32), 1, -1) for name in ("light", "absorbed"))
    seldom, even = features.seldom_scattered(light, absorbed, omega)
    x = features.inputs(d["density"].astype(np.float32), d["along"], opened, even, omega, sigma_hat, g)
    stacked = np.moveaxis(images, 0, -1)
    ahead = np.empty((len(x), len(features.BLUR_POWERS) + len(features.BLURS), len(images)), np.float32)
    for value in np.unique(g):
        own = np.flatnonzero(g == value)
        ahead[own] = read_image(blurred(stacked, features.blurs(float(value))), omega[own])
    candidates = features.candidates(ahead, opened.radiance(direction_radiance(stacked)), light, seldom, omega, g)
    random = np.random.default_rng([seed, 7])
    # Rays of a view have the same axis in common. Its albedos are the same, so that it has a bias.
    facing = np.abs(omega).argmax(axis=1)
    facing += 3 * (np.take_along_axis(omega, facing[:, None], axis=1)[:, 0] < 0.0)
    medium = np.unique(np.stack([sigma_hat, g]), axis=1, return_inverse=True)[1].reshape(-1)
    views, view = np.unique(6 * medium + facing, return_inverse=True)
    albedo = np.ones((len(views), ALBEDOS), np.float32)
    albedo[:, 1] = 1.0 - 10.0 ** random.uniform(-3.0, -0.7, len(views))
    albedo[:, 2] = random.uniform(0.7, 1.0, len(views))
    albedo[:, 3] = random.uniform(0.0, 1.0, len(views))
    albedo = albedo[view]
    values, n = environment_values(images, d["exits"]), d["scatterings"].astype(np.float32)
    lost = n >= 65535
    paths = values.shape[1]
    targets = np.empty((len(x), 2, 1 + ALBEDOS, len(images)), np.float32)
    for half in range(2):
        span = slice(half * paths // 2, (half + 1) * paths // 2)
        single = (n[:, span] == 0).astype(np.float32)
        powers = [single] + [(1.0 - single) * ~lost[:, span] * a[:, None] ** n[:, span] for a in albedo.T]
        targets[:, half] = np.stack(powers, axis=1) @ values[:, span] / single.shape[1]
    return {
        "x": x,
        "candidates": candidates.astype(np.float16),
        "albedo": albedo,
        "targets": targets.astype(np.float16),
        "sigma_hat": sigma_hat,
        "anisotropy": g,
        "view": view,
    }


def load(folder: pathlib.Path, most: int | None = None) -> dict:
    """All rows of a folder's files as tensors."""
    parts = [read_file(path, int(path.stem)) for path in sorted(folder.glob("*.npz"))[:most]]
    first = 0
    for part in parts:
        part["view"] += first
        first = part["view"].max() + 1
    return {key: torch.from_numpy(np.concatenate([part[key] for part in parts])) for key in parts[0]}


def predict(net, data, rows):
    """Radiance (N, 1 + ALBEDOS, E), and that of all light where even light of radiance 1 comes from everywhere.

    The latter, (N, 1 + ALBEDOS), is detached; its first column is 1.
    """
    x, albedo = data["x"][rows], data["albedo"][rows]
    single, multiple = net(x, data["candidates"][rows].float(), albedo)
    with torch.no_grad():
        shares, _ = net.weights(x)
        left = (albedo[:, :, None] ** net.orders * shares[:, None]).sum(dim=2)
    return torch.cat([single[:, None], multiple], dim=1), torch.cat([torch.ones_like(left[:, :1]), left], dim=1)


def totals(radiance):
    """Single scattering, and for each albedo all scattering, of radiance (N, 1 + ALBEDOS, E)."""
    return torch.cat([radiance[:, :1], radiance[:, 1:] + radiance[:, :1]], dim=1)


def number_media(data) -> torch.Tensor:
    """Number the media in data["medium"]; means (media, E) of the light that their rows scatter at albedo 1."""
    media = torch.stack([data["sigma_hat"], data["anisotropy"]], dim=1)
    data["medium"] = torch.unique(media, dim=0, return_inverse=True)[1]
    targets = data["targets"].float().mean(dim=1)[:, :2].sum(dim=1)
    count = torch.bincount(data["medium"])
    return torch.zeros(len(count), targets.shape[1]).index_add_(0, data["medium"], targets) / count[:, None]


def number_views(data) -> tuple[torch.Tensor, torch.Tensor]:
    """Rows in the order of their views, and where each view ends among them."""
    return torch.argsort(data["view"], stable=True), torch.cumsum(torch.bincount(data["view"]), dim=0)


def draw_rows(order, ends, random) -> torch.Tensor:
    """Rows (VIEWS, VIEW_ROWS) of random views; of small ones some are drawn more than once."""
    views = torch.randint(len(ends), (VIEWS,), generator=random)
    counts = torch.diff(ends, prepend=ends.new_zeros(1))[views, None]
    place = (torch.rand(VIEWS, VIEW_ROWS, generator=random) * counts).long()
    return order[ends[views, None] - counts + place]


def view_biases(y, t):
    """Biases relative to the mean radiance of views, (VIEWS, 1 + ALBEDOS, E), of totals (VIEWS * VIEW_ROWS, ...)."""
    y, t = (values.unflatten(0, (VIEWS, VIEW_ROWS)).mean(dim=1) for values in (y, t))
    return (y - t) / t.clamp_min(LEAST_EVEN * LEAST_MEAN)


def held_biases(net, data) -> dict:
    """Root mean squares of the biases of views without the targets' noise, all light, at albedos of 1 and 0.7 to 1."""
    net.eval()
    order, ends = number_views(data)
    squares = []
    with torch.no_grad():
        for rows in torch.tensor_split(order, ends[:-1]):
            halves = data["targets"][rows].float().mean(dim=0)[:, None]
            y, a, b = (totals(part)[0, [1, 3]] for part in (predict(net, data, rows)[0].mean(dim=0)[None], *halves))
            squares.append((y - a) * (y - b) / (0.5 * (a + b)).clamp_min(LEAST_EVEN * LEAST_MEAN) ** 2)
    net.train()
    one, less = torch.stack(squares).mean(dim=(0, 2)).clamp_min(0.0).sqrt().tolist()
    return {"view_bias": one, "albedo_view_bias": less}


def held_error(net, data) -> dict:
    """Relative errors without the targets' noise, and biases, of all light at albedo 1 by G and sigma_hat."""
    net.eval()
    with torch.no_grad():
        parts = [predict(net, data, rows)[0] for rows in torch.arange(len(data["x"])).split(8192)]
    y = torch.cat(parts)
    net.train()
    t = data["targets"].float()
    found = {}
    for name, pick in (("single", slice(0, 1)), ("multiple", slice(1, 2))):
        a, b, p = t[:, 0, pick], t[:, 1, pick], y[:, pick]
        found[name] = math.sqrt(max(((p - a) * (p - b)).mean().item(), 0.0))
    p, a, b = (v[:, 0] + v[:, 1] for v in (y, t[:, 0], t[:, 1]))
    square, mean = (p - a) * (p - b), 0.5 * (a + b)
    found["rmse"] = math.sqrt(max(square.mean().item(), 0.0))
    found["bias"] = (p.mean() / mean.mean() - 1.0).item()
    p, a, b = y[:, 3], t[:, 0, 3], t[:, 1, 3]
    found["albedo_rmse"] = math.sqrt(max(((p - a) * (p - b)).mean().item(), 0.0)) / (0.5 * (a + b)).mean().item()
    found["albedo_bias"] = (p.mean() / (0.5 * (a + b)).mean() - 1.0).item()
    g, s = data["anisotropy"], data["sigma_hat"]
    for lo, hi in ((-1, 0.2), (0.2, 0.7), (0.7, 0.87), (0.87, 1)):
        for low, high in ((0, 20), (20, 100), (100, 600), (600, 1e9)):
            pick = (g >= lo) & (g < hi) & (s >= low) & (s < high)
            if pick.any():
                found[f"G {lo}-{hi} sigma {low}-{high:g}"] = round(math.sqrt(max(square[pick].mean().item(), 0.0)), 4)
    return found


def rate(step: int, steps: int) -> float:
    if step < WARM_UP:
        return (step + 1) / WARM_UP
    return 0.5 * (1.0 + math.cos(math.pi * (step - WARM_UP) / max(steps - WARM_UP, 1)))


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=pathlib.Path, required=True)
    parser.add_argument("--held", type=pathlib.Path, required=True)
    parser.add_argument("--run", type=pathlib.Path, required=True)
    parser.add_argument("--steps", type=int, default=STEPS)
    parser.add_argument("--initial", type=pathlib.Path, help="weights to start from, an exported ONNX file")
    parser.add_argument("--learning-rate", type=float, default=LEARNING_RATE)
    parser.add_argument("--view-weight", type=float, default=VIEW_WEIGHT)
    parser.add_argument("--width", type=int, default=WIDTH, help="of the network's layers")
    parser.add_argument("--volumes", type=int)
    parser.add_argument("--threads", type=int, default=1)
    parser.add_argument("--report-every", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(options)
    arguments.run.mkdir(parents=True, exist_ok=True)
    torch.set_num_threads(arguments.threads)
    torch.manual_seed(arguments.seed)
    data, held = load(arguments.data, arguments.volumes), load(arguments.held)
    rows = len(data["x"])
    print(f"{rows} rows, {len(held['x'])} held back", flush=True)
    means = number_media(data).clamp_min(LEAST_MEAN)
    net, averaged = EnvironmentNet(arguments.width), EnvironmentNet(arguments.width)
    net.calibrate(data["x"])
    initial = {"initial": start_from(net, arguments.initial)} if arguments.initial else {}
    order, ends = number_views(data)
    averaged.load_state_dict(net.state_dict())
    optimizer = torch.optim.AdamW(net.parameters(), arguments.learning_rate, weight_decay=WEIGHT_DECAY)
    configuration = {
        "network": "environment",
        "volumes": len(list(arguments.data.glob("*.npz"))[: arguments.volumes]),
        "rows": rows,
        "steps": arguments.steps,
        "views_a_step": VIEWS,
        "rows_a_view": VIEW_ROWS,
        "view_weight": arguments.view_weight,
        "width": arguments.width,
        "learning_rate": arguments.learning_rate,
        "weight_decay": WEIGHT_DECAY,
        "seed": arguments.seed,
    } | initial
    first, path = 0, arguments.run / "checkpoint.pt"
    if path.exists():
        checkpoint = torch.load(path, weights_only=True)
        net.load_state_dict(checkpoint["net"])
        averaged.load_state_dict(checkpoint["averaged"])
        optimizer.load_state_dict(checkpoint["optimizer"])
        first = checkpoint["step"]
    total, since, start = 0.0, 0, time.process_time()
    for step in range(first, arguments.steps):
        random = torch.Generator().manual_seed(arguments.seed * 1_000_003 + step)
        picked = draw_rows(order, ends, random).flatten()
        y, even = predict(net, data, picked)
        y, t = totals(y), totals(data["targets"][picked].float().mean(dim=1))
        scale = even.clamp_min(LEAST_EVEN)[:, :, None] * means[data["medium"][picked]][:, None]
        loss = (((y - t) / scale) ** 2).mean() + arguments.view_weight * (view_biases(y, t) ** 2).mean()
        optimizer.zero_grad()
        loss.backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        for group in optimizer.param_groups:
            group["lr"] = arguments.learning_rate * rate(step, arguments.steps)
        optimizer.step()
        with torch.no_grad():
            keep = min(AVERAGING, (1 + step) / (10 + step))
            torch._foreach_lerp_(list(averaged.parameters()), list(net.parameters()), 1.0 - keep)
        total, since, done = total + loss.item(), since + 1, step + 1
        if done % arguments.report_every == 0 or done == arguments.steps:
            found = held_error(averaged, held) | held_biases(averaged, held)
            line = {"step": done, "loss": total / since, **found, "seconds": time.process_time() - start}
            print(json.dumps(line), flush=True)
            with open(arguments.run / "progress.jsonl", "a") as log:
                log.write(json.dumps(line) + "\n")
            total, since = 0.0, 0
            state = {
                "step": done,
                "net": net.state_dict(),
                "averaged": averaged.state_dict(),
                "optimizer": optimizer.state_dict(),
                "configuration": configuration | {"step": done, "held_rmse": found["rmse"], "held_bias": found["bias"]},
            }
            with complete_file(path) as file:
                torch.save(state, file)


if __name__ == "__main__":
    main()
