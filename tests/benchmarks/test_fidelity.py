# SPDX-License-Identifier: GPL-3.0-or-later
"""The fidelity benchmark: its views, its figures for known errors, and a small run."""

import dataclasses
import hashlib

import numpy as np
import pytest
import torch

from benchmarks.fidelity import __main__ as fidelity
from benchmarks.fidelity import real_volumes, tables, views
from benchmarks.fidelity.measurements import Measurement
from benchmarks.fidelity.references import relative_variance
from benchmarks.support import pages
from evaluation.error import relative_bias
from inference.models import weights_file
from training import rpnn
from training.export import export, save
from training.networks import MRPNN
from training.procedural.volumes import HELD_BACK

RANGES = {"anisotropy_range": [-0.3, 0.95], "sigma_hat_range": [1, 2000]}


@pytest.fixture
def weights(tmp_path, monkeypatch):
    """An untrained network: its large errors do not matter here."""
    folder = tmp_path / "weights"
    folder.mkdir()
    torch.manual_seed(0)
    save(export(MRPNN(), RANGES), str(folder / "mrpnn-paper.onnx"))
    monkeypatch.setattr(weights_file, "WEIGHTS", folder)
    return folder


def test_views_use_validation_seeds_and_the_stated_light():
    made = views.procedural_views(8, 1, 16, None)
    assert len({view.name for view in made}) == len(made) == 42
    assert all(seed in HELD_BACK for seed in views.VOLUMES.values())
    for view in made + views.independent_views():
        towards_camera = float(view.sun @ view.position / np.linalg.norm(view.position))
        low, high = {"side": (-0.3, 0.3), "front": (0.6, 1.0), "back": (-1.0, -0.6)}[view.spec.light]
        assert low < towards_camera < high, view.name
    # Table 2 asks for every light with every albedo and anisotropy.
    specs = [view.spec for view in made]
    varied = {(spec.light, spec.albedo, spec.anisotropy) for spec in specs if spec.volume == views.VARIED[0]}
    assert len(varied) == len(views.LIGHTS) * (len(views.ALBEDOS) + len(views.ANISOTROPIES) - 1)


def test_variance_is_that_of_one_path():
    random = np.random.default_rng(0)
    samples, deviation = 16, 3.0
    a, b = 2.0 + deviation / np.sqrt(samples) * random.normal(size=(2, 200, 200, 3))
    mask = np.ones((200, 200), bool)
    assert relative_variance(a, b, mask, samples) == pytest.approx((deviation / 2.0) ** 2, rel=0.05)


@pytest.mark.slow
def test_references_are_traced_once(tmp_path):
    view = views.procedural_view(views.ViewSpec("cloud1", "side", size=8, samples=4), 32, tmp_path)
    halves = view.halves()
    (path,) = tmp_path.iterdir()
    made = path.stat().st_mtime_ns
    np.testing.assert_array_equal(view.halves(), halves)
    assert path.stat().st_mtime_ns == made
    assert halves.shape == (2, 8, 8, 4) and not np.array_equal(*halves)
    # Another medium is another reference.
    other = dataclasses.replace(view, spec=dataclasses.replace(view.spec, anisotropy=0.5))
    assert not np.array_equal(other.halves(), halves) and len(list(tmp_path.iterdir())) == 2


@pytest.mark.slow
def test_retraced_references_agree_with_independent_ones(tmp_path):
    """Two path tracers that share no code, on thin smoke, where few paths suffice."""
    [view] = [v for v in views.retraced_views(32, tmp_path) if v.name.startswith("smoke-20")]
    [independent] = [v for v in views.independent_views() if v.name + views.RETRACED == view.name]
    ours, theirs = view.halves().mean(axis=0), independent.halves()
    mask = theirs[..., 3].mean(axis=0) > views.MASK_ALPHA
    np.testing.assert_allclose(ours[mask, 3].mean(), theirs[:, mask, 3].mean(), rtol=5e-3)
    bias = relative_bias(ours[..., :3], *theirs[..., :3], mask)
    assert bias.low - 0.01 < 0.0 < bias.high + 0.01


