# SPDX-License-Identifier: GPL-3.0-or-later
"""The default network: densities, light along the camera ray and coarse scattered light in a residual network."""

import math

import numpy as np
import torch
from onnx import TensorProto
from torch import nn

from inference.features import final_gather
from inference.features.stencil import LAYER_POINTS, SPARSE
from inference.marching import ray_features
from inference.marching.ray_features import MAX_TAU_AHEAD, MAX_TAU_SUN
from inference.transport import scattered_fluence

WIDTH = 192
HIDDEN_LAYERS = 3
MODULATION = 64
#: Scattering orders n: the radiance is a sum of albedo^n with weights >= 0.
ORDERS = (1, 2, 3, 4, 6, 9, 14, 24, 48, 100, 250, 800)
# Scales of extinction at which transmittance towards the sun, and ahead, enters.
SUN_SCALES = tuple(0.578**k for k in (0, 1, 2, 3, 4, 5, 6, 8))
AHEAD_SCALES = (1.0, 0.334, 0.1)
MAX_LOG_RADIANCE = 4.0
# Points of the sparse stencil, per layer.
LAYERS = [n // SPARSE for n in LAYER_POINTS]
POINTS = sum(LAYERS)
# Added before logarithms of layers' mean densities and of the light ahead.
POOLED_OFFSET, AHEAD_OFFSET = 3e-4, 1e-3
#: Values gathered around the camera ray: light, whose logarithms enter as well, and transmittance last.
GATHERED = (final_gather.DIRECTIONS, final_gather.VALUES)
GATHERED_LIGHTS = final_gather.DIRECTIONS * (final_gather.VALUES - 1)
#: Light features: values ahead on the ray, logarithms of fluence around the point, and fluxes there.
AHEAD = ray_features.COLUMNS - 2
LOGS = scattered_fluence.PROBES + 1
FLUXES = scattered_fluence.COLUMNS - LOGS
RAY_INPUTS = 2 + AHEAD + LOGS + FLUXES


def log_phase(cosine, g):
    """Logarithm of Henyey-Greenstein's phase function; tensors that broadcast."""
    return torch.log((1 - g * g) / (4 * math.pi)) - 1.5 * torch.log(1 + g * g - 2 * g * cosine)


class RayMRPNN(nn.Module):
    """Multiple-scattered radiance at a point, for a sun of irradiance 1.

    Reads the density at every fourth point of A.2's stencil, the optical depths towards the sun and ahead along the
    camera ray, the light from ahead and from directions around it, and the scattered fluence and flux around the
    point. The output is a power series in the albedo with weights >= 0: one evaluation serves all albedos, and the
    radiance is never negative and never falls with albedo.
    """

    name = "mrpnn"
    kind = "ray"
    columns = ("features", "ray", "around", "gathered", "anisotropy", "gamma")
    ranges = {}

    def __init__(self, width: int = WIDTH, hidden: int = HIDDEN_LAYERS):
        super().__init__()
        auxiliary = len(LAYERS) + len(SUN_SCALES) + 1 + 2 * AHEAD + 1 + len(AHEAD_SCALES)
        auxiliary += 2 * LOGS + FLUXES + GATHERED_LIGHTS + math.prod(GATHERED)
        angles = 8
        inputs = POINTS + auxiliary + angles
        # Inputs are standardised with the training data's mean and deviation.
        self.register_buffer("mean", torch.zeros(inputs))
        self.register_buffer("deviation", torch.ones(inputs))
        self.first = nn.Linear(inputs, width)
        self.modulation = nn.ModuleList([nn.Linear(angles, MODULATION), nn.Linear(MODULATION, 2 * width)])
        nn.init.zeros_(self.modulation[1].weight)
        nn.init.zeros_(self.modulation[1].bias)
        self.hidden = nn.ModuleList(nn.Linear(width, width) for _ in range(hidden))
        self.last = nn.Linear(width, len(ORDERS))
        # Where scattering is nearly even, the answer is close to the light around the point.
        self.skip = nn.Linear(LOGS + GATHERED_LIGHTS, len(ORDERS), bias=False)
        nn.init.zeros_(self.skip.weight)
        with torch.no_grad():
            self.last.weight *= 0.1
            self.last.bias.fill_(-4.0)
        self.register_buffer("orders", torch.tensor(ORDERS, dtype=torch.float32), persistent=False)
        pooling = torch.zeros(POINTS, len(LAYERS))
        start = 0
        for i, points in enumerate(LAYERS):
            pooling[start : start + points, i] = 1.0 / points
            start += points
        self.register_buffer("pooling", pooling, persistent=False)

    @staticmethod
    def inputs(data, rows):
        """Of training rows: mu at the stencil (N, POINTS), light (N, RAY_INPUTS), light around rays (N, *GATHERED), and
        anisotropy and gamma (N,).
        """
        stencil = data["features"][rows, 0, ::SPARSE].float()
        ray = torch.cat([data["ray"][rows], data["around"][rows]], dim=1)
        return stencil, ray, data["gathered"][rows].float(), data["anisotropy"][rows], data["gamma"][rows]

    @torch.no_grad()
    def calibrate(self, *inputs):
        """Set the means and deviations that standardise inputs from those of rows of data, as `inputs` returns them."""
        x, angles = self.assemble(*inputs)
        x = torch.cat([x, angles], dim=1)
        self.mean.copy_(x.mean(dim=0))
        self.deviation.copy_(x.std(dim=0) + 1e-2)

    @torch.no_grad()
    def restore(self, layers):
        """Load the weights of an exported graph: its fully connected layers, weights and biases, in the graph's order.

        The means and deviations stay; the graph's, folded into its first layers, are replaced by them, so that the
        outputs are the graph's. Weights of inputs that the graph lacks, the last ones, are 0.
        """
        modulation, scale, shift, first_angles, first_others, first_stencil, *rest, (skip,) = layers
        self.skip.weight.copy_(_widened(skip, self.skip.in_features))
        angles = len(modulation[0].T)
        others = _widened(first_others[0], self.first.in_features - POINTS - angles)
        first = [torch.cat([first_stencil[0], others, first_angles[0]], dim=1), first_angles[1]]
        # The graph's scale is 1 + scale.
        modulations = [torch.cat([scale[0], shift[0]]), torch.cat([scale[1] - 1.0, shift[1]])]
        for module, (weight, bias), mean, deviation in (
            (self.modulation[0], modulation, self.mean[-angles:], self.deviation[-angles:]),
            (self.modulation[1], modulations, None, None),
            (self.first, first, self.mean, self.deviation),
            *((module, layer, None, None) for module, layer in zip((*self.hidden, self.last), rest)),
        ):
            if mean is not None:
                bias, weight = bias + weight @ mean, weight * deviation
            module.weight.copy_(weight)
            module.bias.copy_(bias)

    def assemble(self, stencil, ray, gathered, anisotropy, gamma):
        """The inputs (N, k) without the angles, and the angles (N, 8), before standardisation."""
        with torch.autocast("cpu", enabled=False):
            pooled = torch.log(stencil @ self.pooling + POOLED_OFFSET)
        tau_sun = ray[:, :1].clamp(0.0, MAX_TAU_SUN)
        tau_ahead = ray[:, 1:2].clamp(0.0, MAX_TAU_AHEAD)
        ahead, logs, fluxes = ray[:, 2:].split([AHEAD, LOGS, FLUXES], dim=1)
        ahead = ahead.clamp(min=0.0)
        cosine, g = torch.cos(gamma), anisotropy
        angles = torch.stack(
            [
                cosine,
                torch.sin(gamma),
                gamma / math.pi,
                g,
                log_phase(cosine, g),
                log_phase(cosine, g * g.abs()),
                log_phase(cosine, g**3),
                torch.log(1 - g.abs()),
            ],
            dim=1,
        )
        x = [stencil, pooled, *(torch.exp(-s * tau_sun) for s in SUN_SCALES), torch.log1p(tau_sun)]
        x += [ahead, torch.log(ahead + AHEAD_OFFSET), torch.log1p(tau_ahead)]
        x += [*(torch.exp(-s * tau_ahead) for s in AHEAD_SCALES), logs, torch.exp(logs), fluxes]
        x += [gathered.flatten(1), self.gathered_logs(gathered)]
        return torch.cat(x, dim=1), angles

    @staticmethod
    def gathered_logs(gathered):
        """Logarithms (N, GATHERED_LIGHTS) of the light gathered around the camera ray."""
        return torch.log(gathered[:, :, :-1].clamp(min=0.0) + AHEAD_OFFSET).flatten(1)

    def weights(self, stencil, ray, gathered, anisotropy, gamma):
        """Weights (N, orders) of the powers of the albedo, >= 0."""
        x, angles = self.assemble(stencil, ray, gathered, anisotropy, gamma)
        x = (torch.cat([x, angles], dim=1) - self.mean) / self.deviation
        angles = x[:, -angles.shape[1] :]
        scale, shift = self.modulation[1](torch.relu(self.modulation[0](angles))).chunk(2, dim=1)
        h = torch.relu(self.first(x) * (1.0 + scale) + shift)
        for layer in self.hidden:
            h = h + torch.relu(layer(h))
        logs = ray[:, 2 + AHEAD :][:, :LOGS]
        y = self.last(h) + self.skip(torch.cat([logs, self.gathered_logs(gathered)], dim=1))
        return torch.exp(y.float().clamp(max=MAX_LOG_RADIANCE))

    def forward(self, stencil, ray, gathered, anisotropy, gamma, albedo):
        """Radiance (A, N) for albedos (A, N); the other inputs as `inputs` returns them."""
        weights = self.weights(stencil, ray, gathered, anisotropy, gamma)
        return (albedo[:, :, None] ** self.orders * weights).sum(dim=2)

    def graph(self, g):
        """Add the network to an ONNX graph, with the inputs that `inference.network.predictor` feeds.

        Points on one camera ray share a view: what follows from the angle to the sun alone is computed once for each
        of V views, and `view` (N,) names each point's.
        """
        g.input("stencil", ["N", POINTS])
        g.input("ray", ["N", RAY_INPUTS])
        g.input("gathered", ["N", *GATHERED])
        g.input("view", ["N"], TensorProto.INT32)
        g.input("anisotropy", ["V"])
        g.input("gamma", ["V"])
        g.input("albedo", ["A"])
        others, angles, logs = self._assemble_graph(g)
        # Standardisation folds into the first layers.
        first_w = self.first.weight / self.deviation
        first_b = self.first.bias - first_w @ self.mean
        n = 8
        mod_w = self.modulation[0].weight / self.deviation[-n:]
        mod_b = self.modulation[0].bias - mod_w @ self.mean[-n:]
        hidden = g.relu(g.op("Gemm", angles, g.constant(mod_w), g.constant(mod_b), transB=1))
        (scale_w, shift_w), (scale_b, shift_b) = self.modulation[1].weight.chunk(2), self.modulation[1].bias.chunk(2)
        scale = g.op("Gemm", hidden, g.constant(scale_w), g.constant(scale_b + 1.0), transB=1)
        shift = g.op("Gemm", hidden, g.constant(shift_w), g.constant(shift_b), transB=1)
        # The first layer, as a sum over its inputs' parts.
        start = g.op("Gemm", angles, g.constant(first_w[:, -n:]), g.constant(first_b), transB=1)
        shift = g.op("Add", g.op("Mul", start, scale), shift)
        h = g.op("Gemm", others, g.constant(first_w[:, POINTS:-n]), transB=1)
        h = g.op("Gemm", "stencil", g.constant(first_w[:, :POINTS]), h, transB=1)
        scale, shift = (g.op("Gather", values, "view", axis=0) for values in (scale, shift))
        h = g.relu(g.op("Add", g.op("Mul", h, scale), shift))
        for layer in self.hidden:
            h = g.op("Add", h, g.relu(g.linear(h, layer)))
        y = g.op("Gemm", logs, g.constant(self.skip.weight), g.linear(h, self.last), transB=1)
        y = g.op("Min", y, g.number(MAX_LOG_RADIANCE))
        powers = g.op("Pow", g.column("albedo"), g.constant(np.array([ORDERS], np.float32)))
        radiance = g.op("MatMul", powers, g.op("Transpose", g.op("Exp", y), perm=[1, 0]))
        g.output("radiance", radiance, ["A", "N"])

    def _assemble_graph(self, g):
        """Inputs without stencil and angles, the angles, and the logarithms of light around the point."""

        def scaled_exp(x, scales):
            return g.op("Exp", g.op("Mul", x, g.constant(-np.array([scales], np.float32))))

        def log1p(x):
            return g.op("Log", g.op("Add", x, g.number(1.0)))

        pooled = g.op("MatMul", "stencil", g.constant(self.pooling))
        pooled = g.op("Log", g.op("Add", pooled, g.number(POOLED_OFFSET)))
        tau_sun, tau_ahead, ahead, logs, fluxes = g.split("ray", [1, 1, AHEAD, LOGS, FLUXES], axis=1)
        tau_sun = g.op("Clip", tau_sun, g.number(0.0), g.number(MAX_TAU_SUN))
        tau_ahead = g.op("Clip", tau_ahead, g.number(0.0), g.number(MAX_TAU_AHEAD))
        ahead = g.relu(ahead)
        x = [pooled, scaled_exp(tau_sun, SUN_SCALES), log1p(tau_sun), ahead]
        x += [g.op("Log", g.op("Add", ahead, g.number(AHEAD_OFFSET))), log1p(tau_ahead)]
        x += [scaled_exp(tau_ahead, AHEAD_SCALES)]
        x += [logs, g.op("Exp", logs), fluxes]
        lights, _ = g.split("gathered", [GATHERED[1] - 1, 1], axis=2)
        gathered_logs = g.op("Log", g.op("Add", g.relu(lights), g.number(AHEAD_OFFSET)))
        gathered_logs = g.reshape(gathered_logs, (-1, GATHERED_LIGHTS))
        x += [g.reshape("gathered", (-1, math.prod(GATHERED))), gathered_logs]
        gamma, anisotropy = g.column("gamma"), g.column("anisotropy")
        cosine, size = g.op("Cos", gamma), g.op("Abs", anisotropy)
        square = g.op("Mul", anisotropy, anisotropy)

        def phase(a):
            aa = g.op("Mul", a, a)
            front = g.op("Log", g.op("Mul", g.op("Sub", g.number(1.0), aa), g.number(0.25 / math.pi)))
            cross = g.op("Mul", g.op("Mul", a, cosine), g.number(2.0))
            d = g.op("Log", g.op("Sub", g.op("Add", aa, g.number(1.0)), cross))
            return g.op("Sub", front, g.op("Mul", d, g.number(1.5)))

        angles = [
            cosine,
            g.op("Sin", gamma),
            g.op("Mul", gamma, g.number(1.0 / math.pi)),
            anisotropy,
            phase(anisotropy),
            phase(g.op("Mul", anisotropy, size)),
            phase(g.op("Mul", anisotropy, square)),
            g.op("Log", g.op("Sub", g.number(1.0), size)),
        ]
        return g.concat(x, axis=1), g.concat(angles, axis=1), g.concat([logs, gathered_logs], axis=1)


def _widened(weight, inputs: int):
    """Weights (out, inputs) of a layer with more inputs than those given (out, in), which ignores the others."""
    return nn.functional.pad(weight, (0, inputs - weight.shape[1]))
