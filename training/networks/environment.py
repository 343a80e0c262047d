# SPDX-License-Identifier: GPL-3.0-or-later
"""The network for light from everywhere: weights of the radiances among which it chooses."""

import numpy as np
import torch
from torch import nn

from inference.network.environment_features import CANDIDATES, COLUMNS

WIDTH, HIDDEN_LAYERS = 192, 3
#: Scattering orders n after the point: the radiance is a sum of albedo^n; the first is single scattering.
ORDERS = (0, 1, 2, 3, 4, 6, 9, 14, 24, 48, 100, 250, 800)
#: Orders that share their weights of the candidates: the first of each group.
GROUPS = (0, 1, 2, 5, 9)


class EnvironmentNet(nn.Module):
    """Scattered radiance at a point as a mean of candidates, with weights that depend on the medium alone.

    For albedo 1 all weights sum to 1: even light stays even.
    """

    name = "environment"

    def __init__(self, width: int = WIDTH, hidden: int = HIDDEN_LAYERS):
        super().__init__()
        self.register_buffer("mean", torch.zeros(COLUMNS))
        self.register_buffer("deviation", torch.ones(COLUMNS))
        self.first = nn.Linear(COLUMNS, width)
        self.hidden = nn.ModuleList(nn.Linear(width, width) for _ in range(hidden))
        self.last = nn.Linear(width, len(ORDERS) + len(GROUPS) * CANDIDATES)
        with torch.no_grad():
            self.last.weight *= 0.1
            self.last.bias.zero_()
        ends = [*GROUPS[1:], len(ORDERS)]
        group = torch.zeros(len(ORDERS), len(GROUPS))
        for i, (start, end) in enumerate(zip(GROUPS, ends)):
            group[start:end, i] = 1.0
        self.register_buffer("group", group, persistent=False)
        self.register_buffer("orders", torch.tensor(ORDERS, dtype=torch.float32), persistent=False)

    @torch.no_grad()
    def calibrate(self, x):
        """Set the means and deviations that standardise inputs from those of rows (N, COLUMNS)."""
        self.mean.copy_(x.mean(dim=0))
        self.deviation.copy_(x.std(dim=0) + 1e-2)

    @torch.no_grad()
    def restore(self, layers):
        """Load the weights of an exported graph: its fully connected layers, weights and biases, in the graph's order.

        The means and deviations stay; the graph's, folded into its first layer, are replaced by them. Of a narrower
        network the outputs are kept, too: nothing is read yet of what its layers lack.
        """
        (weight, bias), *hidden, shares, mixed = layers
        first = weight * self.deviation, bias + weight @ self.mean
        last = torch.cat([shares[0], mixed[0]]), torch.cat([shares[1], mixed[1]])
        for module, (weight, bias) in zip((self.first, *self.hidden, self.last), (first, *hidden, last), strict=True):
            rows, columns = weight.shape
            module.weight[:rows] = 0.0
            module.weight[:rows, :columns] = weight
            module.bias[:rows] = bias

    def weights(self, x):
        """Shares (N, orders) of the scattering orders and weights (N, groups, CANDIDATES) within groups."""
        h = torch.relu(self.first((x - self.mean) / self.deviation))
        for layer in self.hidden:
            h = h + torch.relu(layer(h))
        y = self.last(h)
        shares = torch.softmax(y[:, : len(ORDERS)], dim=1)
        return shares, torch.softmax(y[:, len(ORDERS) :].reshape(-1, len(GROUPS), CANDIDATES), dim=2)

    def forward(self, x, candidates, albedo):
        """Single scattering (N, C) and multiple scattering (N, A, C) for inputs (N, COLUMNS), candidates (N,
        CANDIDATES, C) and albedos (N, A)."""
        shares, weights = self.weights(x)
        means = weights @ candidates
        powers = albedo[:, :, None] ** self.orders[1:]
        multiple = (powers * shares[:, None, 1:]) @ self.group[1:] @ means
        return shares[:, :1] * means[:, 0], multiple

    def graph(self, g):
        """Add the network to an ONNX graph: inputs x (N, COLUMNS), candidates (N, CANDIDATES, C) and albedo (A,).

        The output radiance (A + 1, N, C) is single scattering, then multiple scattering for each albedo.
        """
        g.input("x", ["N", COLUMNS])
        g.input("candidates", ["N", CANDIDATES, "C"])
        g.input("albedo", ["A"])
        first_w = self.first.weight / self.deviation
        first_b = self.first.bias - first_w @ self.mean
        h = g.relu(g.op("Gemm", "x", g.constant(first_w), g.constant(first_b), transB=1))
        for layer in self.hidden:
            h = g.op("Add", h, g.relu(g.linear(h, layer)))
        count = len(ORDERS)
        w, b = self.last.weight, self.last.bias
        shares = g.op("Gemm", h, g.constant(w[:count]), g.constant(b[:count]), transB=1)
        shares = g.op("Softmax", shares, axis=1)
        mixed = g.op("Gemm", h, g.constant(w[count:]), g.constant(b[count:]), transB=1)
        mixed = g.op("Reshape", mixed, g.constant(np.array([-1, len(GROUPS), CANDIDATES], np.int64)))
        means = g.op("MatMul", g.op("Softmax", mixed, axis=2), "candidates")
        # Powers of the albedo, the first row for single scattering alone: (A + 1, orders).
        powers = g.op("Pow", g.column("albedo"), g.constant(np.array([ORDERS], np.float32)))
        after = (np.array([ORDERS]) > 0).astype(np.float32)
        powers = g.op("Mul", powers, g.constant(after))
        powers = g.concat([g.constant(1.0 - after), powers], axis=0)
        # (N, A + 1, orders) @ (orders, groups) @ (N, groups, C)
        weighted = g.op("Mul", g.op("Unsqueeze", shares, g.constant(np.array([1], np.int64))), powers)
        radiance = g.op("MatMul", g.op("MatMul", weighted, g.constant(self.group.numpy())), means)
        g.output("radiance", radiance, ["N", "A1", "C"])
