# SPDX-License-Identifier: GPL-3.0-or-later
"""The baselines: what they neglect, and the closed form in a homogeneous slab."""

import numpy as np
import pytest

from inference import Camera, Medium, Settings, Sun, Volume, available_models, render
from inference.network.baselines import OCTAVES, SINGLE, register_baselines
from inference.scene.phase_function import henyey_greenstein

CELLS = 32


@pytest.fixture
def slab():
    """A wide box of optical depth 1.5, seen and lit from straight above: arguments of `render`."""
    matrix = np.diag([4.0 / CELLS, 4.0 / CELLS, 1.0 / CELLS, 1.0])
    matrix[:3, 3] = -2.0 + 2.0 / CELLS, -2.0 + 2.0 / CELLS, -0.5 + 0.5 / CELLS
    volume = Volume(np.ones((CELLS,) * 3, np.float32), matrix)
    camera = np.eye(4)
    camera[2, 3] = 3.0
    register_baselines()
    return (
        [(volume, Medium(1.5, 0.8, 0.6))],
        [Sun((0.0, 0.0, 1.0))],
        Camera(camera, "orthographic", resolution=(4, 4), ortho_scale=0.5),
    )


def test_single_scattering_is_the_layers_own(slab):
    layer = render(*slab, Settings(model=SINGLE, depth_samples=1))
    assert (layer.multiple == 0.0).all() and (layer.single > 0.0).all()
    assert np.array_equal(layer.single, render(*slab, Settings(model=OCTAVES)).single)


def test_octaves_integrate_dimmer_and_less_attenuated_single_scattering(slab):
    layer = render(*slab, Settings(model=OCTAVES, depth_samples=64))
    # Light comes down and goes back up; octave n: 1/2^n p(g/2^n) times the integral of exp(-t) exp(-t/2^n).
    expected = sum(
        0.5**n * henyey_greenstein(-1.0, 0.6 * 0.5**n) * (1 - np.exp(-1.5 * (1 + 0.5**n))) / (1 + 0.5**n)
        for n in range(1, 8)
    )
    assert layer.multiple.mean() == pytest.approx(0.8 * expected, rel=0.02)


def test_baselines_are_not_listed_among_the_networks(slab):
    assert not {SINGLE, OCTAVES} & set(available_models())
