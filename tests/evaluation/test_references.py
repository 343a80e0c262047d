# SPDX-License-Identifier: GPL-3.0-or-later
"""The shipped network against path-traced references, independent ones and our own."""

import numpy as np
import pytest

from benchmarks.fidelity import pictures, views
from evaluation.error import relative_bias, relative_rmse
from inference import Camera, Medium, Settings, Sun, render
from training.procedural.seeded_volume import cube_volume
from training.procedural.volumes import HELD_BACK, make_volume
from training.tracer.path_tracer import PinholeCamera, Sampling, Scene, trace_pixels

BIAS, RMSE = 0.10, 0.30


def check(layer, a, b, mask, folder):
    """Assert bias and error; write the pictures where that fails."""
    bias, rmse = relative_bias(layer.rgb, a, b, mask), relative_rmse(layer.rgb, a, b, mask)
    picture = folder / "ours-reference-error.png"
    pictures.picture({"ours": layer.rgb}, a, b).save(picture)
    # A bias counts where the reference's own noise cannot explain it.
    assert bias.low < BIAS and bias.high > -BIAS, f"bias {bias}, see {picture}"
    assert rmse.low < RMSE, f"relative RMSE {rmse}, see {picture}"


@pytest.mark.parametrize("key", ["cumulus-100-side-g0.857-chroma", "smoke-100-back-g0.857", "smoke-20-front-g0"])
def test_independent_references(key, tmp_path):
    (view,) = [view for view in views.independent_views() if view.name == key]
    layer = view.render(Settings(depth_samples=16))
    a, b = view.halves()
    mask = 0.5 * (a[..., 3] + b[..., 3]) > views.MASK_ALPHA
    np.testing.assert_allclose(layer.alpha[mask].mean(), 0.5 * (a + b)[..., 3][mask].mean(), rtol=0.01)
    check(layer, a[..., :3], b[..., :3], mask, tmp_path)


@pytest.mark.parametrize(
    "seed, sigma, g", [pytest.param(HELD_BACK[0], 60.0, 0.5, marks=pytest.mark.slow), (HELD_BACK[11], 150.0, 0.857)]
)
def test_volumes_that_no_training_has_seen(seed, sigma, g, tmp_path):
    density = make_volume(seed, 96).density
    albedo, sun, position = (1.0, 0.9, 0.6), np.array([0.6, 0.5, 0.62]), (1.1, 0.5, 1.2)
    sun /= np.linalg.norm(sun)
    view, medium = PinholeCamera(position, (0, 0, 0), (0, 1, 0), 40.0, 40), Medium(sigma, albedo, g)
    halves = [trace_pixels(Scene(density, sun), view, medium, Sampling(96, half)) for half in (1, 2)]
    a, b = (half.astype(np.float64) for half in halves)
    camera = Camera(views.look_at(position), resolution=(40, 40), fov=np.radians(40.0))
    layer = render([(cube_volume(density, "cloud"), medium)], [Sun(sun)], camera)
    mask = layer.alpha > views.MASK_ALPHA
    np.testing.assert_allclose(layer.alpha[mask].mean(), 0.5 * (a + b)[..., 3][mask].mean(), rtol=0.02)
    check(layer, a[..., :3], b[..., :3], mask, tmp_path)
