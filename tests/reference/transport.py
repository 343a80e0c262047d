# SPDX-License-Identifier: GPL-3.0-or-later
"""Light in coarse cells: what kernels do with the fields of their structures, and the same for whole calculations."""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from inference.environments.environment_light import DIRECTIONS
from inference.environments.open_depths import LENGTHS, LEVELS, MIDDLES, REACH, OpenDepths
from inference.kernels import library
from inference.kernels.structures import Shared

Fields = dict[str, Any]


@contextlib.contextmanager
def in_numpy() -> Iterator[None]:
    """Let the functions of KERNELS take the place of the kernels of their names."""
    compiled, load = library.load_kernels(), library.load_kernels

    class InNumpy:
        def call(self, name: str, data: Shared) -> int:
            return KERNELS[name](data.fields) if name in KERNELS else compiled.call(name, data)

    library.load_kernels = InNumpy
    try:
        yield
    finally:
        library.load_kernels = load


def sweep_ordinates(sweep: Fields) -> int:
    """Follow light along the directions of one side, slice after slice: I = I_0 + (S - I_0) (1 - exp(-tau))."""
    n, axis, sign, gather = sweep["cells"], sweep["axis"], sweep["sign"], sweep["gather"]
    steps, kinds, emit, beams = sweep["steps"], sweep["kinds"], sweep["emit"], sweep["beams"]
    sums = sweep["sums"]
    field, swept, leaving, within = (
        np.moveaxis(values, 1 + axis, 0) for values in (sweep["field"], sums, sweep["leaving"], sweep["within"])
    )
    # Light that leaves the previous slice, with a border of what enters.
    passing = np.zeros((len(steps), n + 2, n + 2), np.float32)
    if sweep["entering"] is not None:
        passing[:] = sweep["entering"][:, None, None]
    for k in range(n)[::sign]:
        arriving = np.stack(
            [previous[1 - b : 1 - b + n, 1 - c : 1 - c + n] for previous, (b, c) in zip(passing, steps)]
        )
        if sweep["links"] is not None:
            arriving *= sweep["links"][k]
        parts = field[k] if beams is None else [*field[k][:4], np.moveaxis(beams, 1 + axis, 0)[k]]
        source = sum(weight[:, None, None] * part for weight, part in zip(emit.T, parts))
        rise = source - arriving
        passing[:, 1:-1, 1:-1] = arriving + rise * leaving[k][kinds]
        mean = arriving + rise * within[k][kinds]
        swept[k] = mean if gather is None else swept[k] + np.einsum("dn,dbc->nbc", gather, mean)
    return len(steps)


def sweep_radiance(sweep: Fields) -> int:
    """Follow light along directions that rise most along the first axis, once the cells are turned."""
    (f, g), shape = sweep["slopes"].T[:, :, None, None].astype(float), tuple(sweep["shape"])
    flips = tuple(slice(None, None, int(sign)) for sign in sweep["signs"])

    def turned(values: np.ndarray) -> np.ndarray:
        strides = np.array([*sweep["strides"], 1]) * values.itemsize
        return np.lib.stride_tricks.as_strided(values.reshape(-1), shape, strides)[flips]

    cells = [
        np.stack([turned(kind) for kind in sweep[name]])[sweep["kinds"]]
        for name in ("passed", "mean", "given", "added")
    ]
    fluence = [turned(values) for values in sweep["fluence"]]
    light = np.zeros((len(sweep["slopes"]), *shape[1:]))
    for k in range(shape[0]):
        passed, mean, given, added = (values[:, k] for values in cells)
        moved = np.pad(light, [(0, 0), (1, 0), (1, 0)])
        moved = moved[:, 1:] * (1.0 - f) + moved[:, :-1] * f
        moved = moved[:, :, 1:] * (1.0 - g) + moved[:, :, :-1] * g
        light = moved * passed + given
        for values, weight in zip(fluence, sweep["weights"].T):
            values[k] += np.tensordot(weight, moved * mean + added, 1)
    return len(light)


def sweep_ahead(sweep: Fields) -> int:
    """Follow parallel rays through slices: I = S + (I_0 - S) exp(-a tau) over each half of a slice."""
    shape = count, rows, columns = sweep["shape"]
    strides = sweep["strides"] * sweep["extinction"].itemsize

    def slices(values: np.ndarray) -> list[np.ndarray]:
        return [np.lib.stride_tricks.as_strided(one, shape, strides) for one in values.reshape(-1, sweep["cells"])]

    media, found = [*slices(sweep["extinction"]), *slices(sweep["light"])], slices(sweep["ahead"])
    light, clear = sweep["rays"][:-1].reshape(sweep["sources"], sweep["scales"], *sweep["size"]), sweep["rays"][-1]
    for k in range(count)[:: -1 if sweep["sign"] > 0 else 1]:
        (f, g), (i, j) = sweep["fractions"][k], sweep["starts"][k]
        here = (..., slice(i, i + rows + 1), slice(j, j + columns + 1))
        # Cells at rays that lie before them, 0 outside.
        padded = np.stack([np.pad(values[k], 1) for values in media])
        across = (1 - f) * padded[:, 1:] + f * padded[:, :-1]
        dense, *sources = (1 - g) * across[..., 1:] + g * across[..., :-1]
        passed = np.exp(-sweep["scale"][:, None, None] * np.float32(sweep["half_step"]) * dense)
        source = np.array(sources)[:, None]
        middle = (light[here] - source) * passed + source
        light[here] = (middle - source) * passed + source
        halfway = clear[here] * passed[0]
        clear[here] = halfway * passed[0]
        for to, values in zip(found, [*middle.reshape(-1, rows + 1, columns + 1), halfway]):
            between = (1 - f) * values[:-1] + f * values[1:]
            to[k] = (1 - g) * between[:, :-1] + g * between[:, 1:]
    return count


