"""What is approximated where volumes overlap, in words."""

from typing import List, Tuple

import numpy as np

from ..inference.overlap import overlapping
from ..inference.scene import Medium, Volume

# Differences of albedo and mean cosine below these are not worth a word.
ALBEDO, COSINE = 0.02, 0.05


def overlap_warnings(pairs: List[Tuple[Volume, Medium]]) -> List[str]:
    """Of volumes whose bounds meet, those that the network sees as one medium of means, or each as if it were alone."""
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
    return found


def _names(pairs, numbers) -> str:
    first, second, *others = (f"\"{pairs[v][0].name}\"" for v in numbers)
    return f"{first} and {second}" + (f" and {len(others)} more" if others else "")
