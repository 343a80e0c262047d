# SPDX-License-Identifier: GPL-3.0-or-later
"""A case, how it is violated, and what must hold for every picture."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from inference import SceneError


@dataclass(frozen=True)
class Case:
    """One extreme scene or stage.

    against: where the truth comes from. measure: () -> Outcome. bounds: the largest allowed value of each of its
    quantities. quick: whether it is part of the quick run.
    """

    group: str
    name: str
    against: str
    measure: Callable
    bounds: dict[str, float]
    quick: bool = False


@dataclass
class Outcome:
    """errors: by quantity. picture: float (H, W, 3) linear, or None."""

    errors: dict[str, float] = field(default_factory=dict)
    picture: np.ndarray | None = None


def violations(case: Case, outcome: Outcome):
    """Sentences on quantities that are missing or beyond their bounds; NaN is beyond every bound."""
    found = [(quantity, outcome.errors.get(quantity, np.nan), bound) for quantity, bound in case.bounds.items()]
    return [
        f"{case.group}, {case.name}: {quantity} is {error:.3g}, at most {bound:g} is allowed"
        for quantity, error, bound in found
        if not error <= bound
    ]


def unsound(layer) -> float:
    """Number of invalid pixels: not finite, negative, or of an alpha outside 0 to 1."""
    parts = np.concatenate([layer.rgb, layer.single, layer.multiple], axis=2)
    bad = ~np.isfinite(parts).all(axis=2) | (parts < 0.0).any(axis=2)
    bad |= ~((layer.alpha >= 0.0) & (layer.alpha <= 1.0)) | ~np.isfinite(layer.uncertainty)
    bad |= ~np.isfinite(layer.depth) & (layer.alpha > 0.0)
    return float(bad.sum())


def refused(name: str, make, words: str, quick: bool = True) -> Case:
    """A scene that must be refused with a message that contains `words`."""

    def measure():
        try:
            make()
        except SceneError as error:
            return Outcome({"accepted": float(words not in str(error))})
        return Outcome({"accepted": 1.0})

    return Case("refused", name, f"message: … {words} …", measure, {"accepted": 0.0}, quick)
