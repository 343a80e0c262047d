# SPDX-License-Identifier: GPL-3.0-or-later
"""The protocol of lights: stages ask a light for what they need.

Lights belong to three families, by how their light reaches a volume. `Sun` and its descendants are distant, `Lamp` and
its descendants are local, and an `Environment` shines from everywhere. A new light is a descendant of one of these
three, or a `Light` that is made of several.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .description import Sun
    from .environment import Environment
    from .lamps import Lamp


class Light:
    """A light.

    name: for messages. receivers: names of the volumes and surfaces that it lights; None for all.
    """

    name: str
    receivers: frozenset[str] | None = None

    @property
    def strength(self) -> np.ndarray:
        """Irradiance, power or radiance, to which its light is proportional."""
        raise NotImplementedError

    @property
    def darkness(self) -> str:
        """Why it gives no light, for messages; "" if it does."""
        raise NotImplementedError

    def lights(self, name: str) -> bool:
        """Whether it lights the volume or surface of a name."""
        return self.receivers is None or name in self.receivers

    def fluence_at(self, points: np.ndarray) -> np.ndarray:
        """Fluence float64 (N, 3), W/m^2, at world points (N, 3), without shadows."""
        raise NotImplementedError

    def add_to(self, families: "Families") -> None:
        """Add this light, or the lights that it is made of, to its family."""
        raise NotImplementedError


@dataclass
class Families:
    """Lights by their families."""

    suns: "list[Sun]" = field(default_factory=list)
    lamps: "list[Lamp]" = field(default_factory=list)
    environments: "list[Environment]" = field(default_factory=list)

    @classmethod
    def of(cls, lights: Sequence[Light]) -> "Families":
        """The families of lights, in their order."""
        families = cls()
        for light in lights:
            light.add_to(families)
        return families
