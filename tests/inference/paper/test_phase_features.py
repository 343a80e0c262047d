# SPDX-License-Identifier: GPL-3.0-or-later
"""Phase function and its integral over cones, against numerical integration."""

import numpy as np
import pytest

from inference.features.stencil import LOW_POINTS, frames
from inference.paper.phase_features import PhaseFeatures, cone_half_angles, cumulative_phase
from inference.scene.phase_function import PhaseFunction, henyey_greenstein
from training.data.stencil import load_stencil

GS = (-0.3, 0.0, 0.5, 0.857, 0.95)


@pytest.mark.parametrize("g", GS)
def test_integrates_to_one_with_mean_cosine_g(g):
    z, w = np.polynomial.legendre.leggauss(400)
    p = henyey_greenstein(z, g)
    assert 2 * np.pi * (w * p).sum() == pytest.approx(1.0, abs=1e-9)
    assert 2 * np.pi * (w * p * z).sum() == pytest.approx(g, abs=1e-9)


@pytest.mark.parametrize("g", GS)
@pytest.mark.parametrize("half_angle", [0.3, 0.9, 1.5])
@pytest.mark.parametrize("angle", [0.0, 0.4, 1.6, 3.0])
def test_cone_against_numerical_integration_of_eq_3(g, half_angle, angle):
    # Directions inside the cone around z; the light arrives at `angle` from its axis.
    z, w = np.polynomial.legendre.leggauss(400)
    low = np.cos(half_angle)
    z, w = low + (z + 1) * (1 - low) / 2, w * (1 - low) / 2
    phi = (np.arange(400) + 0.5) * 2 * np.pi / 400
    cosine = np.sqrt(1 - z * z)[:, None] * np.cos(phi) * np.sin(angle) + z[:, None] * np.cos(angle)
    expected = (henyey_greenstein(cosine, g) * w[:, None]).sum() * 2 * np.pi / 400
    assert cumulative_phase(np.cos(angle), half_angle, g) == pytest.approx(expected, rel=1e-4, abs=1e-6)


@pytest.mark.parametrize("g", GS)
def test_a_cone_of_the_whole_sphere_integrates_to_one(g):
    np.testing.assert_allclose(cumulative_phase(np.linspace(-1, 1, 9), np.pi, g), 1.0, atol=1e-6)


def test_cone_of_a_cell():
    # A cell of 1/256 seen from one edge length away: sin(c/2) = 1/2 of 1.
    assert cone_half_angles(np.array([1 / 256]), np.array([0]))[0] == pytest.approx(np.arcsin(0.5))
    assert cone_half_angles(np.array([0.1 / 256]), np.array([0]))[0] == pytest.approx(np.pi)


@pytest.mark.parametrize("g", [0.0, 0.857])
def test_features_against_directions_in_space(g):
    """P of every point from world directions, without the table's use of the stencil's frame."""
    stencil = load_stencil()
    table = PhaseFeatures(stencil, g)
    random = np.random.default_rng(5)
    omega, sun = random.normal(size=(2, 3))
    omega, sun = omega / np.linalg.norm(omega), sun / np.linalg.norm(sun)
    rotation = frames(omega[None], sun)[0]
    points = np.concatenate([stencil.low @ rotation.T, stencil.high[:, None] * sun])
    distance = np.linalg.norm(points, axis=1)
    v = points / np.maximum(distance, 1e-12)[:, None]
    half_angle = cone_half_angles(distance, stencil.mips)
    expected = np.log1p(cumulative_phase(v @ omega, half_angle, g) * cumulative_phase(v @ sun, half_angle, g))
    expected[0] = np.log1p(henyey_greenstein(omega @ sun, g))
    result = table(np.array([np.arccos(omega @ sun)]))[0]
    np.testing.assert_allclose(result, expected, atol=2e-4)
    assert len(expected) - LOW_POINTS == 32


@pytest.mark.parametrize(
    "lobe",
    [
        ("henyey_greenstein", (-0.4,)),
        ("draine", (0.0, 1.0)),
        ("draine", (0.6, 3.0)),
        ("draine", (0.9, 20.0)),
        ("fournier_forand", (1.33, 0.1)),
        ("fournier_forand", (1.2, 0.05)),
    ],
    ids=str,
)
def test_every_phase_function_integrates_to_one_and_has_its_mean_cosine(lobe):
    """Gauss-Legendre quadrature in log(1 - cos), which resolves the forward peak."""
    x, weight = np.polynomial.legendre.leggauss(1000)
    lack = 2.0 * 10.0 ** (-7.0 + 7.0 * x)
    weight = weight * lack * 7.0 * np.log(10.0)
    phase = PhaseFunction(((1.0, *lobe),))
    values = 2.0 * np.pi * weight * phase(1.0 - lack)
    assert values.sum() == pytest.approx(1.0, abs=3e-3)
    assert (values * (1.0 - lack)).sum() == pytest.approx(phase.mean_cosine(), abs=3e-3)


def test_mixtures_add_up():
    first, second = PhaseFunction(((1.0, "draine", (0.5, 1.0)),)), PhaseFunction(((1.0, "henyey_greenstein", (0.2,)),))
    both = PhaseFunction.mixed({first: 3.0, second: 1.0})
    cosine = np.linspace(-1.0, 1.0, 11)
    np.testing.assert_allclose(both(cosine), 0.75 * first(cosine) + 0.25 * second(cosine))
    assert both.mean_cosine() == pytest.approx(0.75 * first.mean_cosine() + 0.25 * second.mean_cosine())
    assert PhaseFunction.mixed({both: 2.0, first: 1.0}).lobes[0][0] == pytest.approx((2.0 * 0.75 + 1.0) / 3.0)
