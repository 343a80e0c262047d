# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions of the light around a lamp, against photons followed from it."""

from dataclasses import replace

import numpy as np
import pytest

from inference import AreaLight, PointLight, SpotLight
from inference.network.lamp_nearby import (
    LampNearby,
    NearbyPoints,
    NearbyTransport,
    NearLamp,
    SoftStart,
)
from inference.scene.phase_function import henyey_greenstein, reduced_anisotropy
from inference.transport.scattered_fluence import FluenceLattice
from tests.reference.lamp_nearby import LampAtPoints, Ways, radiance, straight_light, ways_to
from tests.support.kernels import VARIANTS, variant

ANISOTROPY, ALBEDO = 0.857, 0.9
#: Places of matter on the way through even smoke.
EVEN = (np.arange(4) + 0.5) / 4


@pytest.mark.parametrize("order", [4, 6, 10, 16])
@pytest.mark.parametrize("least, most", [(0.2, 1.0), (1.0, 3.0)])
def test_directions_around_a_lamp_are_those_of_traced_photons(order, least, most):
    """Moments of the light around the straight way from the lamp, in even smoke without an end."""
    depth = np.linspace(least, most, 40)
    found = np.mean([_moment(order, tau, EVEN) for tau in depth]) * (most - least)
    assert found == pytest.approx(_traced(order, least, most), rel=0.15)


def test_light_of_a_far_lamp_turns_as_in_a_beam():
    """Goudsmit and Saunderson's moments."""
    for order in (5, 9):
        small = ANISOTROPY**order - (1.0 - ANISOTROPY**2) * reduced_anisotropy(ANISOTROPY) ** order
        expected = np.exp(-(1.0 - ALBEDO * small) * 1.5) - np.exp(-1.5)
        assert _moment(order, 1.5, np.ones(4)) == pytest.approx(expected, rel=1e-3)


def test_light_turns_where_the_matter_is():
    """A slab in one quarter of the way: light that turns there arrives by that part of the angle."""
    for quarter in range(4):
        density = np.zeros((66, 66, 66, 1), np.float32)
        density[1 + 16 * quarter : 17 + 16 * quarter] = 2.0
        lattice, box = FluenceLattice(density), (np.full(3, -0.5), np.full(3, 0.5))
        nearby = LampNearby(1.0, {}, (), ANISOTROPY, lattice, box, 0.01)
        # Outside of the box there is none, wherever the lamp stands.
        for lamp in (np.array([-0.5, 0.1, 0.2]), np.array([-2.5, 0.1, 0.2])):
            way = ways_to(nearby, lamp, np.array([[0.5, 0.1, 0.2]]))
            part = ((quarter + 0.5) / 4 - 0.5 - lamp[0]) / (0.5 - lamp[0])
            assert way.means(ANISOTROPY, 6)[5] == pytest.approx(ANISOTROPY ** (5 * part))


def _moment(order, depth, parts):
    """Of light of irradiance 1 that has turned by small angles alone."""
    light = LampAtPoints(
        np.array([[0.0, 0.0, 1.0]]), np.ones(1), *np.full((2, 1), depth), Ways(parts[:, None], np.full((4, 1), 0.25))
    )
    return straight_light(light, ANISOTROPY, ALBEDO)[order][0]


def _traced(order, least, most, photons=150_000):
    """Sum over collisions after the first, per photon that has turned by small angles alone, at optical distances."""
    random, g, found = np.random.default_rng(4), ANISOTROPY, 0.0
    along = random.normal(size=(photons, 3))
    along /= np.linalg.norm(along, axis=1)[:, None]
    place, legendre = np.zeros((photons, 3)), np.polynomial.legendre.Legendre.basis(order)
    for number in range(60):
        place = place + along * random.exponential(size=(len(place), 1))
        distance = np.linalg.norm(place, axis=1)
        if number:
            some = (distance >= least) & (distance < most)
            found += ALBEDO**number * legendre((place * along).sum(axis=1)[some] / distance[some]).sum()
        near = distance < 3.0 * most + 3.0
        place, along = place[near], along[near]
        u, angle = random.uniform(-1.0, 1.0, len(along)), random.uniform(0.0, 2.0 * np.pi, len(along))
        cosine = ((1.0 + g * g - ((1.0 - g * g) / (1.0 + g * u)) ** 2) / (2.0 * g))[:, None]
        wide = (1.0 - g * g) * henyey_greenstein(cosine, reduced_anisotropy(g)) / henyey_greenstein(cosine, g)
        small = random.random(len(along)) >= wide[:, 0]
        place, along, angle, cosine = place[small], along[small], angle[small], cosine[small]
        across = np.cross(along, np.where(np.abs(along[:, :1]) > 0.5, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]]))
        across /= np.linalg.norm(across, axis=1)[:, None]
        aside = np.cos(angle)[:, None] * across + np.sin(angle)[:, None] * np.cross(along, across)
        along = cosine * along + np.sqrt(np.maximum(1.0 - cosine**2, 0.0)) * aside
        along /= np.linalg.norm(along, axis=1)[:, None]
    return found / photons


