# SPDX-License-Identifier: GPL-3.0-or-later
"""What the network for every light reads: terms of scattered light at points, and what tells how far they are off.

The medium is delta-scaled, as in `inference.transport.discrete_ordinates`: of an albedo w and a mean cosine G, the
fraction w G^2 of the extinction counts as unscattered. With L0 and L0' the unscattered radiance for the true and the
scaled extinction, and L' all radiance of the scaled medium, what a point scatters that has scattered before is

    integral of p (L' - L0) = integral of p (L0' - L0) + integral of p (L' - L0').

The terms are estimates of the two: along 8 directions on cones that stand for the phase function p, and straight ahead,
the scaled transport's source is integrated over a few growing steps. All terms are proportional to the light, and the
inputs do not depend on how bright it is.

J lights (each with its channel of albedo), P points, all in the frame of the cube.
"""

import math
from typing import NamedTuple

import numpy as np
import torch
from torch.nn.functional import grid_sample

from inference.features.final_gather import gather_directions
from inference.scene.phase_function import reduced_anisotropy

#: Steps along a direction, the optical thickness of one, and how much longer than the last a step may be.
STEPS, THICKNESS, GROWTH = 10, 0.4, 1.6
#: Steps from a sample towards a sun or a lamp, shorter near the sample.
LIGHT_STEPS = 24
MIN_SHARE = 0.02
TERMS = 7
FAR = 4.0


class LightRecords(NamedTuple):
    """Tensors of J lights, of `training.data.light_rows.LightTable`: family (J,), towards (J, 3), lamp (J, 11) and
    number (J,).
    """

    family: torch.Tensor
    towards: torch.Tensor
    lamp: torch.Tensor
    number: torch.Tensor


class LitPoints(NamedTuple):
    """P points of one medium and J lights.

    density: (1, 1, 128, 128, 128); emission: (1, E, 64, 64, 64); environments: (W, H, 2H). sigma: extinction per cube
    edge; g: mean cosine. low, high: (J,) albedos; mask: (1, 1, 64, 64, 64), or None. fields: (J, 8, 64, 64, 64) of
    `training.data.light_fields.Transport`. positions, omega: (P, 3).
    """

    density: torch.Tensor
    emission: torch.Tensor
    environments: torch.Tensor
    sigma: float
    g: float
    low: torch.Tensor
    high: torch.Tensor
    mask: torch.Tensor | None
    fields: torch.Tensor
    lights: LightRecords
    positions: torch.Tensor
    omega: torch.Tensor


def read(cells: torch.Tensor, positions: torch.Tensor, border: bool = True) -> torch.Tensor:
    """Values (N, ..., C) of cells (N or 1, C, n, n, n) at positions (N, ..., 3); 0 outside them without a border."""
    shape = positions.shape
    flat = positions.reshape(shape[0], -1, 1, 1, 3).flip(-1) * 2.0
    if len(cells) == 1 and shape[0] > 1:
        flat = flat.reshape(1, -1, 1, 1, 3)
    mode = "border" if border else "zeros"
    values = grid_sample(cells, flat, mode="bilinear", padding_mode=mode, align_corners=False)
    values = values.reshape(values.shape[0], values.shape[1], -1).transpose(1, 2)
    return values.reshape(*shape[:-1], values.shape[-1])


def phase(cosine, g):
    """Henyey-Greenstein's."""
    d = (1.0 + g * g - 2.0 * g * cosine).clamp(min=1e-6)
    return (1.0 - g * g) / (4.0 * math.pi) / (d * d.sqrt())


def _exit(positions, directions):
    """Distance (...) to where rays leave the cube."""
    d = torch.where(directions.abs() < 1e-6, torch.full_like(directions, 1e-6), directions)
    return ((0.5 * torch.sign(d) - positions) / d).amin(dim=-1).clamp(min=0.0)


