# SPDX-License-Identifier: GPL-3.0-or-later
"""Rows in which every two values of different dimensions meet."""

from itertools import combinations

Row = dict[str, str]
Pair = tuple[tuple[str, str], tuple[str, str]]


def pairs_of(row: Row) -> set[Pair]:
    """Every two (dimension, value) of a row, in the row's order."""
    return set(combinations(row.items(), 2))


def covering_rows(dimensions: dict[str, list[str]]) -> list[Row]:
    """Few rows, one value of each dimension in each, that hold every pair; the same ones for the same dimensions.

    Greedy: a row begins with a pair that is still missing, and each other dimension takes the value that meets most of
    the missing pairs, the first one among equals.
    """
    missing = dict.fromkeys(
        ((a, x), (b, y)) for a, b in combinations(dimensions, 2) for x in dimensions[a] for y in dimensions[b]
    )
    order = {name: number for number, name in enumerate(dimensions)}
    rows: list[Row] = []
    while missing:
        chosen = dict(next(iter(missing)))
        for name in sorted(dimensions, key=lambda name: -len(dimensions[name])):
            if name not in chosen:

                def worth(value: str, name: str = name) -> int:
                    met = [sorted([(name, value), other], key=lambda one: order[one[0]]) for other in chosen.items()]
                    return sum(tuple(pair) in missing for pair in met)

                chosen[name] = max(dimensions[name], key=worth)
        row = {name: chosen[name] for name in dimensions}
        for pair in pairs_of(row):
            missing.pop(pair, None)
        rows.append(row)
    return rows
