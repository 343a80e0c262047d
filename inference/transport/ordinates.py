# SPDX-License-Identifier: GPL-3.0-or-later
"""The 26 directions of discrete ordinates: those between a cell and its neighbours, with Lebedev's weights."""

import numpy as np

# Solid angles of the directions to the neighbours across a face, an edge and a corner, over 4 pi.
WEIGHTS = 1.0 / 21.0, 4.0 / 105.0, 9.0 / 280.0


def _steps(axis: int) -> np.ndarray:
    """Steps int (D, 3) that rise along an axis and are 0 along those before it, nearest neighbours first."""
    steps = np.array(list(np.ndindex(3, 3, 3))) - 1
    steps = steps[(steps[:, axis] == 1) & (steps[:, :axis] == 0).all(axis=1)]
    return steps[np.argsort(np.abs(steps).sum(axis=1), kind="stable")]


def solid_angles(steps: np.ndarray) -> np.ndarray:
    """Solid angles (D,) of steps (D, 3), over 4 pi."""
    return np.array(WEIGHTS)[np.abs(steps).sum(axis=1) - 1]


#: Steps int (D, 3) of each axis; with their opposites, all 26 directions.
STEPS = [_steps(axis) for axis in range(3)]
#: Axis and sign of the sides that steps lead to, in the order in which light is followed.
SIDES = [(axis, sign) for axis in range(3) for sign in (1, -1)]
_ALL_STEPS = np.concatenate([sign * STEPS[axis] for axis, sign in SIDES])
#: Unit vectors (26, 3) towards the light of all steps, side by side, and their shares (26,) of the sphere.
ORDINATES = -_ALL_STEPS / np.sqrt((_ALL_STEPS**2).sum(axis=1))[:, None]
ORDINATE_WEIGHTS = solid_angles(_ALL_STEPS)
#: Where the directions of each side but the last end among them.
SIDE_ENDS = np.cumsum([len(STEPS[axis]) for axis, _ in SIDES])[:-1]
