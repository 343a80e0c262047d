# SPDX-License-Identifier: GPL-3.0-or-later
"""Warnings about approximations where volumes overlap or light each other."""

from collections.abc import Sequence

import numpy as np

from ...inference.plan.overlap import overlapping, share_light
from ...inference.scene import Medium, Volume

# Differences of mean cosine below this need no warning.
COSINE = 0.05


def overlap_warnings(pairs: list[tuple[Volume, Medium]]) -> list[str]:
    """Warnings about overlapping volumes that the network treats as one mean medium or each as if alone, and about
    emission that does not light other volumes.
    """
    groups, apart = overlapping(pairs)
    found = []
    for group in groups:
        media = [pairs[v][1] for v in group]
        if np.ptp([medium.anisotropy for medium in media]) > COSINE:
            found.append(
                f"volumes {_names(pairs, group)} overlap; multiple scattering uses their mean "
                "Anisotropy for all of them"
            )
    if apart:
        more = len(apart) - 1
        others = f", and {more} more pair{'s' * (more > 1)}" if more else ""
        found.append(
            f"volumes {_names(pairs, apart[0])} overlap and are of very different size{others}; multiple "
            "scattering is predicted as if each were alone"
        )
    return found + _unlit(pairs, groups)


def _unlit(pairs: list[tuple[Volume, Medium]], groups: list[list[int]]) -> list[str]:
    """A warning about a volume whose emission does not light a separate one."""
    for group in groups:
        emitting = [v for v in group if pairs[v][0].emission is not None]
        others = [
            v
            for v, (_, medium) in enumerate(pairs)
            if v not in group and medium.scatters and any(share_light(pairs[one][1], medium) for one in emitting)
        ]
        if emitting and others:
            return [
                f'light that volume "{pairs[emitting[0]][0].name}" emits does not light volume '
                f'"{pairs[others[0]][0].name}", whose grid does not overlap its own'
            ]
    return []


def _names(pairs: list[tuple[Volume, Medium]], numbers: Sequence[int]) -> str:
    first, *others = dict.fromkeys(f'"{pairs[v][0].name}"' for v in numbers)
    if not others:
        return f"{first}, {len(numbers)} times,"
    return f"{first} and {others[0]}" + (f" and {len(others) - 1} more" if others[1:] else "")