class Beams:
    """The light of suns and lamps that has not scattered; 0 of other lights."""

    def __init__(self, points: LitPoints, mean_albedo: torch.Tensor) -> None:
        self.points = points
        self.scale = 1.0 - mean_albedo * points.g**2

    def __call__(self, at: torch.Tensor, radius: torch.Tensor | float = 0.0):
        """At positions (J, ..., 3): fluence without the medium, unit vectors towards the light, optical depth and
        distance, FAR of suns.

        radius: (J, ...), of the ball around a position over which a lamp's light is a mean.
        """
        kind, lamp = self.points.lights.family, self.points.lights.lamp
        count = at.dim() - 2

        def wide(values):
            return values.reshape(len(values), *[1] * count, *values.shape[1:])

        centre, intensity, own, soft = lamp[:, :3], wide(lamp[:, 3]), wide(lamp[:, 4]), wide(lamp[:, 5])
        away = wide(centre) - at
        distance = away.norm(dim=-1).clamp(min=1e-5)
        is_lamp = wide(kind == 1)
        towards = torch.where(is_lamp[..., None], away / distance[..., None], wide(self.points.lights.towards))
        slant = torch.sqrt(distance**2 + own**2)
        softened = 2.0 * intensity / (slant * (slant + distance))
        least = torch.sqrt((1.0 - (own / distance) ** 2).clamp(min=0.0))
        outside = intensity / distance**2 * 2.0 / (1.0 + least)
        inside = 4.0 * intensity / own.clamp(min=1e-6) ** 2
        sphere = torch.where(distance > own, outside, inside)
        fluence = torch.where(soft > 0.5, softened, sphere)
        level = -(towards * wide(lamp[:, 6:9])).sum(dim=-1)
        share = ((level - wide(lamp[:, 9])) / wide(lamp[:, 10])).clamp(0.0, 1.0)
        fluence = fluence * share * share * (3.0 - 2.0 * share)
        fluence = fluence / (1.0 + fluence * radius**2 / intensity.clamp(min=1e-12))
        fluence = torch.where(is_lamp, fluence, wide((kind == 0).float()))
        reach = _exit(at, towards)
        reach = torch.where(
            is_lamp, torch.minimum(reach, (distance - torch.where(soft > 0.5, 0.0, own)).clamp(min=0.0)), reach
        )
        depth = torch.zeros_like(reach)
        beams = torch.nonzero(kind < 2).flatten()
        if len(beams):
            some, ways, length = at[beams], towards[beams], reach[beams]
            total = torch.zeros_like(length)
            edges = (torch.arange(LIGHT_STEPS + 1, device=at.device) / LIGHT_STEPS) ** 2
            for low, high in zip(edges[:-1], edges[1:]):
                place = some + (length * 0.5 * (low + high))[..., None] * ways
                total += (high - low) * read(self.points.density, place, border=False)[..., 0]
            depth[beams] = total * length * self.points.sigma
        return fluence, towards, depth, torch.where(is_lamp, distance, torch.full_like(distance, FAR))


def _environment(points: LitPoints, directions: torch.Tensor) -> torch.Tensor:
    """Radiance (J, ...) that arrives from directions (J, ..., 3); 0 of lights that are none."""
    images, kind = points.environments, points.lights.family
    rows = images.shape[1]
    elevation = torch.asin(directions[..., 2].clamp(-1.0, 1.0)) / math.pi
    turns = torch.atan2(directions[..., 1], directions[..., 0]) / (2.0 * math.pi)
    row = ((0.5 - elevation) * rows).long().clamp(0, rows - 1)
    column = ((turns + 1.0) * 2 * rows).long() % (2 * rows)
    number = torch.where(kind == 2, points.lights.number, 0).reshape(-1, *[1] * (directions.dim() - 2))
    values = images[number, row, column]
    return values * (kind == 2).float().reshape(number.shape)


