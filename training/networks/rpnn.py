# SPDX-License-Identifier: GPL-3.0-or-later
"""RPNN, the paper's baseline (Kallweit et al. 2017): density alone, on lattices towards the sun."""

import numpy as np
import torch
from torch import nn

from training.rpnn.rpnn_lattice import LEVELS, POINTS, SHAPE

WIDTH = 200
#: Lattice points mirrored in the plane of sun and camera ray, under which radiance is invariant.
MIRRORED = torch.from_numpy(np.ascontiguousarray(np.arange(POINTS).reshape(SHAPE)[:, ::-1].reshape(-1)))


class RPNN(nn.Module):
    """o_k = relu(o_(k-1) + U_k relu(V_k [Sigma_k, gamma] + W_k o_(k-1))), then 200 -> 200 -> 200 -> 1.

    Levels go from the smallest lattice to the largest; the first block has no predecessor. Trained for one anisotropy
    and albedo 1.
    """

    name = "rpnn"
    kind = "lattice"
    columns = ("lattice", "gamma")
    #: The values that it is trained for, for the exported configuration.
    ranges = {"anisotropy_range": (0.857, 0.857), "albedo_range": (1.0, 1.0)}

    def __init__(self):
        super().__init__()
        self.describe = nn.ModuleList(nn.Linear(POINTS + 1, WIDTH) for _ in range(LEVELS))
        self.carry = nn.ModuleList(nn.Linear(WIDTH, WIDTH, bias=False) for _ in range(LEVELS - 1))
        self.update = nn.ModuleList(nn.Linear(WIDTH, WIDTH) for _ in range(LEVELS))
        self.head = nn.ModuleList(nn.Linear(WIDTH, outputs) for outputs in (WIDTH, WIDTH, 1))

    @staticmethod
    def inputs(data, rows):
        """Of rows of training.data.lattice_rows: density features (N, 10, 225), gamma (N,), float32."""
        return data["lattice"][rows].float(), data["gamma"][rows]

    def forward(self, lattice, gamma, albedo):
        """lattice float32 (N, 10, 225); gamma (N,); albedo (A, N), of which only the shape counts.

        Returns radiance (A, N) = exp(y), at albedo 1 for a sun of irradiance 1. In training every other row is
        mirrored.
        """
        if self.training:
            lattice = torch.where(torch.arange(len(lattice))[:, None, None] % 2 == 0, lattice[..., MIRRORED], lattice)
        o = None
        for k, level in enumerate(lattice.unbind(1)):
            h = self.describe[k](torch.cat([level, gamma[:, None]], dim=1))
            h = h if o is None else h + self.carry[k - 1](o)
            h = self.update[k](torch.relu(h))
            o = torch.relu(h if o is None else o + h)
        o = torch.relu(self.head[1](torch.relu(self.head[0](o))))
        return torch.exp(self.head[2](o)[:, 0]).expand(albedo.shape)

    def graph(self, g):
        """Add the whole network to an ONNX graph, with the inputs that `training.rpnn.lattice_predictor` feeds."""
        g.input("lattice", ["N", LEVELS, POINTS])
        g.input("gamma", ["N"])
        g.input("albedo", ["A"])
        gamma, o = g.column("gamma"), None
        for k, level in enumerate(g.split("lattice", [1] * LEVELS, axis=1)):
            h = g.linear(g.concat([g.reshape(level, (-1, POINTS)), gamma], axis=1), self.describe[k])
            h = h if o is None else g.op("Add", h, g.linear(o, self.carry[k - 1]))
            h = g.linear(g.relu(h), self.update[k])
            o = g.relu(h if o is None else g.op("Add", o, h))
        for layer in self.head[:2]:
            o = g.relu(g.linear(o, layer))
        radiance = g.op("Exp", g.reshape(g.linear(o, self.head[2]), (1, -1)))
        shape = g.concat([g.op("Shape", "albedo"), g.constant(np.array([1], np.int64))], axis=0)
        g.output("radiance", g.op("Expand", radiance, shape), ["A", "N"])