@pytest.mark.slow
def test_a_run_leaves_figures_tables_and_pictures(weights, tmp_path):
    fidelity.main(
        [
            "--out",
            str(tmp_path / "out"),
            "--references",
            str(tmp_path / "references"),
            "--views",
            "procedural",
            "--models",
            "mrpnn-paper",
            "rpnn",
            "--match",
            "cloud1-side-g0.857",
            "--depth-samples",
            "2",
            "--size",
            "16",
            "--samples",
            "16",
            "--cells",
            "32",
        ]
    )
    path = tmp_path / "out" / "fidelity.csv"
    rows = pages.read_csv(path)
    (source,) = pages.csv_made_by(path)
    assert source.startswith("Weights `mrpnn-paper` ") and ", commit " in source
    assert source.endswith(" --size 16 --samples 16 --cells 32`.")
    checksum = hashlib.sha256((rpnn.WEIGHTS / "rpnn.onnx").read_bytes()).hexdigest()[:12]
    assert f"`rpnn` {checksum}," in source and f"`rpnn` {checksum}," in path.with_suffix(".md").read_text()
    # Two more albedos beside the usual view, which is all that RPNN knows.
    assert [row["system"] for row in rows] == ["mrpnn-paper", "rpnn", "mrpnn-paper", "mrpnn-paper"]
    assert all(float(row["rmse_low"]) <= float(row["rmse"]) <= float(row["rmse_high"]) for row in rows)
    assert len(list((tmp_path / "out").glob("*.png"))) == 3
    lines = (tmp_path / "out" / "fidelity.md").read_text().splitlines()
    (usual,) = [line.split(" | ") for line in lines if line.startswith("| cloud1 | ς = 1, 1, 1 |")]
    (varied,) = [line.split(" | ") for line in lines if line.startswith("| cloud1 | ς = 0.8, 0.9, 1 |")]
    assert "·" in usual[2] and "·" in usual[3] and "·" in varied[2] and varied[3] == "n/a"


def measurement(system, **facts):
    usual = dict(
        view="cloud-side",
        volume="cloud",
        light="side",
        sigma_hat=100.0,
        anisotropy=0.857,
        albedo=views.GREY,
        rmse=0.1,
        rmse_low=0.05,
        rmse_high=0.2,
        bias=0.0,
        bias_low=0.0,
        bias_high=0.0,
        paper=1.0,
        seconds=1.0,
        reference_seconds=1.0,
    )
    return Measurement(system=system, **{**usual, **facts})


def test_speedups_and_means_compare_the_same_views():
    """RPNN's and the path tracer's seconds over a model's; means over the views of both."""
    found = [
        measurement("mrpnn", seconds=2.0, reference_seconds=500.0, rmse=0.1),
        measurement("rpnn", seconds=60.0, reference_seconds=30.0, rmse=0.3),
        measurement("mrpnn", view="cloud-g0", anisotropy=0.0, rmse=0.5),
    ]
    text = tables.document(found, {}, "")
    assert "| cloud | side | 2 s · 30 × · 250 × | 60 s · 1 × · 0.5 × |" in text
    lines = [line.split(" | ")[:3] for line in text.splitlines() if line.startswith("| mrpnn")]
    assert lines == [["| mrpnn", "all it knows, 2", "0.300"], ["| mrpnn", "common to all, 1", "0.100"]]


def test_real_volumes_have_a_table_of_their_own():
    found = [
        measurement("mrpnn", view=f"torus-{light}-{g}", volume="torus", light=light, anisotropy=g, rmse=rmse, bias=bias)
        for light, g, rmse, bias in (("side", 0.857, 0.1, 0.04), ("back", 0.857, 0.3, -0.06), ("side", 0.0, 0.2, 0.05))
    ]
    text = tables.document(found, {}, "")
    assert "mrpnn: 0.200 on the mean, bias +1.0 %, within 5 % on 2 of 3 views" in text
    assert "| torus | 100 | 0.100 +4.0 % | 0.300 -6.0 % | 0.200 +5.0 % |" in text
    assert "| torus | side |" not in text and "Table 2" not in text


def test_real_volumes_are_complete_and_centred_in_their_cubes():
    made, absent = real_volumes.real_views(8, 1, None)
    # The plume may not be copied into the repository.
    assert {path.name for path in absent} <= {"pbrt_plume_0065.vdb"}
    assert len({view.name for view in made}) == len(made) == 90 - 18 * len(absent)
    for name in {view.spec.volume for view in made}:
        density = real_volumes.real_density(name)
        assert density.max() == 1.0 and density.min() == 0.0 and len(set(density.shape)) == 1, name
        low, high = (ends(np.nonzero(density), axis=1) for ends in (np.min, np.max))
        assert np.all(low >= 1) and np.all(high <= len(density) - 2), name
        # Within a voxel of the middle, and the longest side fills the cube.
        assert np.all(np.abs(low + high - (len(density) - 1)) <= 2) and (high - low).max() >= 0.85 * len(density), name
