# SPDX-License-Identifier: GPL-3.0-or-later
"""Feature P of training rows, computed from G and gamma instead of being stored."""

import math

import torch

from inference.features.stencil import POINTS
from inference.paper.phase_features import PhaseFeatures
from training.data.stencil import load_stencil


class PhaseTable:
    """Feature P at the stencil's points, interpolated in a table over gamma that is made once per value of G."""

    def __init__(self):
        self._slots = {}
        self._tables = torch.empty(0, PhaseFeatures.KNOTS, POINTS)

    def _slot(self, anisotropy: float) -> int:
        if anisotropy not in self._slots:
            table = torch.from_numpy(PhaseFeatures(load_stencil(), anisotropy).table)
            self._tables = torch.cat([self._tables, table[None].to(self._tables.device)])
            self._slots[anisotropy] = len(self._slots)
        return self._slots[anisotropy]

    def __call__(self, anisotropy, gamma):
        """float32 (N, 192) for tensors anisotropy and gamma (N,), linear between the knots of gamma."""
        self._tables = self._tables.to(gamma.device)
        values, which = torch.unique(anisotropy, return_inverse=True)
        slots = torch.tensor([self._slot(round(value, 6)) for value in values.tolist()], device=gamma.device)[which]
        position = (gamma / math.pi).clamp(0.0, 1.0) * (PhaseFeatures.KNOTS - 1)
        knot = position.long().clamp(max=PhaseFeatures.KNOTS - 2)
        low, high = self._tables[slots, knot], self._tables[slots, knot + 1]
        return torch.lerp(low, high, (position - knot)[:, None])
