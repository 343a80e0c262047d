# SPDX-License-Identifier: GPL-3.0-or-later
"""The network for the error of `mrpnn`: its standard deviation over the prediction."""

import math

import torch
from torch import nn

from inference.network.uncertainty import COLUMNS

WIDTH = 24
#: Bounds of the deviation.
LEAST, MOST = 0.005, 0.7
#: How fast it grows with the distance to what was trained, up to what distance: inputs beyond the range of the rows
#: count as its end, and what they exceed it by, in standard deviations, adds up.
GROWTH, FARTHEST = 0.2, 5.0


class UncertaintyNet(nn.Module):
    """Standard deviation (N,) of the relative error, for inputs (N, COLUMNS) of `inference.network.uncertainty`."""

    name = "uncertainty"

    def __init__(self, width: int = WIDTH):
        super().__init__()
        for name in ("mean", "deviation", "low", "high"):
            self.register_buffer(name, torch.zeros(COLUMNS))
        self.layers = nn.ModuleList([nn.Linear(COLUMNS, width), nn.Linear(width, width), nn.Linear(width, 1)])
        with torch.no_grad():
            self.layers[-1].weight *= 0.1
            self.layers[-1].bias.fill_(math.log(0.15))

    @torch.no_grad()
    def calibrate(self, x):
        """Take means, deviations and ranges from those of rows (N, COLUMNS)."""
        self.mean.copy_(x.mean(dim=0))
        self.deviation.copy_(x.std(dim=0) + 1e-2)
        x = (x - self.mean) / self.deviation
        self.low.copy_(x.amin(dim=0))
        self.high.copy_(x.amax(dim=0))

    def forward(self, x):
        x = (x - self.mean) / self.deviation
        inside = torch.minimum(torch.maximum(x, self.low), self.high)
        h = torch.tanh(self.layers[0](inside))
        h = torch.tanh(self.layers[1](h))
        y = torch.exp(self.layers[2](h)[:, 0].clamp(math.log(LEAST), math.log(MOST)))
        return y * (1.0 + GROWTH * (x - inside).abs().sum(dim=1).clamp(max=FARTHEST))

    def graph(self, g):
        """Add the network to an ONNX graph."""
        g.input("x", ["N", COLUMNS])
        x = g.op("Div", g.op("Sub", "x", g.constant(self.mean)), g.constant(self.deviation))
        inside = g.op("Min", g.op("Max", x, g.constant(self.low)), g.constant(self.high))
        h = g.op("Tanh", g.linear(inside, self.layers[0]))
        h = g.op("Tanh", g.linear(h, self.layers[1]))
        y = g.op("Clip", g.linear(h, self.layers[2]), g.number(math.log(LEAST)), g.number(math.log(MOST)))
        excess = g.op("Abs", g.op("Sub", x, inside))
        excess = g.op("MatMul", excess, g.constant(torch.full((COLUMNS, 1), GROWTH)))
        excess = g.op("Min", excess, g.number(GROWTH * FARTHEST))
        y = g.op("Mul", g.op("Exp", y), g.op("Add", excess, g.number(1.0)))
        g.output("deviation", g.reshape(y, (-1,)), ["N"])
