# SPDX-License-Identifier: GPL-3.0-or-later
"""The forward peak of a phase function and the rest of it."""

import numpy as np
import pytest

from inference.scene.phase_function import henyey_greenstein
from inference.source_terms.forward_peak import forward_peak

# The table's cosines.
COSINES = np.linspace(-1.0, 1.0, 513)


def integral(values):
    """Over the sphere, of values at COSINES."""
    return 2.0 * np.pi * (0.5 * (values[1:] + values[:-1]) * np.diff(COSINES)).sum()


@pytest.mark.parametrize("anisotropy", [0.3, 0.7, 0.857, 0.95])
def test_wide_angles_are_a_part_of_the_phase_function(anisotropy):
    peak = forward_peak(anisotropy)
    wide = peak.table[-1] * (1.0 - anisotropy**2)
    whole = henyey_greenstein(COSINES, anisotropy)
    assert np.all(wide <= whole * (1.0 + 1e-6))
    # Nearly all that goes backwards, and little of what goes straight on.
    assert wide[0] == pytest.approx(whole[0], rel=1e-5) and wide[-1] < 0.8 * whole[-1]
    # Delta scaling's share, less what it would scatter backwards beyond the phase function.
    assert 0.85 * (1.0 - anisotropy**2) < peak.share < 1.0 - anisotropy**2
    assert integral(wide) == pytest.approx(peak.share, rel=1e-3)


@pytest.mark.parametrize("anisotropy", [0.0, 0.02, -0.4, -0.9])
def test_without_a_peak_all_angles_are_wide(anisotropy):
    peak = forward_peak(anisotropy)
    assert peak.empty and peak.share == pytest.approx(1.0)
    expected = henyey_greenstein(COSINES, max(anisotropy, -0.7)) / (1.0 - anisotropy**2)
    np.testing.assert_allclose(peak.table[-1], expected, rtol=1e-5)


@pytest.mark.parametrize("straightness", [0.0, 0.25, 0.75])
def test_light_from_around_a_direction_scatters_as_if_from_each(straightness):
    """Directions drawn from Henyey and Greenstein's distribution, and the phase function for each of them."""
    peak, random = forward_peak(0.857), np.random.default_rng(3)
    u, angle = random.random(400_000), random.uniform(0.0, 2.0 * np.pi, 400_000)
    r = max(straightness, 1e-6)
    around = (1.0 + r * r - ((1.0 - r * r) / (1.0 - r + 2.0 * r * u)) ** 2) / (2.0 * r)
    row = peak.table[round(straightness * (len(peak.table) - 1))]
    for column in (0, 128, 256, 400, 512):
        cosine = COSINES[column]
        turned = cosine * around + np.sqrt((1.0 - cosine**2) * np.maximum(1.0 - around**2, 0.0)) * np.cos(angle)
        assert row[column] == pytest.approx(np.interp(turned, COSINES, peak.table[-1]).mean(), rel=0.01)