def krige(kriging: Fields) -> int:
    """The mean plus K^-1 c times what the nearest six known values differ from it."""
    steps, squares, mean = kriging["offset"][:, :3], kriging["offset"][:, 3], kriging["mean"]
    for found, cell in zip(kriging["found"], kriging["cell"]):
        numbers = kriging["numbers"].reshape(-1)[cell + kriging["step"]]
        [near] = np.nonzero(numbers >= 0)
        near = near[:6]
        between = ((steps[near, None] - steps[near]) ** 2).sum(axis=2)
        covariance = kriging["covariance"][between] + kriging["noise"] * np.eye(len(near))
        weights = np.linalg.solve(covariance.astype(float), kriging["covariance"][squares[near]].astype(float))
        found[:] = mean + weights @ (kriging["known"][numbers[near]] - mean)
    return len(kriging["cell"])


def fill_lattice(part: Fields) -> int:
    """The logarithm of a density, and what a depth lets pass, interpolated and rounded to 65536 steps."""
    density, depth, visibility = (
        refined(part[name].fields) if name in part else None for name in ("density", "depth", "visibility")
    )
    if density is not None:
        feature = np.log(np.float32(1.0) + np.float32(part["density_scale"]) * density)
        part["packed"][...] = np.rint(np.minimum(feature * np.float32(1.0 / part["density_step"]), 65535.0))
    if depth is not None:
        passed, least = np.exp(np.float32(-part["depth_scale"]) * depth), np.float32(part["least_visible"])
        if visibility is not None:
            passed *= visibility * (np.float32(1.0) - least) + least
        part["packed"][...] = np.rint(passed * np.float32(65535.0))
    return 0


def correct_light(light: Fields) -> int:
    """Add fluence and its diffusion to a field, and limit both."""
    field = light["field"]
    if light["fluence"] is not None:
        field[0] += light["fluence"]
        spacing = np.float32(1.0 / light["cells"])
        for axis in range(3):
            field[1 + axis] -= light["diffusion"] * np.gradient(light["fluence"], spacing, axis=axis)
    if light["limited"]:
        np.maximum(field[0], 0.0, out=field[0])
        size = np.sqrt((field[1:4] ** 2).sum(axis=0)) * np.float32(light["most_flux"])
        field[1:4] *= np.minimum(field[0] / np.maximum(size, np.float32(1e-30)), 1.0)
    return light["cells"]


def refine(cells: Fields) -> int:
    """Cells half as large, linear between the centres of the large ones."""
    values = cells["coarse"]
    for axis in range(3):
        v = np.moveaxis(np.pad(values, [(int(a == axis),) * 2 for a in range(3)], mode="edge"), axis, 0)
        halves = np.stack([0.25 * v[:-2] + 0.75 * v[1:-1], 0.75 * v[1:-1] + 0.25 * v[2:]], axis=1)
        values = np.moveaxis(halves.reshape(-1, *v.shape[1:]), 0, axis)
    cells["fine"][...] = values
    return len(cells["coarse"])


def refined(grid: Fields) -> np.ndarray:
    """A grid interpolated at fine cells."""
    values = grid["values"]
    for axis, (below, fraction) in enumerate(zip(grid["below"], grid["fraction"])):
        low, high = values.take(below, axis), values.take(below + 1, axis)
        values = low + (high - low) * fraction.reshape([-1 if a == axis else 1 for a in range(3)])
    return values


KERNELS: dict[str, Callable[[Fields], int]] = {
    "correct_light": correct_light,
    "fill_lattice": fill_lattice,
    "refine": refine,
    "sweep_ahead": sweep_ahead,
    "krige": krige,
    "sweep_ordinates": sweep_ordinates,
    "sweep_radiance": sweep_radiance,
}


def open_depths(depths: OpenDepths, positions: np.ndarray) -> np.ndarray:
    """As calling an OpenDepths."""
    at = positions.astype(np.float32)
    return np.stack([_towards(depths, at, k) for k in range(len(DIRECTIONS))], axis=1)


def _towards(open_: OpenDepths, positions: np.ndarray, number: int) -> np.ndarray:
    """Depths (N,) in one direction."""
    towards, depths = DIRECTIONS[number].astype(np.float32), np.zeros(len(positions), np.float32)
    for middle, length, level in zip(MIDDLES, LENGTHS, LEVELS):
        density = open_.levels[level]
        cells = np.floor((positions + middle * towards + np.float32(0.5)) * np.float32(len(density))).astype(int)
        inside = ((cells >= 0) & (cells < len(density))).all(axis=1)
        depths[inside] += length * density[tuple(cells[inside].T)]
    ends = positions + REACH * towards
    inside = (np.abs(ends) < 0.5).all(axis=1)
    depths[inside] += _interpolated(open_.lattice[number], ends[inside])
    return depths


def _interpolated(values: np.ndarray, positions: np.ndarray) -> np.ndarray:
    """Trilinear values (N,) of a lattice (n + 2, n + 2, n + 2) at positions (N, 3) in the cube."""
    index = (positions + np.float32(0.5)) * np.float32(len(values) - 2) + np.float32(0.5)
    cell = index.astype(int)
    i, j, k = cell.T
    x, y, z = (index - cell).T
    rows = [(1 - z) * values[i + a, j + b, k] + z * values[i + a, j + b, k + 1] for a in (0, 1) for b in (0, 1)]
    return (1 - x) * ((1 - y) * rows[0] + y * rows[1]) + x * ((1 - y) * rows[2] + y * rows[3])
