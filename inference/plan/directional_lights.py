# SPDX-License-Identifier: GPL-3.0-or-later
"""Light from all directions, represented by a few parallel lights."""

import numpy as np

from ..numerics.small_matmul import product
from ..scene.description import Sun
from ..scene.environment import LUMA, Environment, pixel_solid_angles

GOLDEN = (1.0 + 5.0**0.5) / 2.0
# Edge of the boxes in which directions of light are merged, radians.
COARSE = 0.05
# Rows of images that are reduced, by whole factors, before they are divided among directions.
ROWS = 128


def directional_lights(environment: Environment, count: int) -> list[Sun]:
    """Up to `count` suns whose irradiances sum to an environment's fluence, each with the angular extent of its cell.

    count: at least 12. The sphere is divided around the vertices of an icosahedron, which integrate uniform light
    exactly to fifth degree. The cell with the largest variance is then split until there are enough (as Viriyothai and
    Debevec's variance minimization, 2009). A cell's direction is the mean of its light, so bright spots are met.
    """
    directions, light, name = *_reduced(environment), environment.name
    power = product(light, LUMA)
    vertices = _icosahedron()
    nearest = product(directions, vertices.T).argmax(axis=1)
    cells = [np.flatnonzero((nearest == n) & (power > 0.0)) for n in range(len(vertices))]
    cells = [cell for cell in cells if len(cell)]
    while len(cells) < count:
        spreads = [_spread(directions[cell], power[cell])[0] for cell in cells]
        widest = int(np.argmax(spreads))
        halves = _split(directions, power, cells[widest])
        if halves is None:
            break
        cells[widest : widest + 1] = halves
    return [
        Sun(
            _mean(directions[cell], power[cell]),
            light[cell].sum(axis=0),
            name,
            _coarsened(directions[cell], power[cell]),
        )
        for cell in cells
    ]


def _reduced(environment: Environment) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) in the world and the light (n, 3), W/m^2, that arrives from around each."""
    rows = len(environment.radiance)
    light = environment.radiance.astype(np.float64) * pixel_solid_angles(rows)[..., None]
    directions, block = environment.directions(), -(-rows // ROWS)
    if block > 1:
        for axis in (0, 1):
            starts = np.arange(0, light.shape[axis], block)
            light, directions = (np.add.reduceat(values, starts, axis=axis) for values in (light, directions))
        directions = directions / np.linalg.norm(directions, axis=-1, keepdims=True)
    return directions.reshape(-1, 3), light.reshape(-1, 3)


def _coarsened(directions: np.ndarray, power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The light of directions (n, 3) merged: unit vectors (K, 3) and shares of its power (K,), as `Sun.spread`."""
    # Boxes in space, so that each holds neighbouring directions.
    boxes, box = np.unique(np.floor(directions / COARSE).astype(int), axis=0, return_inverse=True)
    box = box.reshape(-1)
    box_power = np.bincount(box, power, len(boxes))
    mean = np.stack([np.bincount(box, power * axis, len(boxes)) for axis in directions.T], axis=1)
    return mean / np.linalg.norm(mean, axis=1, keepdims=True), box_power / box_power.sum()


def _mean(directions: np.ndarray, power: np.ndarray) -> np.ndarray:
    mean = power @ directions
    length = np.linalg.norm(mean)
    # A cell of uniform light has no mean direction: use the zenith.
    return mean / length if length > 1e-6 * power.sum() else np.array([0.0, 0.0, 1.0])


def _spread(directions: np.ndarray, power: np.ndarray) -> tuple[float, np.ndarray]:
    """Power times variance of the directions, and their principal axis."""
    off = directions - (power @ directions) / power.sum()
    values, axes = np.linalg.eigh((off * power[:, None]).T @ off)
    return values.sum(), axes[:, -1]


def _split(directions: np.ndarray, power: np.ndarray, cell: np.ndarray) -> tuple[np.ndarray, np.ndarray] | None:
    if len(cell) < 2:
        return None
    along = directions[cell] @ _spread(directions[cell], power[cell])[1]
    upper = along > (power[cell] @ along) / power[cell].sum()
    halves = cell[upper], cell[~upper]
    return halves if len(halves[0]) and len(halves[1]) else None


def _icosahedron() -> np.ndarray:
    half = np.array([[0.0, 1.0, GOLDEN], [0.0, -1.0, GOLDEN]])
    corners = np.concatenate([half, -half])
    corners = np.concatenate([np.roll(corners, shift, axis=1) for shift in range(3)])
    # Rotated so that one vertex is the zenith and none is on the horizon: half of uniform light comes from above.
    y, z = np.array([[0.0, GOLDEN, -1.0], [0.0, 1.0, GOLDEN]])
    return corners @ np.stack([[np.linalg.norm(z), 0.0, 0.0], y, z], axis=1) / (z @ z)
