# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that has scattered within the forward peak alone, by photons."""

import numpy as np
import pytest

from inference.runtime.cancellation import Cancelled, CancelToken
from inference.source_terms.forward_peak import forward_peak
from inference.source_terms.peak_photons import LampInCells, peak_light
from tests.support.kernels import VARIANTS, variant

ALBEDO = 0.9


def lamp_of(depth, light, place, closed=None):
    return LampInCells(depth.astype(np.float32), light.astype(np.float32), np.array(place), closed, ALBEDO)


def random_lamp(random, closed=False):
    shape = 13, 9, 11
    surfaces = (random.random((3, *shape)) < 0.05).astype(np.uint8) if closed else None
    return lamp_of(random.random(shape), random.random(shape), (3.2, 4.1, 14.0), surfaces)


@pytest.mark.parametrize("closed", [False, True])
@pytest.mark.parametrize("anisotropy", [0.1, 0.857, 0.98])
def test_variants_for_different_processors_agree(anisotropy, closed):
    lamp, peak, found = random_lamp(np.random.default_rng(5), closed), forward_peak(anisotropy), []
    for number in VARIANTS:
        with variant(number):
            found.append(peak_light(lamp, peak, photons=4000))
    assert found[0][0].max() > 0.0
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], atol=1e-5 * found[0][0].max())


@pytest.mark.parametrize("anisotropy", [0.5, 0.857])
def test_power_is_conserved(anisotropy):
    """Collisions in a box that no photon leaves: a geometric series of those that turn by a small angle each."""
    depth, light = np.full((24, 24, 24), 4.0), np.zeros((24, 24, 24))
    light[11:13, 11:13, 11:13] = 0.5
    peak = forward_peak(anisotropy)
    fluence, flux = np.split(peak_light(lamp_of(depth, light, (12.0, 12.0, 12.0)), peak), [1])
    start, stay = ALBEDO * (depth * light).sum(), 1.0 - peak.share
    assert (depth * fluence[0]).sum() == pytest.approx(start * stay / (1.0 - ALBEDO * stay), rel=0.02)
    assert np.all(np.sqrt((flux**2).sum(axis=0)) <= fluence[0] * (1.0 + 1e-5) + 1e-12)


def test_a_beam_spreads_by_small_angles():
    """Its mean cosine in a row of cells that it is cast along: no less than that of one collision within the peak."""
    depth, light, peak = np.full((3, 3, 60), 1e-3), np.zeros((3, 3, 60)), forward_peak(0.857)
    light[1, 1, 0] = 1.0
    fluence, _, _, along = peak_light(lamp_of(depth, light, (1.5, 1.5, -1e6)), peak)
    nodes, weights = np.polynomial.legendre.leggauss(400)
    g, wide = 0.857, np.interp(nodes, np.linspace(-1.0, 1.0, 513), peak.table[-1]) * (1.0 - 0.857**2)
    narrow = weights * ((1.0 - g * g) / (4.0 * np.pi * (1.0 + g * g - 2.0 * g * nodes) ** 1.5) - wide)
    assert along.sum() / fluence.sum() > (narrow * nodes).sum() / narrow.sum()
    assert 2.0 * np.pi * narrow.sum() == pytest.approx(1.0 - peak.share, rel=1e-3)


def test_no_photon_passes_a_surface():
    """A wall along the faces between two slices of cells, one of which the lamp lights."""
    depth, light, closed = np.full((10, 10, 10), 0.5), np.zeros((10, 10, 10)), np.zeros((3, 10, 10, 10), np.uint8)
    light[:5] = 1.0
    closed[0, 4] = 1
    lamp = lamp_of(depth, light, (-5.0, 5.0, 5.0), closed)
    fluence = peak_light(lamp, forward_peak(0.857), photons=3000)[0]
    assert fluence[:5].min() > 0.0 and not fluence[5:].any()
    open_ = peak_light(lamp_of(depth, light, (-5.0, 5.0, 5.0)), forward_peak(0.857), photons=3000)[0]
    assert open_[5:].any()


def test_more_photons_tell_the_same():
    """Noise of the default number, where it was not smoothed away, against twenty times as many."""
    depth, light = np.full((32, 32, 32), 0.3), np.zeros((32, 32, 32))
    distance = np.sqrt(((np.indices(light.shape) + 0.5 - 16.0) ** 2).sum(axis=0))
    light[...] = np.exp(-0.3 * distance) / (4.0 * np.pi * distance**2)
    lamp, peak = lamp_of(depth, light, (16.0, 16.0, 16.0)), forward_peak(0.857)
    few, many = (peak_light(lamp, peak, photons=number)[0].sum(axis=2) for number in (100_000, 2_000_000))
    assert np.abs(few / many - 1.0)[4:-4, 4:-4].mean() < 0.03
    assert few.sum() == pytest.approx(many.sum(), rel=0.003)


def test_light_is_linear_and_the_same_every_time():
    random, peak = np.random.default_rng(6), forward_peak(0.857)
    lamp = random_lamp(random)
    twice = LampInCells(lamp.depth, 2.0 * lamp.light, lamp.place, None, ALBEDO)
    found = peak_light(lamp, peak)
    assert np.array_equal(found, peak_light(lamp, peak))
    np.testing.assert_allclose(peak_light(twice, peak), 2.0 * found, rtol=1e-5)


def test_dark_and_backward_light_is_none():
    lamp = random_lamp(np.random.default_rng(7))
    dark = LampInCells(lamp.depth, np.zeros_like(lamp.light), lamp.place, None, ALBEDO)
    assert not peak_light(dark, forward_peak(0.857)).any()
    assert not peak_light(lamp, forward_peak(-0.5)).any()


def test_photons_stop_when_cancelled():
    with pytest.raises(Cancelled):
        peak_light(random_lamp(np.random.default_rng(8)), forward_peak(0.857), CancelToken(lambda: True))
