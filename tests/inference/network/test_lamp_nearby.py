# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions of the light around a lamp, against photons followed from it."""

import numpy as np
import pytest

from inference.network.lamp_nearby import LampAtPoints, LampNearby, Way
from inference.scene.phase_function import henyey_greenstein, reduced_anisotropy
from inference.transport.scattered_fluence import FluenceLattice
from tests.reference.lamp_nearby import radiance, straight_light
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
        nearby = LampNearby(1.0, {}, ANISOTROPY, lattice, box)
        # Outside of the box there is none, wherever the lamp stands.
        for lamp in (np.array([-0.5, 0.1, 0.2]), np.array([-2.5, 0.1, 0.2])):
            way = nearby.way(lamp, np.array([[0.5, 0.1, 0.2]]))
            part = ((quarter + 0.5) / 4 - 0.5 - lamp[0]) / (0.5 - lamp[0])
            assert way.means(ANISOTROPY, 6)[5] == pytest.approx(ANISOTROPY ** (5 * part))


def _moment(order, depth, parts):
    """Of light of irradiance 1 that has turned by small angles alone."""
    light = LampAtPoints(
        np.array([[0.0, 0.0, 1.0]]), np.ones(1), *np.full((2, 1), depth), Way(parts[:, None], np.full((4, 1), 0.25))
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


@pytest.mark.parametrize("anisotropy", [0.857, 0.3, 0.97, -0.5])
@pytest.mark.parametrize("number", VARIANTS)
def test_compiled_light_equals_its_twin(anisotropy, number):
    random = np.random.default_rng(12)
    cells = 0.2 * random.normal(size=(66, 66, 66, 20)).astype(np.float32)
    cells[..., 0] = 1.0 + np.abs(cells[..., :16]).sum(axis=-1)
    cells[..., 16] = np.abs(cells[..., 16:]).sum(axis=-1)
    density = random.random((66, 66, 66, 1)).astype(np.float32)
    box = np.full(3, -0.5), np.full(3, 0.5)
    nearby = LampNearby(1.0, {ALBEDO: (FluenceLattice(cells), 0.3)}, anisotropy, FluenceLattice(density), box)
    points, omega = random.uniform(-0.5, 0.5, (203, 3)), random.normal(size=(203, 3))
    omega /= np.linalg.norm(omega, axis=1)[:, None]
    light = nearby.lit(
        np.array([0.1, 0.2, 0.45]), points, random.uniform(0.0, 20.0, 203), random.uniform(0.0, 9.0, 203)
    )
    # Beside a cone, where there is no light of the lamp's own.
    light.irradiance[::5] = 0.0
    expected = radiance(nearby, ALBEDO, points, omega, light)
    assert np.all(expected > 0.0)
    with variant(number):
        found = nearby.radiance(ALBEDO, points, omega, light)
    np.testing.assert_allclose(found, expected, rtol=2e-3, atol=2e-4)
