# SPDX-License-Identifier: GPL-3.0-or-later
"""One network for every light: it weights the terms of `light_features`, so that its light is linear in them."""

import torch
from torch import nn

from .light_features import TERMS

#: Bounds of a weight's logarithm, and where training starts: with the sum of the terms that the transport itself gives.
LEAST, MOST = -9.0, 3.0
START = (-1.5, -0.7, -3.0, -0.7, -3.0, -0.3, -3.0)


class AnyLight(nn.Module):
    """Radiance as a sum of terms times the exponentials of a residual network's outputs.

    inputs: number of the inputs of `light_features`.
    """

    def __init__(self, inputs: int, width: int = 192, hidden: int = 4) -> None:
        super().__init__()
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("deviation", torch.ones(inputs))
        self.first = nn.Linear(inputs, width)
        self.hidden = nn.ModuleList(nn.Linear(width, width) for _ in range(hidden))
        self.last = nn.Linear(width, TERMS)
        with torch.no_grad():
            self.last.weight *= 0.1
            self.last.bias.copy_(torch.tensor(START))

    @torch.no_grad()
    def calibrate(self, inputs: torch.Tensor) -> None:
        """Standardise by the mean and deviation of inputs (N, INPUTS)."""
        self.mean.copy_(inputs.mean(dim=0))
        self.deviation.copy_(inputs.std(dim=0) + 1e-2)

    def forward(self, terms: torch.Tensor, inputs: torch.Tensor) -> torch.Tensor:
        """Radiance (N,) of terms (N, TERMS) and inputs (N, INPUTS)."""
        x = ((inputs - self.mean) / self.deviation).clamp(-5.0, 5.0)
        h = torch.relu(self.first(x))
        for layer in self.hidden:
            h = h + torch.relu(layer(h))
        return (terms * torch.exp(self.last(h).clamp(LEAST, MOST))).sum(dim=1)
