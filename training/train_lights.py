# SPDX-License-Identifier: GPL-3.0-or-later
"""Train one network for every light, and compare it with what the renderer uses today, for each kind of light.

    python -m training.train_lights --volumes 40000-40399 --held 1000101-1000109 --out runs/lights

Volumes are made by several processes, traced on a GPU where numba finds one, and kept in memory: features and the
network run on the GPU of torch, or on the CPU. The network is trained once all volumes are there, or when `--seconds`
less `--training` have passed. Writes network.pt, held.npz (predictions, targets, terms, inputs and groups of held-back
volumes) and results.json, the errors of each kind of light. A group is a medium, a light and a channel of albedo.
"""

import argparse
import json
import math
import multiprocessing
import os
import pathlib
import pickle
import tempfile
import time
from concurrent.futures import Future, ProcessPoolExecutor
from typing import NamedTuple

import numpy as np
import torch

from training.data.light_rows import KINDS, MediumRows, VolumeRows, make_volume, predict_today
from training.data.targets import parse_range
from training.networks.any_light import AnyLight
from training.networks.light_features import LightRecords, LitPoints, light_features
from training.tracer.gpu_paths import available, trace_on_gpu
from training.tracer.light_paths import trace_paths
from training.tracer.scene import Sampling

#: Points of a volume and paths per point; a held-back one has a quarter of the points and more paths.
POINTS, PATHS, HELD_PATHS = 1024, 768, 4608
#: Lights and channels of held-back media.
HELD_JOBS = [(light, channel) for light in range(13) for channel in (1, 2)]
BATCH, RATE = 32768, 2e-3
#: Passes over all rows, after which training ends: more fit the noise of a few hundred volumes.
EPOCHS = 40
#: Noise of a group's targets from which on its rows count less, and share of its mean light in what errors are over.
QUIET, FLOOR = 0.15, 0.4
#: Volumes that are traced together, since few do not fill a GPU.
TOGETHER = 8
#: Bytes that arrays in files begin at a multiple of.
ALIGNED = 64


def save(value: object, folder: pathlib.Path) -> pathlib.Path:
    """Pickle to a new file, arrays one after the other, so that `load` copies none."""
    buffers: list[pickle.PickleBuffer] = []
    head = pickle.dumps(value, protocol=5, buffer_callback=buffers.append)
    handle, name = tempfile.mkstemp(dir=folder)
    with os.fdopen(handle, "wb") as file:
        sizes = [len(buffer.raw()) for buffer in buffers]
        start = np.array([len(head), len(sizes), *sizes], np.int64).tobytes() + head
        file.write(start + bytes(-len(start) % ALIGNED))
        for buffer, size in zip(buffers, sizes):
            file.write(buffer.raw())
            file.write(bytes(-size % ALIGNED))
    return pathlib.Path(name)


def load(path: pathlib.Path):
    """What `save` wrote; the file is removed."""
    data = np.fromfile(path, np.uint8)
    path.unlink()
    head, count = map(int, data[:16].view(np.int64))
    at = 16 + 8 * count
    start, buffers = at + head, []
    for size in map(int, data[16:at].view(np.int64)):
        start += -start % ALIGNED
        buffers.append(data[start : start + size].data)
        start += size
    return pickle.loads(data[at : at + head].tobytes(), buffers=buffers)


class Task(NamedTuple):
    """What a process makes: "train" or "held" volumes, or "today"'s predictions at the points of a held-back one.

    jobs: of `make_volume`.
    """

    kind: str
    seed: int
    points: int
    folder: pathlib.Path
    jobs: list | None = None


def make(task: Task) -> pathlib.Path:
    """In a process of its own: the file of `save`."""
    work = predict_today if task.kind == "today" else make_volume
    return save(work(task.seed, task.points, task.jobs), task.folder)


