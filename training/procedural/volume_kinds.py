# SPDX-License-Identifier: GPL-3.0-or-later
"""Procedural density fields: clouds, smoke, solids and others, as functions of position.

Each entry of KINDS takes a numpy Generator, draws its parameters and returns a function from points float32 (M, 3) to
density float32 (M,), >= 0, in a frame of its own: axis 2 is up, and the density lies within about 1.2 of the origin.
"""

import numpy as np

from .fluid import simulate_smoke
from .noise import Fractal, Swirl, sample_grid
from .shapes import BOX, CYLINDER, ball_union, constructive_solid, random_rotation


def _log_uniform(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _ramp(x, low, high):
    """Smoothstep from 0 below `low` to 1 above `high`."""
    t = np.clip((x - low) / (high - low), 0, 1)
    return t * t * (3 - 2 * t)


def _interior(rng):
    """Density inside a solid: constant, or uneven with one of three strengths."""
    strength = rng.choice([0.0, 0.3, 0.8, 1.5])
    noise = Fractal(rng, rng.uniform(1, 4), 4, rng.uniform(0.4, 0.7))
    if strength == 0.0:
        return lambda p: np.float32(1.0)
    return lambda p: np.exp(strength * np.minimum(noise(p), 2.5))


def _cumulus_balls(rng):
    """Centres and radii of balls with smaller balls on them, based on the plane z = 0."""
    centres, radii = [], []
    spread = rng.uniform(0.1, 0.8, 2)
    for _ in range(rng.integers(2, 8)):
        radius = rng.uniform(0.18, 0.42)
        place = np.append(rng.uniform(-1, 1, 2) * spread, rng.uniform(0.0, 0.6))
        centres.append(place)
        radii.append(radius)
        for _ in range(rng.integers(2, 8)):
            direction = rng.standard_normal(3)
            direction[2] = abs(direction[2]) * rng.uniform(0.3, 1.5)
            direction /= np.linalg.norm(direction)
            centres.append(place + direction * radius)
            radii.append(radius * rng.uniform(0.3, 0.7))
    return np.array(centres, np.float32), np.array(radii, np.float32)


def cumulus(rng):
    centres, radii = _cumulus_balls(rng)
    centres[:, 2] -= 0.4
    base = -0.4 + rng.uniform(-0.15, 0.1)
    lumps = Fractal(rng, rng.uniform(1.0, 2.5), rng.integers(4, 7), rng.uniform(0.45, 0.6), billow=rng.random() < 0.7)
    height = rng.uniform(0.04, 0.14)
    edge = _log_uniform(rng, 0.01, 0.35)
    blend = np.float32(rng.uniform(0.02, 0.15))
    wisps = Swirl(rng, rng.uniform(1, 3), 3)
    drift = rng.choice([0.0, rng.uniform(0.02, 0.2)])
    inside = _interior(rng)

    def density(points):
        if drift:
            points = wisps(points, drift)
        distance = ball_union(points, centres, radii, blend)
        distance = np.maximum(distance, 0.7 * (base - points[:, 2]))
        out = np.zeros(len(points), np.float32)
        near = np.flatnonzero(distance < 3.5 * height)
        inner = points[near]
        out[near] = _ramp(-(distance[near] + height * lumps(inner)), 0, edge) * inside(inner)
        return out

    return density


def wisps(rng):
    stretch = np.array([1.0, rng.uniform(1.2, 4), rng.uniform(2, 7)], np.float32)
    noise = Fractal(rng, rng.uniform(0.8, 2.0), 5, rng.uniform(0.5, 0.7))
    swirl = Swirl(rng, rng.uniform(0.7, 2.0), 3, 0.6)
    drift = rng.uniform(0.2, 0.9)
    level, width = rng.uniform(0.3, 1.2), rng.uniform(0.5, 1.5)
    ridged = rng.random() < 0.5
    half = np.array([1.0, rng.uniform(0.3, 1.0), rng.uniform(0.1, 0.6)], np.float32)

    def density(points):
        envelope = _ramp(1 - np.linalg.norm(points / half, axis=1), 0, 0.6)
        out = np.zeros(len(points), np.float32)
        near = np.flatnonzero(envelope > 0)
        moved = swirl(points[near], drift)
        n = noise(moved * stretch)
        n = 1.6 - 3 * np.abs(n) if ridged else n
        out[near] = envelope[near] * _ramp(n, level, level + width)
        return out

    return density


def plume(rng):
    """A column that widens, thins and curls as it rises, torn by a curl-noise flow."""
    foot, growth = rng.uniform(0.04, 0.2), rng.uniform(0.05, 0.5)
    thinning = rng.uniform(0.3, 2.5)
    swirl = Swirl(rng, rng.uniform(0.7, 1.6), 3, rng.uniform(0.45, 0.65))
    fine = Swirl(rng, rng.uniform(3, 6), 2, 0.6, steps=4)
    violence = rng.uniform(0.15, 0.65)
    noise = Fractal(rng, rng.uniform(1.5, 4), 5, 0.6)
    contrast = rng.uniform(0.3, 1.6)
    bend = rng.uniform(-0.5, 0.5, 2)
    hollow = rng.choice([0.0, 0.7])
    top = rng.uniform(0.6, 1.1)

    def density(points):
        height = np.clip(points[:, 2] + 1, 0, 2.2)
        out = np.zeros(len(points), np.float32)
        reach = 3.0 * (foot + growth * height) + 0.9 * violence * np.minimum(height, 1)
        axis = points[:, :2] - bend * (height * height * 0.4)[:, None].astype(np.float32)
        near = np.flatnonzero((np.linalg.norm(axis, axis=1) < reach) & (np.abs(points[:, 2]) < 1.3))
        lift = height[near]
        moved = swirl(points[near], violence * lift**1.3 * 0.6)
        moved = fine(moved, 0.06 * violence * np.minimum(lift * 2, 1))
        lift = np.clip(moved[:, 2] + 1, 0, 2.2)
        across = np.linalg.norm(moved[:, :2] - bend * (lift * lift * 0.4)[:, None], axis=1)
        across = across / (foot + growth * lift)
        profile = np.exp(-1.5 * across**2) * (1 - hollow * np.exp(-6 * across**2))
        peak = (foot / (foot + growth * lift)) ** thinning
        ends = _ramp(moved[:, 2], -1.0, -0.95) * _ramp(top - moved[:, 2], 0, 0.4)
        body = profile * peak * ends * np.exp(contrast * np.minimum(noise(moved), 2.5))
        out[near] = body
        return out

    return density


def simulation(rng):
    grid = simulate_smoke(rng, cells=int(rng.integers(28, 39)), steps=int(rng.integers(30, 50)))
    size = 2.0 / grid.shape[2]
    low = np.array([-0.5, -0.5, -1.0])
    fine = Swirl(rng, rng.uniform(6, 10), 2, 0.6, steps=3)
    detail = rng.uniform(0.0, 0.03)

    def density(points):
        out = np.zeros(len(points), np.float32)
        near = np.flatnonzero((np.abs(points[:, :2]).max(axis=1) < 0.5) & (np.abs(points[:, 2]) < 1.0))
        out[near] = sample_grid(fine(points[near], detail), grid, low, size)
        return out

    return density


def puff(rng):
    """A ball of smoke, stirred."""
    swirl = Swirl(rng, rng.uniform(0.5, 1.5), 3, rng.uniform(0.45, 0.7))
    drift = rng.uniform(0.2, 0.7)
    noise = Fractal(rng, rng.uniform(1, 3), 5, 0.6)
    contrast, edge = rng.uniform(0, 2), rng.uniform(0.03, 0.5)
    half = np.array([rng.uniform(0.3, 0.7), rng.uniform(0.3, 0.7), rng.uniform(0.3, 0.7)], np.float32)

    def density(points):
        moved = swirl(points, drift)
        inside = _ramp(1 - np.linalg.norm(moved / half, axis=1), 0, edge)
        return inside * np.exp(contrast * np.minimum(noise(moved), 2.5))

    return density


def stratus(rng):
    thickness = rng.uniform(0.05, 0.3)
    cover = Fractal(rng, rng.uniform(0.7, 2.5), 5, rng.uniform(0.45, 0.65), billow=rng.random() < 0.4)
    waves = Fractal(rng, rng.uniform(0.5, 1.5), 2)
    gap, soft = rng.uniform(-1.2, 0.6), rng.uniform(0.3, 1.2)
    layers = rng.integers(1, 4)
    heights = rng.uniform(-0.6, 0.6, layers) * (layers > 1)
    half = np.array([1.0, rng.uniform(0.4, 1.0)], np.float32)

    squash = rng.uniform(0.4, 1.5)
    border = rng.choice([0.02, 0.3])

    def density(points):
        n = cover(points * np.array([1, 1, squash], np.float32))
        z = points[:, 2] + 0.12 * waves(points * np.array([1, 1, 0.2], np.float32))
        profile = sum(_ramp(1 - np.abs(z - h) / thickness, 0, 0.7) for h in heights)
        window = _ramp(1 - np.abs(points[:, :2] / half).max(axis=1), 0, border)
        return profile * window * _ramp(n, gap, gap + soft)

    return density


def _solids(rng, count, spread, low, high):
    """Random solids: kinds, centres, frames, half sizes."""
    upright = rng.random() < 0.4
    frames = [np.eye(3) if upright else random_rotation(rng) for _ in range(count)]
    return (
        rng.integers(BOX, CYLINDER + 1, count),
        rng.uniform(-spread, spread, (count, 3)).astype(np.float32),
        np.array(frames, np.float32),
        np.exp(rng.uniform(np.log(low), np.log(high), (count, 3))).astype(np.float32),
    )


def model(rng):
    """Hard-edged solids cut from one another, full or hollow."""
    count = int(rng.integers(2, 9))
    solids = _solids(rng, count, 0.5, 0.12, 0.6)
    removed = rng.random(count) < 0.3
    removed[0] = False
    inside = _interior(rng)
    edge = _log_uniform(rng, 0.005, 0.1)
    shell = rng.choice([0.0, rng.uniform(0.02, 0.08)], p=[0.7, 0.3])
    bumps = Fractal(rng, rng.uniform(1.5, 4), 4, 0.5)
    rough = rng.choice([0.0, rng.uniform(0.01, 0.06)])

    def density(points):
        distance = constructive_solid(points, *solids, removed)
        if rough:
            distance += rough * bumps(points)
        if shell:
            distance = np.abs(distance + shell) - shell
        return _ramp(-distance, 0, edge) * inside(points)

    return density


def homogeneous(rng):
    kinds, centres, frames, sizes = _solids(rng, 1, 0.01, 0.25, 0.8)
    removed = np.zeros(1, bool)
    return lambda points: (constructive_solid(points, kinds, centres, frames, sizes, removed) < 0).astype(np.float32)


def blobs(rng):
    """Sums of Gaussians with a linear gradient."""
    count = int(rng.integers(1, 7))
    centres = rng.uniform(-0.5, 0.5, (count, 3)).astype(np.float32) * (count > 1)
    frames = [(random_rotation(rng) / rng.uniform(0.08, 0.4, (3, 1))).astype(np.float32) for _ in range(count)]
    weights = np.exp(rng.uniform(-2, 0, count)).astype(np.float32)
    slope = rng.uniform(-0.6, 0.6, 3).astype(np.float32)

    def density(points):
        total = np.zeros(len(points), np.float32)
        for centre, frame, weight in zip(centres, frames, weights):
            total += weight * np.exp(-0.5 * (((points - centre) @ frame.T) ** 2).sum(axis=1))
        return total * np.clip(1 + points @ slope, 0, None)

    return density


def pieces(rng):
    """Fragments with empty space between them."""
    count = int(rng.integers(6, 22))
    solids = _solids(rng, count, rng.uniform(0.6, 0.9), 0.04, 0.2)
    rough = rng.uniform(0.0, 0.06)
    bumps = Fractal(rng, rng.uniform(2, 5), 4, 0.55, billow=True)
    edge = _log_uniform(rng, 0.01, 0.12)
    uneven = Fractal(rng, 0.6, 1)
    strength = rng.uniform(0, 1.5)
    removed = np.zeros(count, bool)

    def density(points):
        distance = constructive_solid(points, *solids, removed)
        out = np.zeros(len(points), np.float32)
        near = np.flatnonzero(distance < 0.2)
        inner = points[near]
        out[near] = _ramp(-(distance[near] + rough * bumps(inner)), 0, edge) * np.exp(strength * uneven(inner))
        return out

    return density


def sheets(rng):
    """Thin curtains: the neighbourhood of a noise field's level set, or of planes, folded."""
    swirl = Swirl(rng, rng.uniform(0.5, 1.2), 3, 0.6)
    drift = rng.uniform(0.0, 0.6)
    noise = Fractal(rng, rng.uniform(0.3, 0.8), 1)
    flat = rng.random() < 0.5
    spacing, width = rng.uniform(0.5, 1.5), rng.uniform(0.015, 0.08)
    texture = Fractal(rng, rng.uniform(2, 5), 4, 0.6)
    contrast = rng.uniform(0, 1.5)

    def density(points):
        moved = swirl(points, drift)
        if flat:
            level = (moved[:, 2] + 0.5 * spacing) % spacing - 0.5 * spacing
        else:
            level = 0.35 * noise(moved)
        envelope = _ramp(1 - np.linalg.norm(points, axis=1), 0, 0.4)
        return np.exp(-((level / width) ** 2)) * envelope * np.exp(contrast * np.minimum(texture(moved), 2))

    return density


def nebula(rng):
    """Log-normal noise filling much of the cube."""
    noise = Fractal(rng, rng.uniform(0.4, 1.5), 6, rng.uniform(0.4, 0.7), billow=rng.random() < 0.3)
    contrast = rng.uniform(0.5, 2.5)
    swirl = Swirl(rng, rng.uniform(0.6, 1.5), 2)
    drift = rng.uniform(0, 0.4)
    boxed, border = rng.random() < 0.4, rng.uniform(0.05, 0.6)

    def density(points):
        size = np.abs(points).max(axis=1) if boxed else np.linalg.norm(points, axis=1)
        out = np.zeros(len(points), np.float32)
        near = np.flatnonzero(size < 1)
        inner = points[near]
        out[near] = _ramp(1 - size[near], 0, border) * np.exp(contrast * np.minimum(noise(swirl(inner, drift)), 2.5))
        return out

    return density


def trail(rng):
    """A winding, widening and dissolving trail."""
    count = 60
    heading = np.cumsum(rng.standard_normal((count, 3)) * rng.uniform(0.05, 0.35), axis=0) + rng.standard_normal(3)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    centres = np.cumsum(heading, axis=0)
    centres -= (centres.max(axis=0) + centres.min(axis=0)) / 2
    centres *= 0.9 / np.abs(centres).max()
    widths = np.linspace(rng.uniform(0.02, 0.06), rng.uniform(0.06, 0.25), count)
    centres, widths = centres.astype(np.float32), widths.astype(np.float32)
    swirl = Swirl(rng, rng.uniform(1, 2.5), 3, 0.6)
    drift = rng.uniform(0.03, 0.35)
    texture = Fractal(rng, rng.uniform(2, 5), 5, 0.6)
    contrast, edge = rng.uniform(0.2, 1.6), rng.uniform(0.02, 0.15)

    def density(points):
        out = np.zeros(len(points), np.float32)
        near = np.flatnonzero(ball_union(points, centres, widths, np.float32(0.03)) < 0.4 * drift + edge)
        moved = swirl(points[near], drift)
        distance = ball_union(moved, centres, widths, np.float32(0.03))
        out[near] = _ramp(-distance, 0, edge) * np.exp(contrast * np.minimum(texture(moved), 2.5))
        return out

    return density


#: Share of each kind among the seeds.
KINDS = {
    cumulus: 0.20,
    simulation: 0.18,
    plume: 0.12,
    puff: 0.06,
    wisps: 0.07,
    stratus: 0.06,
    model: 0.08,
    blobs: 0.05,
    homogeneous: 0.03,
    pieces: 0.05,
    sheets: 0.03,
    nebula: 0.04,
    trail: 0.03,
}
