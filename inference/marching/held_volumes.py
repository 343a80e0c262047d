# SPDX-License-Identifier: GPL-3.0-or-later
"""Which of many volumes each of many samples is in: few of them, by number, instead of a column for each volume."""

from collections.abc import Sequence

import numpy as np


def held_volumes(inside: np.ndarray, numbers: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """Numbers int32 (M, K) of the volumes that each sample is in, ascending, then -1; and their columns int (M, K).

    inside: bool (M, N), of volumes or groups of these. numbers: of them, ascending. Columns of a -1 are anything.
    """
    most = max(int(np.count_nonzero(inside, axis=1).max(initial=1)), 1)
    # Those that hold a sample come first.
    columns = inside.argmax(axis=1)[:, None] if most == 1 else np.argsort(~inside, axis=1, kind="stable")[:, :most]
    held = np.take_along_axis(inside, columns, axis=1)
    return np.where(held, np.asarray(numbers, np.int32)[columns], np.int32(-1)), columns


def in_columns(values: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Of values (M, N, ...), those (M, K, ...) in some columns (M, K) of each sample."""
    return values if values.shape[1] == 1 else values[np.arange(len(values))[:, None], columns]


def side_by_side(parts: Sequence[np.ndarray], empty: float = 0.0) -> np.ndarray:
    """Arrays (M, K, ...) one after another, with as many columns as the widest one has."""
    widest = max(part.shape[1] for part in parts)
    wide = [(0, 0)] * (parts[0].ndim - 2)
    return np.concatenate(
        [np.pad(part, [(0, 0), (0, widest - part.shape[1]), *wide], constant_values=empty) for part in parts]
    )


def places_among(members: Sequence[int] | np.ndarray, held: np.ndarray) -> np.ndarray:
    """Place of each volume that is held, by number or -1, among some members, by number; -1 for others."""
    # The last place is that of -1.
    places = np.full(max(int(np.max(members, initial=-1)), int(held.max(initial=-1))) + 2, -1)
    places[np.asarray(members, int)] = np.arange(len(members))
    return places[held]