def trace(volumes: list[tuple[VolumeRows, int]]) -> list[list[tuple[np.ndarray, np.ndarray]]]:
    """Radiance (P, K, C, 2) and once (P, W + E, 2) of each medium of each volume; with paths per point."""
    jobs = [
        (rows.paths, Sampling(paths // 2, (2 * volume.seed + half) * len(volume.media) + number))
        for volume, paths in volumes
        for number, rows in enumerate(volume.media)
        for half in range(2)
    ]
    found = iter(trace_on_gpu(jobs) if available() else [trace_paths(*job) for job in jobs])
    return [
        [tuple(np.stack(halves, axis=-1) for halves in zip(next(found), next(found))) for _ in volume.media]
        for volume, _ in volumes
    ]


def read_volume(volume: VolumeRows, device: torch.device) -> list[tuple[torch.Tensor, torch.Tensor]]:
    """Terms (J, P, TERMS) and inputs (J, P, INPUTS) of each medium."""

    def tensor(values, kind=np.float32) -> torch.Tensor:
        return torch.from_numpy(np.array(values, kind)).to(device)

    density, emission = tensor(volume.density)[None, None], tensor(np.moveaxis(volume.emission, 3, 0))[None]
    environments, table = tensor(volume.environments), volume.lights
    found = []
    for rows in volume.media:
        lights, channels = rows.jobs.T
        records = LightRecords(
            tensor(table.family[lights], np.int64),
            tensor(table.towards[lights]),
            tensor(table.lamp[lights]),
            tensor(table.number[lights], np.int64),
        )
        fields = tensor(rows.fields, np.float16).float() * tensor(rows.scales)[:, None, None, None, None]
        albedo, mask = rows.medium.albedo, None if rows.mask is None else tensor(rows.mask)[None, None]
        points = LitPoints(
            density=density,
            emission=emission,
            environments=environments,
            sigma=rows.medium.sigma,
            g=rows.medium.anisotropy,
            low=tensor(np.asarray(albedo.low)[channels]),
            high=tensor(np.asarray(albedo.high)[channels]),
            mask=mask,
            fields=fields,
            lights=records,
            positions=tensor(rows.positions),
            omega=tensor(rows.omega),
        )
        found.append(light_features(points))
    return found


class Group(NamedTuple):
    """A medium, a light and a channel of albedo. light: mean of the targets; noise: of a point's target, over that."""

    seed: int
    medium: int
    job: int
    kind: int
    light: float
    noise: float
    sigma: float
    anisotropy: float


class Rows(NamedTuple):
    """N rows, over the mean light of their groups. targets: (N, 2), in halves. once: (N,), light that scatters once, of
    environments and emission. today: (N,), today's predictions, or 0. group: int (N,).
    """

    terms: torch.Tensor
    inputs: torch.Tensor
    targets: torch.Tensor
    once: torch.Tensor
    today: torch.Tensor
    group: torch.Tensor


class Collection:
    """Rows and groups, added volume by volume."""

    def __init__(self) -> None:
        self.parts: list[Rows] = []
        self.groups: list[Group] = []

    def add(self, volume: VolumeRows, number: int, features, traced, today=None) -> None:
        """Rows of medium `number`; features, traced: of `read_volume` and `trace`. today: (J, P), or None."""
        (terms, inputs), (radiance, once), rows = features, traced, volume.media[number]
        free = radiance.shape[1] - once.shape[1]
        for j, (light, channel) in enumerate(rows.jobs):
            target = torch.from_numpy(radiance[:, light, channel]).to(terms.device)
            mean = float(target.mean()) if len(target) else 0.0
            if not mean > 1e-12:
                continue
            noise = float((target[:, 0] - target[:, 1]).square().mean().sqrt()) / 2.0 / mean
            known = np.zeros((2, len(target)), np.float32)
            if light >= free:
                known[0] = once[:, light - free].mean(axis=-1) / mean
            if today is not None:
                known[1] = today[j] / mean
            single, before = torch.from_numpy(known).to(terms.device)
            group = torch.full((len(target),), len(self.groups), device=terms.device)
            self.parts.append(Rows(terms[j] / mean, inputs[j], target / mean, single, before, group))
            kind, medium = int(volume.lights.kind[light]), rows.medium
            self.groups.append(Group(volume.seed, number, j, kind, mean, noise, medium.sigma, medium.anisotropy))

    def rows(self) -> Rows:
        """All of them, one after the other."""
        return Rows(*(torch.cat(values) for values in zip(*self.parts)))


def train(rows: Rows, groups: list[Group], seconds: float, log=print) -> AnyLight:
    """Fit to rows for at most some seconds and EPOCHS; returns the moving average of the weights."""
    torch.manual_seed(0)
    device, count = rows.inputs.device, len(rows.inputs)
    noise = torch.tensor([group.noise for group in groups], device=device)[rows.group]
    weight = 1.0 / (QUIET**2 + noise**2)
    weight = weight / weight.mean()
    network, average = (AnyLight(rows.inputs.shape[1]).to(device) for _ in range(2))
    network.calibrate(rows.inputs)
    average.load_state_dict(network.state_dict())
    optimizer = torch.optim.AdamW(network.parameters(), lr=RATE, weight_decay=1e-4)
    start, step, batch = time.time(), 0, min(BATCH, count)
    steps = math.ceil(EPOCHS * count / batch)
    while True:
        done = max((time.time() - start) / seconds, step / steps)
        if done >= 1.0:
            break
        for parameters in optimizer.param_groups:
            parameters["lr"] = RATE * min(1.0, (step + 1) / 200) * 0.5 * (1.0 + math.cos(math.pi * done)) + 1e-6
        chosen = torch.randint(count, (batch,), device=device)
        y, t = network(rows.terms[chosen], rows.inputs[chosen]), rows.targets[chosen]
        # Its mean does not hold the targets' noise.
        loss = (weight[chosen] * (y - t[:, 0]) * (y - t[:, 1]) / (y.detach() ** 2 + FLOOR**2)).mean()
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        torch.nn.utils.clip_grad_norm_(network.parameters(), 1.0)
        optimizer.step()
        step += 1
        with torch.no_grad():
            pairs = list(average.parameters()), list(network.parameters())
            torch._foreach_lerp_(*pairs, 1.0 - min(0.998, step / (step + 10.0)))
        if step % 500 == 1:
            log(f"step {step} of {steps}: loss {loss.item():.4f}")
    return average


@torch.no_grad()
def predict(network: AnyLight, rows: Rows) -> torch.Tensor:
    """Of all rows (N,)."""
    return torch.cat([network(*some) for some in zip(rows.terms.split(BATCH), rows.inputs.split(BATCH))])


def compare(predictions: torch.Tensor, rows: Rows, groups: list[Group]) -> dict[str, dict[str, float]]:
    """For each kind of light, over its groups: errors of predictions (N,), which lack the targets' noise.

    rms, median: of a group's root mean square error over its mean light, where the noise is below half of that. bias,
    bias_size: mean of a group's bias, and of its size. Of emission, what is scattered once is part of the light.
    """
    kinds = torch.tensor([group.kind for group in groups], device=predictions.device)
    once = torch.where(kinds[rows.group] == len(KINDS) - 1, rows.once, 0.0)
    y, t = predictions + once, rows.targets + once[:, None]

    def mean(values: torch.Tensor) -> np.ndarray:
        sums = torch.zeros(2, len(groups), device=values.device, dtype=torch.float64)
        sums.index_add_(1, rows.group, torch.stack([values, torch.ones_like(values)]).double())
        return (sums[0] / sums[1]).cpu().numpy()

    light, result = mean(t.mean(dim=1)), {}
    squares, bias = mean((y - t[:, 0]) * (y - t[:, 1])) / light**2, mean(y) / light - 1.0
    quiet = np.array([group.noise < 0.5 for group in groups])
    for number, kind in enumerate(KINDS):
        own = quiet & (kinds.cpu().numpy() == number)
        if own.any():
            rms, median = (
                math.sqrt(max(float(value), 0.0)) for value in (squares[own].mean(), np.median(squares[own]))
            )
            values = rms, median, bias[own].mean(), np.abs(bias[own]).mean()
            result[kind] = {
                **dict(zip(("rms", "median", "bias", "bias_size"), (round(float(value), 4) for value in values))),
                "groups": int(own.sum()),
            }
    return result


class Maker:
    """Volumes as processes finish them, traced and read."""

    def __init__(self, tasks: list[Task], paths: tuple[int, int], device: torch.device, log) -> None:
        """paths: per point, of volumes to train on and of held-back ones."""
        self.tasks, self.paths, self.device, self.log = tasks[::-1], paths, device, log
        self.training, self.held = Collection(), Collection()
        self._waiting: dict[Future, Task] = {}
        self._held: list[tuple] = []
        self._today: dict[int, list[np.ndarray]] = {}

    def run(self, processes: int, last: float) -> None:
        """Until all is done, or a time has come."""
        pool = ProcessPoolExecutor(processes, multiprocessing.get_context("spawn"))
        try:
            while (self.tasks or self._waiting) and time.time() < last:
                while self.tasks and len(self._waiting) < processes + TOGETHER // 2:
                    task = self.tasks.pop()
                    self._waiting[pool.submit(make, task)] = task
                ready = [future for future in self._waiting if future.done()]
                if len(ready) < min(TOGETHER, len(self._waiting)):
                    time.sleep(0.1)
                    continue
                self._take(ready)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in list((pool._processes or {}).values()):
                process.kill()
        for volume, features, traced in self._held:
            today = self._today.get(volume.seed)
            for number, parts in enumerate(zip(features, traced)):
                self.held.add(volume, number, *parts, None if today is None else today[number])

    @property
    def compared(self) -> bool:
        """Whether today's predictions of every held-back volume are there."""
        return bool(self._held) and all(volume.seed in self._today for volume, _, _ in self._held)

    def _take(self, ready: list[Future]) -> None:
        volumes = []
        for future in ready:
            task, value = self._waiting.pop(future), load(future.result())
            if task.kind == "today":
                self._today[task.seed] = [np.array(values) for values in value]
            else:
                volumes.append((task.kind, value))
        traces = trace([(volume, self.paths[kind == "held"]) for kind, volume in volumes])
        for (kind, volume), traced in zip(volumes, traces):
            features = read_volume(volume, self.device)
            if kind == "held":
                # Today's predictions may come later.
                self._held.append((_without_cells(volume), features, traced))
                continue
            for number, parts in enumerate(zip(features, traced)):
                self.training.add(volume, number, *parts)
        self.log(
            f"{len(self._held)} held-back volumes, {len(self._today)} compared, {len(self.training.groups)} groups"
        )


def _without_cells(volume: VolumeRows) -> VolumeRows:
    """Apart from the file that its arrays are parts of."""
    nothing = np.empty(0)
    media = [
        MediumRows(rows.medium, nothing, nothing, np.array(rows.jobs), nothing, nothing, None, None)
        for rows in volume.media
    ]
    return VolumeRows(volume.seed, nothing, nothing, nothing, volume.lights, media)


def main(options=None):
    parser = argparse.ArgumentParser(
        prog="python -m training.train_lights",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--volumes", type=parse_range, required=True, help="seeds, FIRST-LAST")
    parser.add_argument("--held", type=parse_range, required=True, help="seeds of held-back volumes")
    parser.add_argument("--out", type=pathlib.Path, required=True)
    parser.add_argument("--seconds", type=float, default=3600.0, help="at most, in all")
    parser.add_argument("--training", type=float, default=300.0, help="seconds of these for the network")
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--points", type=int, default=POINTS)
    parser.add_argument("--paths", type=int, nargs=2, default=(PATHS, HELD_PATHS), help="per point, and of --held")
    arguments = parser.parse_args(options)
    start, device = time.time(), torch.device("cuda" if torch.cuda.is_available() else "cpu")
    arguments.out.mkdir(parents=True, exist_ok=True)

    def log(text: str) -> None:
        print(f"{time.time() - start:6.1f} s  {text}", flush=True)

    memory = pathlib.Path("/dev/shm")
    with tempfile.TemporaryDirectory(dir=memory if memory.is_dir() else None) as name:
        folder, few = pathlib.Path(name), max(arguments.points // 4, 1)
        tasks = [Task(kind, seed, few, folder, HELD_JOBS) for kind in ("held", "today") for seed in arguments.held]
        tasks += [Task("train", seed, arguments.points, folder) for seed in arguments.volumes]
        maker = Maker(tasks, tuple(arguments.paths), device, log)
        maker.run(arguments.processes, start + arguments.seconds - arguments.training)
    rows, groups = maker.training.rows(), maker.training.groups
    log(f"{len(rows.terms)} rows, {rows.inputs.shape[1]} inputs")
    network = train(rows, groups, max(start + arguments.seconds - time.time(), 10.0), log)
    torch.save({"weights": network.state_dict(), "inputs": rows.inputs.shape[1]}, arguments.out / "network.pt")
    results = {"training": compare(predict(network, rows), rows, groups)}
    rows, groups = maker.held.rows(), maker.held.groups
    predictions = predict(network, rows)
    results["held"] = compare(predictions, rows, groups)
    if maker.compared:
        emission = torch.tensor([group.kind == len(KINDS) - 1 for group in groups], device=device)[rows.group]
        results["today"] = compare(rows.today - torch.where(emission, rows.once, 0.0), rows, groups)
    for name, kinds in results.items():
        for kind, values in kinds.items():
            log(f"{name:8s} {kind:14s} {values}")
    (arguments.out / "results.json").write_text(json.dumps(results, indent=1))
    arrays = {name: values.cpu().numpy() for name, values in rows._asdict().items()}
    np.savez_compressed(arguments.out / "held.npz", predictions=predictions.cpu().numpy(), groups=groups, **arrays)


if __name__ == "__main__":
    main()
