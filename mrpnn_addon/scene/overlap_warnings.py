"""What is approximated where volumes overlap, or light each other, in words."""

from typing import List, Tuple

import numpy as np

from ...inference.plan.overlap import overlapping
from ...inference.scene import Medium, Volume

# Differences of albedo and mean cosine below these are not worth a word.
ALBEDO, COSINE = 0.02, 0.05


def overlap_warnings(pairs: List[Tuple[Volume, Medium]]) -> List[str]:
    """Of volumes whose bounds meet, those that the network sees as one medium of means, or each as if it were alone; and of
    fires, what they do not light.
    """
    groups, apart = overlapping([volume for volume, _ in pairs])
    found = []
    for group in groups:
        media = [pairs[v][1] for v in group]
        spread = np.ptp([medium.albedo for medium in media], axis=0).max()
        if spread > ALBEDO or np.ptp([medium.anisotropy for medium in media]) > COSINE:
            found.append(f"volumes {_names(pairs, group)} overlap; light that is scattered several times is predicted in "
                         "one medium with their mean colour and mean anisotropy")
    if apart:
        more = f", and {len(apart) - 1} more pairs" if len(apart) > 1 else ""
        found.append(f"volumes {_names(pairs, apart[0])} overlap and are of very different size{more}; light that is "
                     "scattered several times is predicted as if each were alone")
    return found + _unlit(pairs, groups)


def _unlit(pairs, groups) -> List[str]:
    """Of volumes that shine, that they do not light one that lies apart."""
    for group in groups:
        shining = [v for v in group if pairs[v][0].emission is not None]
        others = [v for v, (_, medium) in enumerate(pairs) if v not in group and medium.albedo.any()]
        if shining and others:
            return [f"light that volume \"{pairs[shining[0]][0].name}\" emits does not light volume "
                    f"\"{pairs[others[0]][0].name}\", whose grid does not meet its own"]
    return []


def _names(pairs, numbers) -> str:
    first, second, *others = (f"\"{pairs[v][0].name}\"" for v in numbers)
    return f"{first} and {second}" + (f" and {len(others)} more" if others else "")
