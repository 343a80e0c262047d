# SPDX-License-Identifier: GPL-3.0-or-later
"""Environments of their own: the package `mrpnn` as pip installs it, and everything without an onnxruntime."""

import os
import re
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np
import pytest

from tests.support.paths import ROOT

SITE = Path(sysconfig.get_path("purelib"))
# Tests that run once more without onnxruntime: those of what networks predict.
NAMED = [
    f"tests/inference/test_render.py::{name}"
    for name in (
        "test_light_is_linear_and_parallel_suns_add",
        "test_same_seed_same_image_for_any_number_of_threads",
        "test_a_region_is_cut_out_of_the_whole",
        "test_predictions_match_the_image",
        "test_multiple_scattering_vanishes_in_proportion_to_thin_media",
        "test_warnings_name_what_is_outside_the_trained_range",
    )
]


def run(arguments, site, folder, **options):
    """Python with no other packages than those of a folder, from a working folder."""
    environment = {
        "PATH": os.environ["PATH"],
        "HOME": str(folder),
        "PYTHONPATH": str(site),
        "BLENDER_USER_RESOURCES": str(folder / "blender"),
        "OMP_NUM_THREADS": "1",
    }
    return subprocess.run(
        [sys.executable, "-S", *map(str, arguments)], capture_output=True, text=True, env=environment, **options
    )


@pytest.fixture(scope="module")
def installed(tmp_path_factory):
    """Folder of packages: `mrpnn` as `pip install .` installs it, and numpy."""
    site = tmp_path_factory.mktemp("installed") / "site"
    command = ["pip", "install", "--quiet", "--disable-pip-version-check", "--no-index", "--no-deps"]
    subprocess.run(
        [sys.executable, "-m", *command, "--no-build-isolation", "--target", site, ROOT], check=True, cwd=site.parent
    )
    for name in ("numpy", "numpy.libs"):
        if (SITE / name).exists():
            (site / name).symlink_to(SITE / name)
    return site


@pytest.mark.slow
def test_the_readmes_example_runs_with_what_pip_installs(installed, tmp_path):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    (tmp_path / "example.py").write_text(
        f"{code}\nnp.savez('layer.npz', rgb=layer.rgb, kernels=layer.report.kernels)\n"
    )
    said = run([tmp_path / "example.py"], installed, tmp_path, cwd=tmp_path)
    assert said.returncode == 0, said.stdout + said.stderr
    found = np.load(tmp_path / "layer.npz")
    assert found["kernels"] != "numpy" and "(90, 160, 3)" in said.stdout
    # As in a clone, where onnxruntime runs the network.
    scope = {}
    exec(code.replace("from mrpnn", "from inference"), scope)
    layer = scope["layer"]
    assert 0.9 < layer.alpha.max() <= 1.0 and layer.multiple.sum() > 0.0
    np.testing.assert_allclose(found["rgb"], layer.rgb, rtol=0.0, atol=1e-4 * layer.rgb.max())


@pytest.mark.slow
def test_the_package_offers_what_inference_offers(installed, tmp_path):
    script = "import {0}; print(*sorted({0}.__all__)); print(*{0}.available_models())"
    said = run(["-c", script.format("mrpnn")], installed, tmp_path, cwd=tmp_path)
    # In a process of its own, since tests of this one may have registered other models.
    clone = subprocess.run([sys.executable, "-c", script.format("inference")], capture_output=True, text=True, cwd=ROOT)
    assert clone.returncode == 0 and said.stdout == clone.stdout, said.stdout + clone.stdout + said.stderr
    (notes,) = installed.glob("mrpnn-*.dist-info")
    assert "Requires-Dist: numpy" in (notes / "METADATA").read_text() and (notes / "licenses" / "LICENSE").is_file()
    assert not list(installed.rglob("*.c")) and len(list(installed.rglob("mrpnn_kernels.*"))) == 1


@pytest.fixture(params=["missing", "raises"])
def bare(request, tmp_path):
    """Folder of this environment's packages, with an onnxruntime that is missing or raises when it is imported."""
    site = tmp_path / "site"
    site.mkdir()
    for path in SITE.iterdir():
        if not path.name.startswith("onnxruntime"):
            (site / path.name).symlink_to(path)
    if request.param == "raises":
        (site / "onnxruntime").mkdir()
        (site / "onnxruntime" / "__init__.py").write_text("raise RuntimeError('this machine has no such thing')")
    return site


@pytest.mark.blender
@pytest.mark.slow
def test_the_demo_runs_without_onnxruntime(bare, tmp_path):
    out = tmp_path / "demo"
    size = ["--size", "48", "32", "--depth-samples", "1", "--samples", "1", "--scale", "50"]
    said = run(["-m", "benchmarks.demo", *size, "--out", out], bare, tmp_path, cwd=ROOT, timeout=300)
    assert said.returncode == 0, said.stdout + said.stderr
    assert {path.name for path in out.glob("*.png")} == {"cloud.png", "cloud-comparison.png"}


@pytest.mark.slow
def test_the_named_tests_pass_without_onnxruntime(bare, tmp_path):
    said = run(["-m", "pytest", "-q", *NAMED], bare, tmp_path, cwd=ROOT, timeout=600)
    assert said.returncode == 0, said.stdout[-3000:] + said.stderr[-2000:]
    assert f"{len(NAMED)} passed" in said.stdout