@torch.no_grad()
def light_features(points: LitPoints) -> tuple[torch.Tensor, torch.Tensor]:
    """Terms (J, P, TERMS) of the scattered light, 1/sr, and inputs (J, P, INPUTS)."""
    sigma, g, fields = points.sigma, points.g, points.fields
    reduced, peak = float(reduced_anisotropy(g)), g * g
    lights, count, device = len(fields), len(points.positions), fields.device
    at = points.positions[None].expand(lights, -1, -1)
    omega = points.omega[None].expand(lights, -1, -1)

    def albedo_at(place):
        low, high = (v.reshape(-1, *[1] * (place.dim() - 2)) for v in (points.low, points.high))
        if points.mask is None:
            return low.expand(place.shape[:-1])
        return low + (high - low) * read(points.mask, place)[..., 0]

    w = albedo_at(at)
    mean_albedo = w.mean(dim=1)
    beams = Beams(points, mean_albedo)
    here = read(fields, at)
    fluence, towards, depth, distance = beams(at)
    # Of light without a direction, towards where most of it comes from.
    flux = here[..., 1:4] + here[..., 5:8]
    size = flux.norm(dim=-1, keepdim=True)
    towards = torch.where((points.lights.family >= 2).reshape(-1, 1, 1), -flux / size.clamp(min=1e-12), towards)
    cosine = (towards * omega).sum(dim=-1).clamp(-1.0, 1.0)
    across = towards - cosine[..., None] * omega
    across = across + 1e-4 * torch.tensor([0.36, 0.48, 0.8], device=device)
    across = across - (across * omega).sum(dim=-1, keepdim=True) * omega
    across = across / across.norm(dim=-1, keepdim=True).clamp(min=1e-9)
    other = torch.linalg.cross(omega, across)
    local = torch.as_tensor(
        np.concatenate([gather_directions(round(g, 6)), [[0.0], [0.0], [1.0]]], axis=1), device=device
    ).float()
    # (J, P, 9, 3): 8 directions on cones, and straight ahead.
    ways = torch.stack([across, other, omega], dim=-1) @ local
    ways = ways.transpose(2, 3)

    def source(place, way, radius=0.0):
        """Of the scaled medium, in directions against ways: scattered light, and unscattered light that scatters."""
        cells = read(fields, place)
        parts = []
        for first in (0, 4):
            phi, along = cells[..., first], (cells[..., first + 1 : first + 4] * way).sum(dim=-1)
            parts.append(torch.maximum(phi - 3.0 * reduced * along, MIN_SHARE * phi).clamp(min=0.0) / (4.0 * math.pi))
        given, light, tau, _ = beams(place, radius)
        scale = beams.scale.reshape(-1, *[1] * (place.dim() - 2))
        parts[1] = parts[1] + given * torch.exp(-scale * tau) * phase((light * way).sum(dim=-1), reduced)
        return parts

    start = at[:, :, None].expand(ways.shape)
    extinction = sigma * read(points.density, start, border=False)[..., 0]
    step = torch.minimum(torch.full_like(extinction, 1.0 / 128.0), THICKNESS / extinction.clamp(min=1e-6))
    travelled, tau, scaled = (torch.zeros_like(step) for _ in range(3))
    diffuse, single, once, emitted = (torch.zeros_like(step) for _ in range(4))
    number = points.lights.number.clamp(max=points.emission.shape[1] - 1)
    glowing = torch.nonzero(points.lights.family == 3).flatten()
    for _ in range(STEPS):
        place = start + (travelled + 0.5 * step)[..., None] * ways
        thickness = sigma * read(points.density, place, border=False)[..., 0]
        gained, albedo = thickness * step, albedo_at(place)
        kept = 1.0 - albedo * peak
        share = albedo * (1.0 - peak) / kept
        weight = torch.exp(-scaled) * -torch.expm1(-kept * gained) * share
        scattered, unscattered = source(place, ways, 0.5 * step)
        diffuse += weight * scattered
        single += weight * unscattered
        if len(glowing):
            inside = (place[glowing].abs().amax(dim=-1) < 0.5).float()
            glow = read(points.emission, place[glowing])
            pick = number[glowing].reshape(-1, *[1] * (glow.dim() - 1)).expand(*glow.shape[:-1], 1)
            glow = glow.gather(-1, pick)[..., 0] * inside * step[glowing]
            once[glowing] += glow * torch.exp(-tau[glowing] - 0.5 * gained[glowing])
            emitted[glowing] += glow * torch.exp(-scaled[glowing] - 0.5 * (kept * gained)[glowing])
        tau, scaled = tau + gained, scaled + kept * gained
        travelled = travelled + step
        thin = THICKNESS * (1.0 + tau) / thickness.clamp(min=1e-6)
        step = torch.minimum(step * GROWTH, torch.maximum(thin, step / GROWTH))
    sky = _environment(points, ways)
    once, emitted = once + sky * torch.exp(-tau), emitted + sky * torch.exp(-scaled)

    passed, passed_scaled = torch.exp(-depth), torch.exp(-beams.scale[:, None] * depth)
    forward = fluence * (passed_scaled - passed)
    cones = slice(0, 8)
    peak_light = (emitted - once).clamp(min=0.0)
    wide = g * abs(g)
    local_diffuse = source(at, omega)[0]
    terms = torch.stack(
        [
            local_diffuse,
            diffuse[..., cones].mean(dim=-1),
            diffuse[..., 8],
            single[..., cones].mean(dim=-1),
            single[..., 8],
            forward * phase(cosine, g) + peak_light[..., cones].mean(dim=-1),
            forward * phase(cosine, wide) + peak_light[..., 8],
        ],
        dim=-1,
    )
    base = terms.sum(dim=-1).clamp(min=1e-20)

    def ratio(values):
        return torch.log(values / base.reshape(*base.shape, *[1] * (values.dim() - 2)) + 1e-4)

    unscattered = fluence * passed * phase(cosine, g) + once[..., cones].mean(dim=-1)
    beam_depth = depth.clamp(max=60.0)
    is_beam = (points.lights.family < 2).float().reshape(-1, 1).expand(-1, count)
    phi = here[..., 0].clamp(min=1e-20)
    probe = 1.0 / 32.0
    probes = torch.stack([at + probe * omega, at - probe * omega, at + probe * towards, at - probe * towards], dim=2)
    around = read(fields[:, :1], probes)[..., 0].clamp(min=1e-20)
    densities = []
    level = points.density
    for number in range(6):
        level = torch.nn.functional.avg_pool3d(level, 2) if number else level
        densities.append(torch.log(sigma * read(level, at, border=True)[..., 0] + 1e-2))
    coarser = torch.nn.functional.avg_pool3d(points.density, 4)
    side = [
        torch.log(sigma * read(cells, start[:, :, cones] + reach * ways[:, :, cones], border=False)[..., 0] + 1e-2)
        for cells, reach in ((points.density, 0.012), (points.density, 0.03), (coarser, 0.1))
    ]
    behind = _column(points, at, -omega)
    ahead = _column(points, at, omega)
    total = torch.zeros_like(ahead)
    cells = len(fields[0, 0])
    lamp_free_path = torch.log(sigma * read(points.density, at, border=False)[..., 0] * distance + 1e-3)
    constants = [g, abs(g), math.log(1.0 - abs(g)), math.log(sigma)]
    inputs = [
        ratio(terms),
        ratio(diffuse[..., cones]),
        ratio(single[..., cones]),
        ratio(unscattered[..., None]),
        ratio(phi[..., None] / (4.0 * math.pi)),
        ratio((fluence * passed)[..., None] / (4.0 * math.pi)),
        ratio(here[..., 4:5] / (4.0 * math.pi)),
        torch.exp(-tau),
        torch.stack(densities, dim=-1),
        *side,
        torch.log(around / phi[..., None] + 1e-3),
        torch.stack(
            [
                (here[..., 1:4] * omega).sum(dim=-1) / phi,
                (here[..., 1:4] * towards).sum(dim=-1) / phi,
                here[..., 1:4].norm(dim=-1) / phi,
                cosine,
                torch.log(phase(cosine, g)),
                torch.log(phase(cosine, wide)),
                w,
                torch.sqrt((1.0 - w).clamp(min=0.0)),
                torch.log(1.0 - w * peak),
                mean_albedo[:, None].expand(-1, count),
                is_beam,
                is_beam * torch.exp(-beam_depth),
                is_beam * torch.exp(-0.334 * beam_depth),
                is_beam * torch.exp(-0.1 * beam_depth),
                torch.log1p(is_beam * beam_depth),
                torch.log1p(ahead),
                torch.log1p(behind),
                torch.exp(-ahead),
                torch.exp(-behind),
                1.0 / (1.0 + (distance * cells) ** 2),
                torch.log(distance),
                lamp_free_path,
                *(total + value for value in constants),
            ],
            dim=-1,
        ),
    ]
    inputs = torch.cat(inputs, dim=-1)
    return torch.nan_to_num(terms, 0.0, 0.0, 0.0), torch.nan_to_num(inputs, 0.0, 20.0, -20.0).clamp(-20.0, 20.0)


def _column(points: LitPoints, at: torch.Tensor, ways: torch.Tensor) -> torch.Tensor:
    """Optical depth (J, P) out of the cube; the same for every light."""
    one, way = at[:1], ways[:1]
    length, total = _exit(one, way), torch.zeros_like(at[:1, :, 0])
    for k in range(48):
        place = one + (length * (k + 0.5) / 48)[..., None] * way
        total += read(points.density, place, border=False)[..., 0]
    return (total * length * points.sigma / 48).expand(len(at), -1)