def lamp_of(random, light, start=None):
    """A lamp, and its light on cells over a factor."""
    cells = 0.2 * random.normal(size=(66, 66, 66, 20)).astype(np.float32)
    cells[..., 0] = 1.0 + np.abs(cells[..., :16]).sum(axis=-1)
    cells[..., 16] = np.abs(cells[..., 16:]).sum(axis=-1)
    emitters = light.emitters(np.full(3, -0.5), np.full(3, 0.5))
    return NearLamp(emitters, float(random.uniform(0.2, 0.8)), np.array(light.centre), start), (cells, 0.3)


@pytest.mark.parametrize("anisotropy", [0.857, 0.3, 0.97, -0.5])
@pytest.mark.parametrize("lights", ["one", "three"])
@pytest.mark.parametrize("number", VARIANTS)
def test_compiled_light_equals_its_twin(anisotropy, lights, number, monkeypatch):
    monkeypatch.setattr("inference.network.lamp_nearby.JOINED", 0.0)
    random = np.random.default_rng(12)
    matrix = np.eye(4)
    matrix[:3, 3] = -0.1, 0.0, 0.8
    lamps = [
        lamp_of(random, PointLight((0.1, 0.2, 0.45), 1.0, 0.05), SoftStart(0.05, 0.4, np.linspace(0.0, 0.5, 64))),
        lamp_of(random, SpotLight((0.1, -0.2, 0.45), (0.0, 0.3, -1.0), 1.0, 0.9)),
        lamp_of(random, AreaLight(matrix, "square", 0.2, 1.0)),
    ][: 1 if lights == "one" else 3]
    # A little beside the sum of the lamps, of which some is left.
    parts = [np.float32(1.01 * lamp.power * scale) * cells[..., :4] for lamp, (cells, scale) in lamps]
    together = np.sum(parts, axis=0, dtype=np.float32) if len(lamps) > 1 else None
    transport = NearbyTransport([cells for _, cells in lamps], together)
    density = random.random((66, 66, 66, 1)).astype(np.float32)
    nearby = LampNearby(
        share=1.0,
        lights={ALBEDO: transport},
        lamps=[lamp for lamp, _ in lamps],
        anisotropy=anisotropy,
        density=FluenceLattice(density),
        extent=(np.full(3, -0.5), np.full(3, 0.5)),
        radius=0.004,
    )
    positions, omega = random.uniform(-0.5, 0.5, (203, 3)), random.normal(size=(203, 3))
    omega /= np.linalg.norm(omega, axis=1)[:, None]
    points = NearbyPoints(positions, positions, omega, random.uniform(0.0, 9.0, (len(lamps), 203)).astype(np.float32))
    expected = radiance(nearby, ALBEDO, points)
    assert np.all(expected > 0.0)
    with variant(number):
        found = nearby.radiance(ALBEDO, points)
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-4)


def test_lamps_that_give_little_are_told_with_all_others():
    """About as if each were told apart."""
    random = np.random.default_rng(3)
    pairs = [lamp_of(random, PointLight(tuple(place), 1.0)) for place in random.uniform(-0.4, 0.4, (5, 3))]
    lamps = [replace(lamp, power=power) for (lamp, _), power in zip(pairs, (1.0, 0.8, 2e-3, 1e-3, 5e-4))]
    cells = [cells for _, cells in pairs]
    together = sum(np.float32(lamp.power * scale) * values[..., :4] for lamp, (values, scale) in zip(lamps, cells))
    density, box = FluenceLattice(np.ones((66, 66, 66, 1), np.float32)), (np.full(3, -0.5), np.full(3, 0.5))
    nearby = LampNearby(1.0, {ALBEDO: NearbyTransport(cells, together)}, lamps, 0.3, density, box, 0.004)
    positions, omega = random.uniform(-0.5, 0.5, (203, 3)), random.normal(size=(203, 3))
    omega /= np.linalg.norm(omega, axis=1)[:, None]
    points = NearbyPoints(positions, positions, omega, np.ones((5, 203), np.float32))
    found, expected = nearby.radiance(ALBEDO, points), radiance(nearby, ALBEDO, points)
    assert 0.0 < np.abs(found - expected).max() < 0.01 * expected.mean()
