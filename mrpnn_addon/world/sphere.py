# SPDX-License-Identifier: GPL-3.0-or-later
"""The directions at which a World's nodes are evaluated."""

from typing import Any

import numpy as np

from ...inference.scene.environment import pixel_directions
from ..nodes.sockets import Unsupported

ROWS = 128


class Sphere:
    """Directions covering the sphere, at which a World's nodes are evaluated: the pixels of an `Environment`.

    directions: float64 (2 rows^2, 3) unit vectors. images: whether environment images are read, which takes
    time; otherwise they are white.
    """

    fills_its_bounds = False
    # Volumes scatter this light; cameras do not see it.
    visible_to_camera = False

    def __init__(self, rows: int = ROWS, images: bool = True) -> None:
        self.rows, self.images = rows, images
        self.directions = pixel_directions(rows).reshape(-1, 3)

    def image(self, radiance: np.ndarray) -> np.ndarray:
        """Radiance (n, 3) at the directions as an image (rows, 2 rows, 3)."""
        return radiance.reshape(self.rows, 2 * self.rows, 3)

    def coordinates(self, kind: str, node: Any) -> np.ndarray:
        """The directions: a World's coordinates of every kind."""
        return self.directions

    def attribute(self, name: str, node: Any) -> None:
        """Raises Unsupported: a World has no attributes."""
        raise Unsupported(f'node "{node.name}" reads an attribute, which a World does not have')
