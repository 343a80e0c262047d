# SPDX-License-Identifier: GPL-3.0-or-later
"""A sun with an angular diameter, as parallel lights."""

import math

import numpy as np
from numpy.typing import ArrayLike

from .description import Sun
from .errors import SceneError

# Angles in radians up to which a sun becomes one direction, a ring of four, or seven; beyond, nineteen. The real sun's
# angular diameter is about half a degree.
ONE, FOUR, SEVEN = (math.radians(degrees) for degrees in (2.0, 12.0, 40.0))
# Number of directions, their distance from the axis in radii of a disc of equal area, and the fraction of the
# irradiance that each has.
RINGS = {
    FOUR: [(4, math.sqrt(1.0 / 2.0), 1.0 / 4.0)],
    SEVEN: [(1, 0.0, 1.0 / 4.0), (6, math.sqrt(2.0 / 3.0), 1.0 / 8.0)],
    math.pi: [(1, 0.0, 1.0 / 19.0), (6, 0.47, 1.0 / 19.0), (12, 0.8253, 1.0 / 19.0)],
}
# Angle in radians beyond which multiple scattering is predicted for each direction, because the directions differ much.
WIDEST_JOINED = math.radians(120.0)
# Groups of the nineteen directions that multiple scattering takes as one sun each: the middle, and six sectors.
SECTORS = [[0], *([1 + k, 7 + 2 * k, 8 + 2 * k] for k in range(6))]


def soft_sun(direction: ArrayLike, irradiance: ArrayLike, angle: float, name: str = "sun") -> list[Sun]:
    """The parallel lights that represent a disc of uniform radiance.

    direction: (3,) towards its middle. irradiance: W/m^2, scalar or RGB, the sum over all suns, each on a surface that
    faces it. angle: angular diameter in radians, 0 to pi.

    Equal areas of a disc are equal solid angles. One, four or seven directions, which integrate polynomials up to
    degree 1, 3 and 5 over a disc (Stroud 1971, S2), or nineteen of equal area. They are `part_of` the whole sun, of
    sectors of it beyond 40 degrees, and of nothing beyond 120. Raises SceneError as Sun does, and for angles out of
    range.
    """
    if not 0.0 <= angle <= math.pi + 1e-6:
        raise SceneError(f"{name}: angle must lie in [0, pi]")
    if angle <= ONE:
        return [Sun(np.asarray(direction), np.asarray(irradiance), name)]
    frame, directions, fractions = _frame(Sun(np.asarray(direction), name=name).direction), [], []
    for count, radius, fraction in next(rings for largest, rings in RINGS.items() if min(angle, math.pi) <= largest):
        for turn in (np.arange(count) + 0.5) * (2.0 * math.pi / count):
            cosine = 1.0 - radius**2 * (1.0 - math.cos(angle / 2.0))
            sine = math.sqrt(1.0 - cosine**2)
            directions.append(frame @ np.array([sine * math.cos(turn), sine * math.sin(turn), cosine]))
            fractions.append(fraction)
    suns = [Sun(towards, fraction * np.asarray(irradiance), name) for towards, fraction in zip(directions, fractions)]
    if angle > WIDEST_JOINED:
        return suns
    for sector in [range(len(suns))] if angle <= SEVEN else SECTORS:
        weights = np.array([fractions[n] for n in sector]) / sum(fractions[n] for n in sector)
        towards = np.array([directions[n] for n in sector])
        joined = Sun(weights @ towards, np.sum([suns[n].irradiance for n in sector], axis=0), name, (towards, weights))
        for n in sector:
            suns[n].part_of = joined
    return suns


def _frame(axis: np.ndarray) -> np.ndarray:
    """Orthonormal columns (3, 3) of which the last is a unit vector (3,)."""
    # Away from the coordinate axis that is nearest to it.
    x = np.cross(np.eye(3)[np.abs(axis).argmin()], axis)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(axis, x), axis], axis=1)
