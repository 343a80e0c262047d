# SPDX-License-Identifier: GPL-3.0-or-later
"""Execution providers of onnxruntime: the chosen one where available and correct, else the CPU and a warning."""

import os
import platform
import subprocess
import sys

import numpy as np
import pytest

from inference import Camera, Medium, Settings, Sun, Volume, render
from inference.models import weights_file
from inference.network import provider
from inference.scene import SceneError
from tests.support.paths import ROOT

onnxruntime = pytest.importorskip("onnxruntime")
CONTENT = (weights_file.WEIGHTS / "mrpnn.onnx").read_bytes()
MISSING = [name for name, known in provider.PROVIDERS.items() if known not in onnxruntime.get_available_providers()]
OPENVINO = "onnxruntime-openvino==1.24.1"


def picture(**changed):
    axis = np.linspace(-1, 1, 16)
    density = np.clip(1 - np.sqrt(sum(a**2 for a in np.meshgrid(axis, axis, axis))), 0, None).astype(np.float32)
    eye = np.eye(4)
    eye[:3, 3] = 8.0, 8.0, 60.0
    return render(
        [(Volume(density, np.eye(4), "ball"), Medium(0.5, 0.9, 0.5))],
        [Sun((0.4, 0.3, 0.8))],
        Camera(eye, resolution=(24, 24), fov=0.3),
        Settings(2, **changed),
    )


def test_without_the_provider_the_cpu_renders_with_a_warning():
    expected = picture()
    assert expected.report.provider == "CPU" and expected.report.warnings == []
    found = picture(provider=MISSING[0])
    np.testing.assert_array_equal(found.rgb, expected.rgb)
    assert found.report.provider == "CPU"
    (warning,) = found.report.warnings
    assert f"instead of {MISSING[0]}" in warning and onnxruntime.__version__ in warning


@pytest.fixture(scope="session")
def openvino():
    """A folder with the OpenVINO build of onnxruntime, which cannot share an environment with the other."""
    folder = ROOT / "build" / OPENVINO
    if not folder.exists():
        unfinished = folder.with_suffix(".part")
        subprocess.run(
            [
                sys.executable,
                "-m",
                "pip",
                "install",
                "--quiet",
                "--disable-pip-version-check",
                "--no-deps",
                "--upgrade",
                "--target",
                unfinished,
                OPENVINO,
            ],
            check=True,
        )
        unfinished.rename(folder)
    return folder


@pytest.mark.slow
@pytest.mark.skipif((sys.platform, platform.machine()) != ("linux", "x86_64"), reason="no OpenVINO for this machine")
def test_another_provider_gives_the_cpus_picture(openvino, tmp_path):
    """In a separate process, since onnxruntime is loaded here already."""
    picture_file = tmp_path / "picture.npy"
    script = (
        "import sys, numpy; from tests.inference.network.test_provider import picture\n"
        "found = picture(provider='OPENVINO')\n"
        "assert (found.report.provider, found.report.warnings) == ('OPENVINO', []), found.report\n"
        "numpy.save(sys.argv[1], found.rgb)"
    )
    done = subprocess.run(
        [sys.executable, "-c", script, picture_file],
        cwd=ROOT,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": os.pathsep.join((str(ROOT), str(openvino)))},
    )
    assert done.returncode == 0, done.stderr
    expected, found = picture().rgb, np.load(picture_file)
    assert np.abs(found - expected).max() < provider.TOLERANCE * expected.max()


def test_a_provider_that_differs_from_the_cpu_is_not_used():
    """Another network stands in for a provider with wrong results."""
    processor = provider.open_session(CONTENT, "CPU").session
    assert provider._difference(processor, processor) == ""
    wrong = onnxruntime.InferenceSession(_scaled(CONTENT, 1.02), providers=["CPUExecutionProvider"])
    assert "differ from the processor's by" in provider._difference(wrong, processor)
    nearly = onnxruntime.InferenceSession(_scaled(CONTENT, 1.001), providers=["CPUExecutionProvider"])
    assert provider._difference(nearly, processor) == ""


def _scaled(content, factor):
    """The network with its radiance scaled by a factor."""
    import onnx

    model = onnx.load_from_string(content)
    (node,) = [node for node in model.graph.node if "radiance" in node.output]
    node.output[list(node.output).index("radiance")] = "before"
    model.graph.initializer.append(onnx.numpy_helper.from_array(np.float32(factor), "factor"))
    model.graph.node.append(onnx.helper.make_node("Mul", ["before", "factor"], ["radiance"]))
    return model.SerializeToString()


def test_an_unknown_provider_is_refused_by_name():
    with pytest.raises(SceneError, match="no provider called 'ABACUS'; there are: CPU, CUDA"):
        picture(provider="ABACUS")
