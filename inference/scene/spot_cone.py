# SPDX-License-Identifier: GPL-3.0-or-later
"""Cones into which spot lights shine, and the fraction of a disk's light that they let pass."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..numerics.quadrature import legendre_nodes
from ..numerics.small_matmul import inverse, product

# Nodes of a cap of directions, in rings: their heights below its top over its height, and cosines of the azimuths on
# each; and the spacing of nodes, over the extent of the cap. The kernel holds these, too.
CAP_RINGS = tuple(0.5 + 0.5 * legendre_nodes(2)[0])
CAP_TURNS = tuple(np.cos((np.arange(3) + 0.5) * np.pi / 3.0))
NODES_APART = 0.5
# Width, as a cosine, of an edge that counts as sharp.
SHARP = 1e-9
# Directions on the edge of an elliptic cone, and what lies between two of them, as a cosine.
EDGE_NODES, EDGE_ERROR = 256, 1e-4


@dataclass(frozen=True)
class SpotCone:
    """A cone of light, which may be elliptic.

    axis: (3,) unit vector along which the light travels. cosine: of half the cone's angle. blend, frame: as in
    SpotLight; cosine and blend hold in the frame.
    """

    axis: np.ndarray
    cosine: float
    blend: float = 0.0
    frame: np.ndarray | None = None

    @property
    def width(self) -> float:
        """Width of the edge, over which light fades, as a difference of cosines."""
        return max((1.0 - self.cosine) * self.blend, SHARP)

    @property
    def stretch(self) -> float:
        """Determinant of the frame, without its sign."""
        return 1.0 if self.frame is None else float(abs(np.linalg.det(self.frame)))

    @cached_property
    def bound(self) -> float:
        """Cosine of half the angle of the round cone around the axis that holds this one."""
        if self.frame is None:
            return self.cosine
        turns = np.linspace(0.0, 2.0 * np.pi, EDGE_NODES, endpoint=False)
        sine = np.sqrt(max(1.0 - self.cosine**2, 0.0))
        edge = np.stack([sine * np.cos(turns), sine * np.sin(turns), np.full(EDGE_NODES, self.cosine)])
        edge = inverse(self.frame) @ edge
        cosines = self.axis @ (edge / np.linalg.norm(edge, axis=0))
        return float(np.clip(cosines.min() - EDGE_ERROR, -1.0, 1.0))

    def around(self, axis: np.ndarray) -> "SpotCone":
        """The round cone that holds this one, around an axis (3,) that may be this one's in another frame."""
        return SpotCone(axis, self.bound, self.blend if self.frame is None else 0.0)

    def passed(self, directions: np.ndarray, tangents: np.ndarray) -> np.ndarray:
        """Fraction (N,) of the light of disks that the cone lets pass.

        directions: (N, 3), unit vectors from the middles of disks that face a point to that point. tangents: (N,),
        radii of the disks over their distances.
        """
        level = product(directions, self.axis)
        if self.frame is not None:
            seen = product(directions, self.frame.T)
            length = np.linalg.norm(seen, axis=1)
            # A disk becomes an ellipse in the frame, which a disk of the same solid angle represents.
            level, tangents = seen[:, 2] / length, tangents * np.sqrt(self.stretch / length**3)
        level = np.clip(level, -1.0, 1.0)
        tilt = np.sqrt(1.0 - level * level)
        cap = 1.0 / np.hypot(1.0, tangents)
        sine = tangents * cap
        # The mean over the cap of directions in which the disk is seen; where the cone is narrower, over the cone.
        cone = max(1.0 - self.cosine - 0.5 * self.width, 0.0)
        narrow = cone < 1.0 - cap
        height, edge = np.where(narrow, cone, 1.0 - cap), np.where(narrow, cap, self.cosine + 0.5 * self.width)
        extent = np.where(narrow, np.sqrt(cone * (2.0 - cone)), sine)
        # The edge is at least as wide as nodes are apart.
        apart = NODES_APART * np.maximum(extent * tilt, height * level)
        width = np.maximum(np.where(narrow, SHARP, self.width), apart)
        passed = np.zeros(len(directions))
        for ring in CAP_RINGS:
            top = 1.0 - ring * height
            aside = np.sqrt(np.maximum(1.0 - top * top, 0.0)) * tilt
            for turn in CAP_TURNS:
                inside = np.clip((top * level + aside * turn - edge) / width + 0.5, 0.0, 1.0)
                passed += inside * inside * (3.0 - 2.0 * inside)
        passed *= np.where(narrow, cone / np.maximum(1.0 - cap, 1e-30), 1.0) / (len(CAP_RINGS) * len(CAP_TURNS))
        most = np.where(level < cap, level * cap + tilt * sine, 1.0)
        least = np.where(level > -cap, level * cap - tilt * sine, -1.0)
        return np.where(most <= self.cosine, 0.0, np.where(least >= self.cosine + self.width, 1.0, passed))

    def turned(self, directions: np.ndarray) -> np.ndarray:
        """The unit vectors (N, 3) within the round cone that holds this one that are nearest to `directions`."""
        level = product(directions, self.axis)[:, None]
        aside = directions - level * self.axis
        tilt = np.maximum(np.linalg.norm(aside, axis=1)[:, None], 1e-30)
        edge = self.bound * self.axis + np.sqrt(1.0 - self.bound**2) * (aside / tilt)
        return np.where(level < self.bound, edge, directions)

    def between(
        self, centre: np.ndarray, radius: float, origins: np.ndarray, directions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Distances (N,) between which a sphere may light rays of origins and unit directions (N, 3).

        They lie within the round cone that holds all of the sphere's light; inf and -inf for rays that miss it.
        """
        square = self.bound**2
        away = origins - (centre - self.axis * (radius / max(np.sqrt(1.0 - square), SHARP)))
        level, rise, along = product(away, self.axis), product(directions, self.axis), (away * directions).sum(axis=1)
        # The ends solve: the square of the height above the apex is that of the cosine times the distance.
        a = rise * rise - square
        a = np.where(np.abs(a) < 1e-12, 1e-12, a)
        b, c = level * rise - square * along, level * level - square * (away * away).sum(axis=1)
        root = np.sqrt(np.maximum(b * b - a * c, 0.0))
        ends = (-b - root) / a, (-b + root) / a
        first, last = np.minimum(*ends), np.maximum(*ends)
        # Steep rays begin or end within the cone; others cross it, or the opposite cone.
        upwards, downwards = (a > 0.0) & (rise > 0.0), (a > 0.0) & (rise <= 0.0)
        begin = np.where(upwards, last, np.where(downwards, -np.inf, first))
        end = np.where(downwards, first, np.where(upwards, np.inf, last))
        missed = (a <= 0.0) & ((b * b < a * c) | (level + 0.5 * (first + last) * rise < 0.0))
        return np.where(missed, np.inf, begin), np.where(missed, -np.inf, end)
