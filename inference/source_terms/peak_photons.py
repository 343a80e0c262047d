# SPDX-License-Identifier: GPL-3.0-or-later
"""Light of a lamp that has scattered within the phase function's forward peak alone, by photons.

It spreads by small angles from where a lamp's unscattered light collides, out of a spot's cone for example, which no
few directions of a transport can tell. Photons start where that light scatters first, and fly from collision to
collision until one scatters by a wide angle or leaves the cells; the lengths of their flights through cells are the
fluence. Where few photons come, the fluence and the flux are smoothed: as little as makes them certain enough.
"""

from dataclasses import dataclass

import numpy as np

from ..kernels.library import call
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.spot_cone import SpotCone
from .forward_peak import ForwardPeak
from .held_cells import box_of

#: Photons of a lamp, and between two polls of cancellation.
PHOTONS, PHOTONS_PER_CALL = 100_000, 20_000
# Collisions of a photon, at most.
MOST_COLLISIONS = 500
# Of a sequence of low discrepancy (Roberts, "The Unreasonable Effectiveness of Quasirandom Sequences", 2018), by axis.
SPREAD = 1.0 / 1.2207440846057596 ** np.arange(1, 4)
# Sums of a cell: fluence, flux, and the squares of what photons add to the fluence.
SUMS = 5
# Relative variance of a cell's fluence from which on it is smoothed.
CERTAIN = 0.01
# By how much smoothing once lessens the variance of light that is seen along a line of cells.
LESS = 4.0
# Cells by which smoothing may move light.
SMOOTHED = 4


@dataclass(frozen=True)
class LampInCells:
    """A lamp among cells, with edges of length 1.

    depth: float32 (x, y, z), optical thickness of each cell's edge. light: float32 (x, y, z), means of its unscattered
    light. place: (3,), of the lamp. closed: uint8 (3, x, y, z), whether a surface parts a cell from the next along each
    axis, or None. albedo: of the medium. cone: of a spot, in which the light travels, or None. corner: (3,), number of
    the first cell in a larger grid, by which photons are the same wherever it is cut.
    """

    depth: np.ndarray
    light: np.ndarray
    place: np.ndarray
    closed: np.ndarray | None
    albedo: float
    cone: SpotCone | None = None
    corner: tuple[int, ...] = (0, 0, 0)


def peak_light(
    lamp: LampInCells,
    peak: ForwardPeak,
    cancel: CancelToken = NEVER,
    photons: int = PHOTONS,
) -> np.ndarray:
    """Fluence and flux, float32 (4, x, y, z), of a lamp's light that has scattered within the peak alone.

    photons: about as many. Those of a cell are the same whenever it is called, so that a small change of the light
    changes little. Raises Cancelled.
    """
    sums = np.zeros((*lamp.depth.shape, SUMS), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        scattered = np.nan_to_num(lamp.depth * lamp.light * np.float32(lamp.albedo), posinf=0.0).astype(np.float64)
    power = float(np.maximum(scattered, 0.0, out=scattered).sum()) / photons
    if peak.empty or not 0.0 < power < np.inf:
        return np.zeros((4, *lamp.depth.shape), np.float32)
    starts, numbers = _first_collisions(scattered / power, lamp.corner)
    for first in range(0, len(starts), PHOTONS_PER_CALL):
        cancel.check()
        span = slice(first, first + PHOTONS_PER_CALL)
        _follow(lamp, peak, starts[span], numbers[span], sums)
    light, box = np.zeros((SUMS - 1, *lamp.depth.shape), np.float32), (slice(None), *box_of(sums[..., 0], SMOOTHED))
    light[box] = _smoothed(np.ascontiguousarray(np.moveaxis(sums, -1, 0)[box]), lamp.closed is None)
    light *= np.float32(power)
    return light


def _first_collisions(counts: np.ndarray, corner: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Cells int64 (N,) of photons that scatter first, by flat number, and numbers (N,) of the photons.

    counts: (x, y, z), of photons that each cell is to have. corner: as of LampInCells. What is not whole is rounded up
    in a share of the cells that is evenly spread over them.
    """
    x, y, z = (first + along for first, along in zip(corner, np.ogrid[tuple(map(slice, counts.shape))]))
    whole = np.floor(counts + (x * SPREAD[0] + y * SPREAD[1] + z * SPREAD[2]) % 1.0).astype(np.int64).reshape(-1)
    starts = np.repeat(np.arange(counts.size), whole)
    index = np.arange(len(starts)) - np.repeat(np.cumsum(whole) - whole, whole)
    # Twelve bits for each of a cell's coordinates, and 24 for the photon.
    return starts, ((((x << 12) + y << 12) + z << 24).reshape(-1))[starts] + index


def _follow(lamp: LampInCells, peak: ForwardPeak, starts: np.ndarray, numbers: np.ndarray, sums: np.ndarray) -> None:
    """Add the flights of photons to sums (x, y, z, SUMS).

    starts: int64 (N,), cells where they scatter first, by flat number. numbers: int64 (N,), of the photons.
    """
    call(
        "follow_peak",
        shape=np.array(lamp.depth.shape),
        depth=np.ascontiguousarray(lamp.depth, np.float32),
        closed=None if lamp.closed is None else np.ascontiguousarray(lamp.closed, np.uint8),
        lamp=np.float64(lamp.place),
        axis=np.zeros(3) if lamp.cone is None else np.float64(lamp.cone.axis),
        cosine=-1.0 if lamp.cone is None else lamp.cone.bound,
        photons=len(starts),
        starts=starts,
        numbers=numbers,
        collisions=MOST_COLLISIONS,
        anisotropy=peak.anisotropy,
        reduced=peak.reduced,
        wide=peak.wide,
        albedo=lamp.albedo,
        sums=sums,
    )


def _smoothed(sums: np.ndarray, open_: bool) -> np.ndarray:
    """Fluence and flux (4, x, y, z) of sums (SUMS, x, y, z), smoothed where they are uncertain.

    open_: whether there are no surfaces, through which light must not be smoothed.
    """
    light = sums[: SUMS - 1]
    if not open_:
        return light.copy()
    mean, square = _blurred(sums[:1], 1)[0], _blurred(sums[SUMS - 1 :], 1)[0]
    variance = square / np.maximum(mean**2, np.float32(1e-30))
    smoothed, uncertain = np.zeros_like(light), light
    # What is uncertain in a cell is given to the cells around it, so that no light is lost or made.
    for number, less in enumerate((1.0, LESS)):
        trust = np.clip(np.float32(CERTAIN * less) / np.maximum(variance, np.float32(1e-30)), 0.0, 1.0)
        smoothed += trust * uncertain
        uncertain = _blurred((1.0 - trust) * uncertain, 2**number)
    return smoothed + uncertain


def _blurred(values: np.ndarray, step: int) -> np.ndarray:
    """Values (K, x, y, z) averaged with those of cells some steps away, with weights of 1, 2 and 1 along each axis."""
    for axis in (1, 2, 3):
        moved = np.moveaxis(np.pad(values, [(step * (a == axis),) * 2 for a in range(4)], mode="edge"), axis, 0)
        count = len(moved) - 2 * step
        sums = moved[:count] + moved[2 * step :]
        sums += 2.0 * moved[step : step + count]
        sums *= np.float32(0.25)
        values = np.moveaxis(sums, 0, axis)
    return values
