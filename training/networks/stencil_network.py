# SPDX-License-Identifier: GPL-3.0-or-later
"""What MRPNN and its variants share: the inputs and the end of the albedo stage."""

import numpy as np
import torch
from torch import nn

from inference.features.stencil import LAYER_POINTS, POINTS

from .phase_table import PhaseTable

_phase_table = PhaseTable()


class StencilNetwork(nn.Module):
    """Multiple-scattered radiance at a point, for a sun of irradiance 1, from features of A.2's stencil.

    Subclasses define `feature_stage`, evaluated once per point, and `fuse`, once per albedo; `feature_graph` and
    `fuse_graph` are the same in ONNX.
    """

    kind = "stencil"
    #: Columns of the training data that `inputs` reads.
    columns = ("features", "anisotropy", "gamma")
    #: Ranges narrower than the training data's, for the exported configuration.
    ranges = {}
    RESIDUAL_LAYERS = 12

    def __init__(self):
        super().__init__()
        self.albedo_latent = nn.Linear(3, 8)
        self.reduction = nn.ModuleList(nn.Linear(i, o) for i, o in ((128, 128), (128, 64), (64, 32), (32, 16)))
        widths = [16] * self.RESIDUAL_LAYERS + [1]
        self.residual = nn.ModuleList(nn.Linear(i, o) for i, o in zip(widths[:-1], widths[1:]))

    @staticmethod
    def inputs(data, rows):
        """Of rows of the training data: features (3, N, 192), anisotropy (N,), gamma (N,), float32."""
        anisotropy, gamma = data["anisotropy"][rows], data["gamma"][rows]
        fields = data["features"][rows].float().transpose(0, 1)
        return torch.cat([fields, _phase_table(anisotropy, gamma)[None]]), anisotropy, gamma

    def forward(self, features, anisotropy, gamma, albedo):
        """features float32 (3, N, 192); anisotropy, gamma (N,); albedo (A, N).

        Returns radiance (A, N) = albedo * exp(y): positive, compressive, and 0 at albedo 0.
        """
        latents = self.feature_stage(features, anisotropy, gamma)
        return torch.stack([a * torch.exp(self.albedo_stage(latents, anisotropy, gamma, a)) for a in albedo])

    def albedo_stage(self, latents, anisotropy, gamma, albedo):
        """Eqs. 10 to 13 for one albedo per point (N,): the network's raw output y (N,)."""
        parameters = torch.stack([anisotropy, albedo, gamma], dim=1)
        fused = self.fuse(latents, albedo, anisotropy, gamma)
        o = torch.cat([fused, torch.relu(self.albedo_latent(parameters))], dim=1)
        for layer in self.reduction:
            o = torch.relu(layer(o))
        for k in range(0, self.RESIDUAL_LAYERS, 2):
            odd = torch.relu(self.residual[k](o))
            even = self.residual[k + 1](odd)
            o = even[:, 0] if k + 2 == self.RESIDUAL_LAYERS else torch.relu(even) + odd
        return o

    def graph(self, g):
        """Add the whole network to an ONNX graph, with the inputs that `inference.paper.stencil_predictor` feeds."""
        g.input("features", [3, "N", POINTS])
        g.input("anisotropy", ["N"])
        g.input("gamma", ["N"])
        g.input("albedo", ["A"])
        angles = g.concat([g.column("anisotropy"), g.column("gamma")], axis=1)
        latents = self.feature_graph(g, g.split("features", LAYER_POINTS, axis=2), angles)
        rows = [g.repeat(name, width) for name, width in latents]
        anisotropy, gamma = g.split(g.repeat(angles, 2), (1, 1), axis=1)
        points = g.op("Shape", "gamma")
        one = g.constant(np.array([1], np.int64))
        albedo = g.column(g.op("Expand", g.column("albedo"), g.concat([one, points], axis=0)))
        h_albedo = g.relu(g.linear(g.concat([anisotropy, albedo, gamma], axis=1), self.albedo_latent))
        o = g.concat([self.fuse_graph(g, rows, albedo, anisotropy, gamma), h_albedo], axis=1)
        for layer in self.reduction:
            o = g.relu(g.linear(o, layer))
        for k in range(0, self.RESIDUAL_LAYERS, 2):
            odd = g.relu(g.linear(o, self.residual[k]))
            even = g.linear(odd, self.residual[k + 1])
            o = even if k + 2 == self.RESIDUAL_LAYERS else g.op("Add", g.relu(even), odd)
        radiance = g.op("Mul", albedo, g.op("Exp", o))
        g.output("radiance", g.op("Reshape", radiance, g.concat([g.op("Shape", "albedo"), points], axis=0)), ["A", "N"])
