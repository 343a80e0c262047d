# SPDX-License-Identifier: GPL-3.0-or-later
"""Light that has scattered by a wide angle once."""

import numpy as np
import pytest

from inference.source_terms.forward_peak import forward_peak
from inference.source_terms.wide_light import FACE, Lobe, scattered_wide, wide_light
from inference.transport.ordinates import ORDINATE_WEIGHTS, ORDINATES
from inference.transport.radiance_sweep import sweep_radiance
from tests.support.kernels import VARIANTS, variant

SHAPE = 14, 9, 11


def some_lobes(random):
    along = random.normal(size=(3, *SHAPE)).astype(np.float32)
    along /= np.linalg.norm(along, axis=0)
    amounts = random.random((2, *SHAPE)).astype(np.float32)
    return [Lobe(amounts[0], along, 1.0), Lobe(amounts[1], -along, random.random(SHAPE).astype(np.float32))]


def some_depth(random):
    """With cells that hold nothing, near others and far from them."""
    depth = random.random(SHAPE).astype(np.float32)
    depth[6:9], depth[3] = 0.0, 0.0
    return depth


@pytest.mark.parametrize("anisotropy", [0.0, 0.3, 0.857, -0.6])
def test_variants_for_different_processors_agree(anisotropy):
    random, peak, found = np.random.default_rng(1), forward_peak(anisotropy), []
    depth, lobes = some_depth(random), some_lobes(random)
    for number in VARIANTS:
        with variant(number):
            found.append(wide_light(depth, 0.8, lobes, peak))
    assert found[0].shape == (16, *SHAPE) and not found[0][:, 7].any()
    for other in found[1:]:
        np.testing.assert_allclose(other, found[0], atol=2e-6 * found[0].max())


def test_isotropic_light_travels_as_emitted_light():
    """Fluence and flux of the sweep for emission along the same directions."""
    random, cell = np.random.default_rng(2), 0.1
    depth, lobes = some_depth(random), some_lobes(random)
    emission = 0.8 * depth / cell * (lobes[0].amount + lobes[1].amount) / (4.0 * np.pi)
    fluence, flux = sweep_radiance(depth.astype(float) / cell, emission, cell, FACE)
    found = wide_light(depth, 0.8, lobes, forward_peak(0.0))
    held = depth > 0.0
    np.testing.assert_allclose(found[0][held], fluence[held], rtol=1e-3)
    np.testing.assert_allclose(found[1:4, held], flux[:, held], atol=2e-3 * fluence.max())


@pytest.mark.parametrize("anisotropy", [0.3, 0.857])
def test_deep_in_even_fog_light_is_absorbed_where_it_scatters(anisotropy):
    """Fluence of opaque cells: what of the lobes scatters by a wide angle, over the delta-scaled extinction."""
    random, peak = np.random.default_rng(3), forward_peak(anisotropy)
    lobes = some_lobes(random)
    found = wide_light(np.full(SHAPE, 2e3, np.float32), 0.8, lobes, peak)
    expected = 0.8 * peak.share / (1.0 - anisotropy**2) * (lobes[0].amount + lobes[1].amount)
    np.testing.assert_allclose(found[0], expected, rtol=0.02)


@pytest.mark.parametrize("anisotropy", [0.0, 0.857, -0.6])
def test_few_directions_scatter_as_much(anisotropy):
    lobes, peak = some_lobes(np.random.default_rng(4)), forward_peak(anisotropy)
    found = scattered_wide(lobes, peak, -ORDINATES, ORDINATE_WEIGHTS)
    expected = peak.share / (1.0 - anisotropy**2) * (lobes[0].amount + lobes[1].amount)
    np.testing.assert_allclose(4.0 * np.pi * np.tensordot(ORDINATE_WEIGHTS, found, 1), expected, rtol=1e-4)
