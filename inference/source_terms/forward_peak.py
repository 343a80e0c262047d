# SPDX-License-Identifier: GPL-3.0-or-later
"""The forward peak of a phase function, and the rest of it, which scatters by wide angles.

Henyey and Greenstein's phase function p of mean cosine G is taken apart as delta scaling does (Wiscombe 1977): light
scatters by a wide angle with the distribution

    p_w = min((1 - G^2) p', p),

p' being that of mean cosine G' = G / (1 + G), and within the peak with the rest. Unlike delta scaling's, this peak has
a width. Light that comes from around a direction, with Henyey and Greenstein's distribution of mean cosine r, scatters
by p_w with its Legendre moments times r^l.
"""

import functools
from dataclasses import dataclass

import numpy as np

from ..numerics.small_matmul import product
from ..scene.phase_function import henyey_greenstein, reduced_anisotropy

#: Square of the anisotropy below which there is no peak; nor is there where light scatters backwards.
MIN_FORWARD = 1e-3
# Least mean cosine for which the transport's directions are dense enough.
BACKMOST = -0.7
# Mean cosines and angles of the table, terms of its series, and nodes of the integrals for them.
ROWS, COLUMNS, TERMS, NODES = 33, 513, 40, 2000


@dataclass(frozen=True)
class ForwardPeak:
    """How a phase function of some anisotropy is taken apart.

    anisotropy: G. reduced: G'. wide: 1 - G^2, or 1 where there is no peak. table: float32 (ROWS, COLUMNS), p_w over
    1 - G^2 after the mean cosine r from 0 to 1 and the cosine from -1 to 1. share: the integral of p_w over the sphere.
    """

    anisotropy: float
    reduced: float
    wide: float
    table: np.ndarray
    share: float

    @property
    def empty(self) -> bool:
        """Whether all light scatters by wide angles."""
        return self.wide == 1.0


@functools.lru_cache(maxsize=16)
def forward_peak(anisotropy: float) -> ForwardPeak:
    """How the phase function of an anisotropy in (-1, 1) is taken apart."""
    g, forward = anisotropy, anisotropy**2
    empty = g <= 0.0 or forward < MIN_FORWARD

    def wide(cosine: np.ndarray) -> np.ndarray:
        whole = henyey_greenstein(cosine, max(g, BACKMOST))
        return whole if empty else np.minimum((1.0 - forward) * henyey_greenstein(cosine, reduced_anisotropy(g)), whole)

    angles, degrees, cosines = (
        (np.arange(NODES) + 0.5) * (np.pi / NODES),
        np.arange(TERMS),
        np.linspace(-1.0, 1.0, COLUMNS),
    )
    values = 2.0 * np.pi**2 / NODES * np.sin(angles) * wide(np.cos(angles))
    moments = (values[:, None] * np.polynomial.legendre.legvander(np.cos(angles), TERMS - 1)).sum(axis=0)
    weighted = (2 * degrees + 1) / (4.0 * np.pi) * moments * np.linspace(0.0, 1.0, ROWS)[:, None] ** degrees
    table = np.maximum(product(weighted, np.polynomial.legendre.legvander(cosines, TERMS - 1).T), 0.0)
    table[-1] = wide(cosines)
    table = (table / (1.0 - forward)).astype(np.float32)
    return ForwardPeak(g, reduced_anisotropy(g), 1.0 if empty else 1.0 - forward, table, float(moments[0]))
