# SPDX-License-Identifier: GPL-3.0-or-later
"""The tracer on a GPU: as much light as on the CPU, of every kind."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest
from numba import cuda

from inference import PointLight, SpotLight
from training.tracer.density_grid import prepare
from training.tracer.gpu_paths import available, trace_on_gpu
from training.tracer.light_paths import AlbedoField, Lights, LitMedium, Paths, PathScene, trace_paths
from training.tracer.scene import Sampling

#: Python alone follows few paths.
VERTICES, SIMULATED = 3, 64


def _paths(cells: int, vertices: int) -> list[Paths]:
    """Of two media in one scene: an even albedo, and one that varies."""
    random = np.random.default_rng(54)
    density, emission = random.random((cells,) * 3), random.random((cells,) * 3 + (2,))
    lamps = (
        PointLight(np.array([0.1, 0.0, -0.1]), 4.0 * np.pi, 0.05, soft_falloff=True),
        PointLight(np.array([0.8, 0.0, 0.2]), 4.0 * np.pi),
        SpotLight(np.array([0.0, 0.7, 0.0]), np.array([0.0, -1.0, 0.0]), 4.0 * np.pi, 1.5, 0.5),
    )
    suns = np.array([[0.0, 0.0, 1.0], [0.6, 0.8, 0.0]])
    scene = PathScene.of(prepare(density), Lights(suns, lamps, random.random((2, 8, 16)).astype(np.float32), emission))
    positions, directions = random.uniform(-0.4, 0.4, (vertices, 3)), random.normal(size=(vertices, 3))
    albedos = (
        AlbedoField(np.array([1.0, 0.7]), np.array([1.0, 0.7])),
        AlbedoField(np.array([0.9, 0.2]), np.array([0.6, 1.0]), random.random((cells,) * 3).astype(np.float32)),
    )
    media = LitMedium(4.0, 0.6, albedos[0]), LitMedium(12.0, -0.2, albedos[1])
    return [scene.paths(medium, (positions, directions)) for medium in media]


def _parts(trace, paths: list[Paths], count: int, seeds: int) -> np.ndarray:
    """Light in independent parts (seeds, values): the mean over vertices, of each light, channel and medium."""
    parts = []
    for seed in range(seeds):
        found = trace([(one, Sampling(count, 1000 * seed + number)) for number, one in enumerate(paths)])
        parts.append(np.concatenate([values.mean(axis=0).ravel() for pair in found for values in pair]))
    return np.array(parts, np.float64)


def _assert_equal_within_noise(found: np.ndarray, expected: np.ndarray) -> None:
    """Of parts (seeds, values) each."""
    error = np.sqrt(sum(parts.var(axis=0, ddof=1) / len(parts) for parts in (found, expected)))
    deviation = (found.mean(axis=0) - expected.mean(axis=0)) / np.maximum(error, 1e-12)
    assert np.all(expected.mean(axis=0) > 0.0)
    # The light of one path is shared by all values, so that their deviations are not independent.
    assert np.sqrt((deviation**2).mean()) < 2.0 and np.abs(deviation).max() < 6.0


def _on_cpu(jobs):
    return [trace_paths(*job) for job in jobs]


@pytest.mark.skipif(not available() or bool(os.environ.get("NUMBA_ENABLE_CUDASIM")), reason="needs an NVIDIA GPU")
def test_a_gpu_finds_the_light_of_the_cpu():
    paths = _paths(40, 64)
    _assert_equal_within_noise(_parts(trace_on_gpu, paths, 512, 12), _parts(_on_cpu, paths, 256, 12))
    jobs = [(one, Sampling(100, 3)) for one in paths]
    for first, second in zip(trace_on_gpu(jobs), trace_on_gpu(jobs)):
        np.testing.assert_array_equal(first[0], second[0])


@pytest.mark.slow
def test_the_kernel_finds_the_light_of_the_cpu_in_the_simulator():
    """Without a GPU numba runs kernels in Python: the same light from few paths, and none where there are no points."""
    environment = {**os.environ, "NUMBA_ENABLE_CUDASIM": "1", "NUMBA_DISABLE_JIT": "1"}
    command = [sys.executable, "-W", "ignore", "-m", "tests.training.test_gpu_paths"]
    run = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    _assert_equal_within_noise(np.array(json.loads(run.stdout)), _parts(_on_cpu, _paths(12, VERTICES), 512, 8))


def _simulate() -> None:
    assert type(cuda).__name__ == "module" and available()
    paths = _paths(12, VERTICES)
    ((radiance, once),) = trace_on_gpu([(_paths(12, 0)[0], Sampling(8, 1))])
    assert radiance.shape == (0, 9, 2) and once.shape == (0, 4)
    print(json.dumps(_parts(trace_on_gpu, paths, SIMULATED, 8).tolist()))


if __name__ == "__main__":
    _simulate()
