# SPDX-License-Identifier: GPL-3.0-or-later
"""Light from all directions, represented by a few."""

import numpy as np

from ...inference.scene import Sun
from ..nodes.sockets import Unsupported

ROWS = 128
GOLDEN = (1.0 + 5.0**0.5) / 2.0
TETRAHEDRON = np.array([[1.0, 1.0, 1.0], [-1.0, -1.0, 1.0], [-1.0, 1.0, -1.0], [1.0, -1.0, -1.0]])
# Edge of the boxes in which directions of light are merged, radians.
COARSE = 0.05
LUMA = np.array([0.2126, 0.7152, 0.0722])


class Sphere:
    """Directions covering the sphere, at which a World's nodes are evaluated.

    directions: float64 (n, 3) unit vectors. solid_angle: (n,), of each; their sum is 4 pi. images: whether environment
    images may be read, which takes time.
    """

    fills_its_bounds = False
    # Volumes scatter this light; cameras do not see it.
    visible_to_camera = False

    def __init__(self, rows: int = ROWS, images: bool = True):
        self.images = images
        columns = 2 * rows
        edges = np.sin(np.linspace(-0.5, 0.5, rows + 1) * np.pi)
        z = np.repeat(0.5 * (edges[1:] + edges[:-1]), columns)
        turn = np.tile((np.arange(columns) + 0.5) * (2.0 * np.pi / columns), rows)
        flat = np.sqrt(1.0 - z * z)
        self.directions = np.stack([flat * np.cos(turn), flat * np.sin(turn), z], axis=1)
        self.solid_angle = np.repeat(np.diff(edges), columns) * (2.0 * np.pi / columns)

    def coordinates(self, kind: str, node) -> np.ndarray:
        """The directions: a World's coordinates of every kind."""
        return self.directions

    def attribute(self, name: str, node):
        """Raises Unsupported: a World has no attributes."""
        raise Unsupported(f'node "{node.name}" reads an attribute, which a World does not have')


def quadrature(sphere: Sphere, radiance: np.ndarray, count: int, name: str = "sun") -> list[Sun]:
    """Up to `count` suns whose irradiances sum to the light's fluence, each with the angular extent of its cell.

    radiance: (n, 3) at the sphere's directions.

    The sphere is divided around the vertices of a regular solid, which integrate uniform light exactly to second (4),
    third (6) or fifth degree (12 or more). The cell with the largest variance is then split until there are enough (as
    Viriyothai and Debevec's variance minimization, 2009). A cell's direction is the mean of its light, so bright spots
    are met.
    """
    light = radiance * sphere.solid_angle[:, None]
    power = light @ LUMA
    vertices = next(
        solid
        for solid in (_icosahedron(), _octahedron(), TETRAHEDRON, TETRAHEDRON[:2] * [1, 1, 0], TETRAHEDRON[:1])
        if len(solid) <= count
    )
    nearest = (sphere.directions @ vertices.T).argmax(axis=1)
    cells = [np.flatnonzero((nearest == n) & (power > 0.0)) for n in range(len(vertices))]
    cells = [cell for cell in cells if len(cell)]
    while len(cells) < count:
        spreads = [_spread(sphere.directions[cell], power[cell])[0] for cell in cells]
        widest = int(np.argmax(spreads))
        halves = _split(sphere.directions, power, cells[widest])
        if halves is None:
            break
        cells[widest : widest + 1] = halves
    return [
        Sun(
            _mean(sphere.directions[cell], power[cell]),
            light[cell].sum(axis=0),
            name,
            _coarsened(sphere.directions[cell], power[cell]),
        )
        for cell in cells
    ]


def _coarsened(directions, power):
    """The light of directions (n, 3) merged: unit vectors (K, 3) and shares of its power (K,), as `Sun.spread`."""
    # Boxes in space, so that each holds neighbouring directions.
    boxes, box = np.unique(np.floor(directions / COARSE).astype(int), axis=0, return_inverse=True)
    box = box.reshape(-1)
    share = np.bincount(box, power, len(boxes))
    mean = np.stack([np.bincount(box, power * axis, len(boxes)) for axis in directions.T], axis=1)
    return mean / np.linalg.norm(mean, axis=1, keepdims=True), share / share.sum()


def _mean(directions, power):
    mean = power @ directions
    length = np.linalg.norm(mean)
    # A cell of uniform light has no mean direction: use the zenith.
    return mean / length if length > 1e-6 * power.sum() else np.array([0.0, 0.0, 1.0])


def _spread(directions, power):
    """Power times variance of the directions, and their principal axis."""
    off = directions - (power @ directions) / power.sum()
    values, axes = np.linalg.eigh((off * power[:, None]).T @ off)
    return values.sum(), axes[:, -1]


def _split(directions, power, cell):
    if len(cell) < 2:
        return None
    along = directions[cell] @ _spread(directions[cell], power[cell])[1]
    upper = along > (power[cell] @ along) / power[cell].sum()
    halves = cell[upper], cell[~upper]
    return halves if len(halves[0]) and len(halves[1]) else None


def _octahedron():
    # Rotated so that no face looks at the horizon.
    turn = np.array([[2.0, -2.0, 1.0], [1.0, 2.0, 2.0], [2.0, 1.0, -2.0]]) / 3.0
    return np.concatenate([turn, -turn])


def _icosahedron():
    half = np.array([[0.0, 1.0, GOLDEN], [0.0, -1.0, GOLDEN]])
    corners = np.concatenate([half, -half])
    corners = np.concatenate([np.roll(corners, shift, axis=1) for shift in range(3)])
    # Rotated so that one vertex is the zenith and none is on the horizon: half of uniform light comes from above.
    y, z = np.array([[0.0, GOLDEN, -1.0], [0.0, 1.0, GOLDEN]])
    return corners @ np.stack([[np.linalg.norm(z), 0.0, 0.0], y, z], axis=1) / (z @ z)
