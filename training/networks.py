"""MRPNN as A.5 defines it.

Tensors are (3, N, k) for a block's features, channels mu, S, P first: one batched product
serves the three channels' sub-networks, which have weights of their own.
"""

import math

import torch
from torch import nn

from inference.stencil import LAYER_POINTS, LOW_LAYERS

CHANNELS = 3


class ChannelLinear(nn.Module):
    """A fully connected layer for each channel: (3, N, in) to (3, N, out)."""

    def __init__(self, inputs: int, outputs: int):
        super().__init__()
        bound = 1.0 / math.sqrt(inputs)
        self.weight = nn.Parameter(torch.empty(CHANNELS, inputs, outputs).uniform_(-bound, bound))
        self.bias = nn.Parameter(torch.empty(CHANNELS, 1, outputs).uniform_(-bound, bound))

    def forward(self, x):
        return torch.baddbmm(self.bias, x, self.weight)


class Excitation(nn.Module):
    """SE_ex of eq. 5: two layers without bias, ReLU, then a sigmoid."""

    def __init__(self, inputs: int, hidden: int, outputs: int):
        super().__init__()
        self.squeeze = nn.Linear(inputs, hidden, bias=False)
        self.excite = nn.Linear(hidden, outputs, bias=False)

    def forward(self, e):
        return torch.sigmoid(self.excite(torch.relu(self.squeeze(e))))


def layer_slices():
    """Columns of each stencil layer in the 192 points."""
    start, slices = 0, []
    for points in LAYER_POINTS:
        slices.append(slice(start, start + points))
        start += points
    return slices


class MRPNN(nn.Module):
    """Eqs. 4-13: multiple-scattered radiance at a point, for a sun of irradiance 1."""

    RESIDUAL_LAYERS = 12

    def __init__(self):
        super().__init__()
        self.blocks = nn.ModuleList(ChannelLinear(n, n) for n in LAYER_POINTS)
        self.excitations = nn.ModuleList(Excitation(8, 8, 3) for _ in LAYER_POINTS)
        low, high = LAYER_POINTS[LOW_LAYERS - 1], LAYER_POINTS[-1]
        self.low_latent = ChannelLinear(low, low)
        self.high_latent = ChannelLinear(high, high)
        self.albedo_latent = nn.Linear(3, 8)
        self.albedo_excitation = Excitation(6 * len(LAYER_POINTS) + 3, 16, 6)
        self.reduction = nn.ModuleList(nn.Linear(i, o) for i, o in ((128, 128), (128, 64), (64, 32), (32, 16)))
        widths = [16] * self.RESIDUAL_LAYERS + [1]
        self.residual = nn.ModuleList(nn.Linear(i, o) for i, o in zip(widths[:-1], widths[1:]))

    def feature_stage(self, features, anisotropy, gamma):
        """features (3, N, 192) -> scaled latents (3, N, 32), (3, N, 8) and pooled values (N, 72)."""
        angles = torch.stack([anisotropy, gamma], dim=1)
        pooled, o, latents = [], None, []
        for i, columns in enumerate(layer_slices()):
            f = features[:, :, columns]
            # Eq. 4: means, then maxima, of the three channels.
            t = torch.cat([f.mean(dim=2), f.amax(dim=2)]).T
            pooled.append(t)
            weights = self.excitations[i](torch.cat([t, angles], dim=1))
            scaled = f * weights.T.unsqueeze(2)
            if o is not None:
                scaled = scaled + o
            # Eq. 7, or footnote 2 where the next layer is twice as wide.
            h = torch.relu(self.blocks[i](scaled))
            last = i in (LOW_LAYERS - 1, len(LAYER_POINTS) - 1)
            widens = not last and LAYER_POINTS[i + 1] != LAYER_POINTS[i]
            o = torch.cat([h, f], dim=2) if widens else h + f
            if last:
                latents.append(o)
                o = None
        h1 = torch.relu(self.low_latent(latents[0]))
        h2 = torch.relu(self.high_latent(latents[1]))
        return h1, h2, torch.cat(pooled, dim=1)

    def albedo_stage(self, h1, h2, pooled, anisotropy, gamma, albedo):
        """Eqs. 10-13 for one albedo a point (N,): the network's raw output y (N,)."""
        parameters = torch.stack([anisotropy, albedo, gamma], dim=1)
        h_albedo = torch.relu(self.albedo_latent(parameters))
        e = torch.cat([pooled, torch.stack([albedo, anisotropy, gamma], dim=1)], dim=1)
        weights = self.albedo_excitation(e).T.unsqueeze(2)
        scaled = [*(weights[:3] * h1), *(weights[3:] * h2), h_albedo]
        o = torch.cat(scaled, dim=1)
        for layer in self.reduction:
            o = torch.relu(layer(o))
        for k in range(0, self.RESIDUAL_LAYERS, 2):
            odd = torch.relu(self.residual[k](o))
            even = self.residual[k + 1](odd)
            o = even[:, 0] if k + 2 == self.RESIDUAL_LAYERS else torch.relu(even) + odd
        return o

    def forward(self, features, anisotropy, gamma, albedo):
        """features float32 (3, N, 192); anisotropy, gamma (N,); albedo (A, N).

        Returns radiance (A, N) = albedo * exp(y): positive, compressive, and 0 at albedo 0.
        """
        latents = self.feature_stage(features, anisotropy, gamma)
        return torch.stack([a * torch.exp(self.albedo_stage(*latents, anisotropy, gamma, a)) for a in albedo])
