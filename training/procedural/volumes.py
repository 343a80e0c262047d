# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural volumes to train on, each drawn from a seed.

A volume lies in the working cube: cell (i, j, k) of N^3 has its centre at ((i, j, k) + 0.5) / N - 0.5, axis 2 is up,
and the outermost layer of cells is empty. Its active part is centred and fills the cube along its longest axis, as a
real file fitted to its cube does.

    python -m training.procedural.volumes --seeds 0-23 --out FOLDER
"""

import argparse
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_dilation

from .shapes import random_rotation
from .solids import SOLIDS
from .volume_kinds import KINDS

#: Held-back seeds: to measure with, never to train on.
HELD_BACK = range(1_000_000, 1_001_000)
#: Seeds of solids filled with homogeneous fog, to train on and to measure with.
SOLID_SEEDS = range(500_000, 600_000)
HELD_BACK_SOLIDS = range(1_500_000, 1_501_000)
#: Seeds of the usual kinds with their denser parts evened out, to train on and to measure with.
SATURATED_SEEDS = range(600_000, 700_000)
HELD_BACK_SATURATED = range(1_600_000, 1_601_000)

#: Cells per edge of the scan that finds a field's peak and active box, and half the edge of the scanned cube.
_COARSE, _HALF = 64, 1.35
#: Share of active cells below which thin parts are raised.
_THIN = 0.003


@dataclass
class Sample:
    """A volume. kind: name of its generator; density: float32 (N, N, N), whose maximum is exactly 1."""

    kind: str
    density: np.ndarray


def _orientation(rng):
    """Rotation (3, 3): half upright and turned about the vertical, a quarter along some axis, else any."""
    angle = rng.uniform(0, 2 * np.pi)
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    choice = rng.random()
    if choice < 0.5:
        return turn
    if choice < 0.75:
        return np.eye(3)[rng.permutation(3)] * rng.choice([-1, 1], (3, 1)) @ turn
    return random_rotation(rng)


def _contrast(rng):
    """Power, threshold and cut-off: from homogeneous fog to a few dense cores in thin smoke."""
    power = np.exp(rng.uniform(np.log(0.5), np.log(3.0)))
    return power, rng.choice([0.0, rng.uniform(0.0, 0.15)]), 10 ** rng.uniform(-4, -2.3)


def _lattice(centre, edge, cells):
    """Cell centres (cells^3, 3) float32 of a cube of `edge` around `centre`."""
    axis = ((np.arange(cells) + 0.5) / cells - 0.5) * edge
    grid = np.stack(np.meshgrid(*(axis + c for c in centre), indexing="ij"), axis=-1)
    return grid.reshape(-1, 3).astype(np.float32)


class _Field:
    """A kind's density, rotated, cut at the domain's walls and remapped to [0, 1]."""

    def __init__(self, rng, kind):
        self._density = kind(rng)
        self._rotation = _orientation(rng).astype(np.float32)
        self._power, self._threshold, self._cut = _contrast(rng)
        # One in six is cut off at walls, like a simulation that filled its domain.
        self._walls = rng.uniform(0.3, 0.8, (2, 3)) if rng.random() < 1 / 6 else np.full((2, 3), np.inf)

    def raw(self, points):
        """Density at points (M, 3) before any remapping, 0 beyond the walls."""
        inside = ((points > -self._walls[0]) & (points < self._walls[1])).all(axis=1)
        return np.where(inside, self._density(points @ self._rotation), 0).astype(np.float32)

    def fit(self, raw):
        """Map the largest of `raw` to density 1; raise thin parts where almost nothing is left."""
        self._peak = max(float(raw.max()), 1e-12)
        present = self.remap(raw)
        while self._power > 0.4 and 0 < present.mean() < _THIN:
            self._power *= 0.85
            present = self.remap(raw)

    def remap(self, raw):
        """Density in [0, 1] of raw densities, float32."""
        values = (raw / np.float32(self._peak) - self._threshold) / (1 - self._threshold)
        values = np.clip(values, 0, None) ** self._power
        return np.where(values > self._cut, values, 0).astype(np.float32)


def _active_box(values, centre, edge):
    """Centre and extent (3,) of the bounding box of cells above 0, half a cell larger on each side."""
    cells = values.shape[0]
    low, high = [], []
    for axis in range(3):
        used = np.flatnonzero(values.any(axis=tuple(a for a in range(3) if a != axis)))
        low.append(used[0])
        high.append(used[-1] + 1)
    low = (np.array(low) - 0.5) / cells * edge + centre - edge / 2
    high = (np.array(high) + 0.5) / cells * edge + centre - edge / 2
    return (low + high) / 2, high - low


def _fill(field, active, scanned, points):
    """The field at the points of a cubic lattice, evaluated only near cells that are active in the scan."""
    near = binary_dilation(active, np.ones((3, 3, 3), bool))
    centre, edge = scanned
    index = ((points - (centre - edge / 2)) * (_COARSE / edge)).astype(np.int32).clip(0, _COARSE - 1)
    chosen = np.flatnonzero(near[index[:, 0], index[:, 1], index[:, 2]])
    values = np.zeros(len(points), np.float32)
    values[chosen] = field.remap(field.raw(points[chosen]))
    cells = round(len(points) ** (1 / 3))
    return values.reshape((cells,) * 3)


def _saturate(rng, density):
    """The density with cells above a quantile evened out, as where a source has saturated its surroundings."""
    level = np.quantile(density[density > 0], rng.uniform(0.3, 0.98))
    if rng.random() < 0.5:
        return np.minimum(density / level, 1)
    return 1 - np.exp(-density / level)


def make_volume(seed: int, resolution: int = 192) -> Sample:
    """The volume of a seed; the same seed gives the same volume.

    resolution: N >= 8, cells per edge. Raises ValueError below that.
    Seeds in HELD_BACK, HELD_BACK_SOLIDS and HELD_BACK_SATURATED are for measuring, never for training.
    """
    if resolution < 8:
        raise ValueError(f"a volume needs at least 8 cells per edge, not {resolution}")
    kinds = SOLIDS if seed in SOLID_SEEDS or seed in HELD_BACK_SOLIDS else KINDS
    for attempt in range(20):
        rng = np.random.default_rng([seed, attempt])
        kind = rng.choice(np.array(list(kinds), dtype=object), p=list(kinds.values()))
        field = _Field(rng, kind)
        centre, edge = np.zeros(3), 2 * _HALF
        # Two coarse scans find the peak and the active box.
        for _ in range(2):
            scanned = centre, edge
            raw = field.raw(_lattice(centre, edge, _COARSE))
            field.fit(raw)
            active = field.remap(raw).reshape((_COARSE,) * 3) > 0
            if not active.any():
                break
            centre, extent = _active_box(active, centre, edge)
            edge = float(extent.max())
        if not active.any():
            continue
        density = np.zeros((resolution,) * 3, np.float32)
        density[1:-1, 1:-1, 1:-1] = _fill(field, active, scanned, _lattice(centre, edge, resolution - 2))
        # An almost empty cube is no use for training: draw again.
        if density.max() > 0 and np.count_nonzero(density) > 0.002 * density.size:
            if seed in SATURATED_SEEDS or seed in HELD_BACK_SATURATED:
                density = _saturate(rng, density).astype(np.float32)
            density /= density.max()
            return Sample(kind.__name__, density)
    raise RuntimeError(f"seed {seed}: twenty draws gave no volume")


def contact_sheet(sample: Sample, size: int = 192) -> np.ndarray:
    """uint8 (size, 3 size): opacity along axis 1 and axis 0, with axis 2 up, and the densest slice across axis 1."""
    density = sample.density
    optical = [1 - np.exp(-40 * density.mean(axis=axis)) for axis in (1, 0)]
    middle = density[:, int(np.argmax(density.sum(axis=(0, 2)))), :] ** 0.5
    step = np.arange(size) * density.shape[0] // size
    return np.hstack([(255 * image.T[::-1][np.ix_(step, step)]).astype(np.uint8) for image in (*optical, middle)])


def main(argv=None):
    from PIL import Image

    parser = argparse.ArgumentParser(
        prog="python -m training.procedural.volumes", description="Contact sheet of volumes."
    )
    parser.add_argument("--seeds", default="0-23", help="a range, both ends included: 0-23")
    parser.add_argument("--resolution", type=int, default=192)
    parser.add_argument("--out", type=Path, required=True, help="folder for contact_sheet.png")
    options = parser.parse_args(argv)
    first, _, last = options.seeds.partition("-")
    tiles = []
    for seed in range(int(first), int(last or first) + 1):
        start = time.perf_counter()
        sample = make_volume(seed, options.resolution)
        seconds = time.perf_counter() - start
        mean, filled = sample.density.mean(), (sample.density > 0).mean()
        print(f"{seed:6d} {sample.kind:12s} mean {mean:.4f} filled {filled:.3f} {seconds:.1f} s", flush=True)
        tiles.append(contact_sheet(sample))
    columns = 3
    tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
    rows = [np.hstack(tiles[i : i + columns]) for i in range(0, len(tiles), columns)]
    options.out.mkdir(parents=True, exist_ok=True)
    target = options.out / "contact_sheet.png"
    Image.fromarray(np.vstack(rows)).save(target)
    print(target)


if __name__ == "__main__":
    main()
