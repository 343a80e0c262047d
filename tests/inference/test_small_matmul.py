# SPDX-License-Identifier: GPL-3.0-or-later
"""Linear algebra and quadrature on the calling thread against numpy's."""

import contextlib
import re
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from inference import (
    AreaLight,
    Camera,
    Environment,
    Medium,
    PointLight,
    RenderCache,
    Settings,
    SpotLight,
    Surface,
    bake,
    predict_multiple,
    render,
)
from inference.numerics.quadrature import legendre_nodes
from inference.numerics.small_matmul import (
    MATRIX_WORK,
    VECTOR_WORK,
    affine_inverse,
    inverse,
    product,
    product_of_columns,
    solve_positive,
)
from tests.support.paths import ROOT
from tests.support.volumes import SUN, camera, cloud


@pytest.mark.parametrize("kind", [np.float32, np.float64])
@pytest.mark.parametrize(
    "a, b",
    [
        ((8,), (8,)),
        ((8,), (8, 3)),
        ((5, 8), (8,)),
        ((3, VECTOR_WORK // 4, 8), (8,)),
        ((1025, 8), (8,)),
        ((2, 40_000), (40_000,)),
        ((70_000, 3), (3, 5)),
        ((70_000, 3), (3, 1)),
        ((7, 500), (500, 400)),
        ((100, 3), (3, 0)),
        ((0, 3), (3, 2)),
        ((4, 0), (0, 2)),
        ((2, 0, 6), (6,)),
        ((26, 9000), (9000, 3)),
        ((1, 9000), (9000, 3)),
    ],
)
def test_products_equal_those_of_numpy(a, b, kind):
    """Longer and shorter than a block, and empty."""
    random = np.random.default_rng(3)
    a, b = random.random(a).astype(kind), random.random(b).astype(kind)
    found, wanted = product(a, b), a @ b
    assert found.shape == wanted.shape and found.dtype == wanted.dtype
    np.testing.assert_allclose(found, wanted, rtol=1e-5 if kind == np.float32 else 1e-12)


@pytest.mark.parametrize("columns", [1, 400, 262_144])
def test_products_of_columns_equal_those_of_numpy(columns):
    random = np.random.default_rng(6)
    a, b = random.random((16, 26)), random.random((26, columns))
    np.testing.assert_allclose(product_of_columns(a, b), a @ b, rtol=1e-12)


def test_a_row_does_not_depend_on_the_others():
    random = np.random.default_rng(4)
    a, b = random.random((3 * MATRIX_WORK // 24, 8)), random.random((8, 3))
    np.testing.assert_array_equal(product(a[:1000], b), product(a, b)[:1000])


@pytest.mark.parametrize(
    "a, b",
    [
        ((70_000, 3), (3, 1)),
        ((70_000, 3), (3, 3)),
        ((70_000, 8), (8,)),
        ((2000, 400), (400, 90)),
        ((26, 9000), (9000, 3)),
    ],
)
def test_no_other_thread_works(a, b):
    a, b = np.ones(a, np.float32), np.ones(b, np.float32)
    product(a, b)
    # Threads that spin after earlier products go to sleep.
    time.sleep(0.2)
    process, thread = time.process_time(), time.thread_time()
    while time.thread_time() < thread + 0.3:
        product(a, b)
    assert time.process_time() - process < 1.1 * (time.thread_time() - thread)


def test_inverses_equal_those_of_numpy():
    random = np.random.default_rng(5)
    for _ in range(20):
        matrix = np.eye(4)
        matrix[:3] = random.normal(size=(3, 4)) * random.uniform(1e-3, 1e3)
        np.testing.assert_allclose(affine_inverse(matrix), np.linalg.inv(matrix), rtol=1e-9)
        np.testing.assert_allclose(inverse(matrix[:3, :3]), np.linalg.inv(matrix[:3, :3]), rtol=1e-9)


def test_solutions_equal_those_of_numpy():
    random = np.random.default_rng(7)
    factors, right = random.normal(size=(200, 17, 17)), random.normal(size=(200, 17))
    matrices = factors @ factors.transpose(0, 2, 1) + 0.1 * np.eye(17)
    expected = np.linalg.solve(matrices, right[..., None])[..., 0]
    np.testing.assert_allclose(solve_positive(matrices.transpose(1, 2, 0), right.T).T, expected, rtol=1e-9)


@pytest.mark.parametrize("count", [1, 2, 3, 4, 7, 10, 16, 33, 64, 128])
def test_quadrature_is_exact_for_polynomials(count):
    """As Gauss and Legendre's rule is, up to a degree of 2 n - 1; numpy's nodes are the same."""
    nodes, weights = legendre_nodes(count)
    for power in range(0, 2 * count, 2):
        assert (weights * nodes**power).sum() == pytest.approx(2.0 / (power + 1), rel=1e-12)
    np.testing.assert_array_equal(nodes, -nodes[::-1])
    np.testing.assert_allclose(nodes, np.polynomial.legendre.leggauss(count)[0], atol=1e-15)


LAMP = np.eye(4)
LAMP[:3, 3] = 0.2, 0.1, 1.5
TILE = np.array([[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]])
# 20 x 20 tiles.
FLOOR = np.concatenate([0.4 * (TILE + [x, y, 0]) for x, y in np.ndindex(20, 20)]) - [4.0, 4.0, 0.7]
SKY = Environment(np.linspace(0.2, 1.0, 64)[:, None, None] * np.ones((64, 128, 3)) * [0.5, 0.7, 1.0])
LIGHTS = {
    "sun": [SUN],
    "point light": [PointLight((0.2, 0.1, 1.5), 50.0, 0.02)],
    "spot light": [SpotLight((0.2, 0.1, 1.5), (0.0, 0.0, -1.0), 50.0, 0.8, 0.2, 0.02)],
    "area light": [AreaLight(LAMP, "square", 0.5, 50.0)],
    "point light inside": [PointLight((0.0, 0.1, 0.0), 50.0, 0.02)],
    "sky": [SKY],
    "sun and sky": [SUN, SKY],
}


@pytest.mark.slow
@pytest.mark.parametrize("lights", LIGHTS.values(), ids=LIGHTS)
def test_renders_do_not_wake_the_threads_of_blas(lights):
    check_threads_of_blas(lights, True, (64, 64))


@pytest.mark.slow(seconds=30)
def test_bakes_do_not_wake_the_threads_of_blas():
    both, every = LIGHTS["sun and sky"], [*LIGHTS["sun and sky"], *LIGHTS["point light inside"]]
    # Few voxels are predicted each; light of many is interpolated.
    for voxels, albedo, lights, view in (
        (12, (0.9, 0.8, 0.7), every, camera()),
        (36, 0.9, both, camera()),
        (36, 0.9, [SUN], None),
    ):
        volumes = [(cloud(voxels=voxels), Medium(40.0, albedo, 0.8))]
        alone(lambda: bake(volumes, lights, view, Settings(threads=1)))


@pytest.mark.parametrize("light", [SUN, *LIGHTS["point light"], SKY], ids=["sun", "lamp", "sky"])
def test_predictions_at_points_do_not_wake_the_threads_of_blas(light):
    points = np.random.default_rng(8).uniform(-0.3, 0.3, (5000, 3))
    alone(lambda: predict_multiple(cloud(), Medium(40.0, 0.9, 0.8), light, points, np.full((5000, 3), 3**-0.5)))


@pytest.mark.slow
def test_large_renders_do_not_wake_the_threads_of_blas():
    check_threads_of_blas([*LIGHTS["sun and sky"], *LIGHTS["point light inside"]], False, (480, 480))


def test_what_is_shipped_calls_no_function_that_wakes_them_for_small_matrices():
    """OpenBLAS shares even the inverse of a (3, 3) matrix."""
    shipped = [
        path
        for name in ("inference", "evaluation", "mrpnn_addon", "operators", "panels")
        for path in (ROOT / name).rglob("*.py")
    ]
    assert len(shipped) > 100
    assert not [path for path in shipped if re.search(r"linalg\.(inv|pinv|lstsq)\b|tensordot", path.read_text())]


def check_threads_of_blas(lights, ground, resolution):
    matrix = np.eye(4)
    matrix[2, 3] = 3.0
    view = Camera(matrix, resolution=resolution)
    surfaces = [Surface(FLOOR, "floor", reflectance=(0.6, 0.5, 0.4))] if ground else []
    volumes = [(cloud(), Medium(40.0, 0.9, 0.8))]
    alone(lambda: render(volumes, lights, view, Settings(threads=1), cache=RenderCache(), surfaces=surfaces))


def alone(work):
    """Check that no thread works but Python's own: those of BLAS would spin beside them, 0.1 s after each product."""
    work()
    time.sleep(0.3)
    before = time_of_others()
    work()
    # Not of threads of this work that are about to end.
    after = {name: ticks for name, ticks in time_of_others().items() if name in before}
    spent = sum(ticks - before[name] for name, ticks in after.items())
    assert spent <= 3, f"{spent} ticks of threads that Python does not know"


def time_of_others():
    """Ticks of the processor that each thread of this process has taken which Python does not know."""
    known = {thread.native_id for thread in threading.enumerate()}
    ticks = {}
    for thread in Path("/proc/self/task").iterdir():
        if int(thread.name) not in known:
            # It may end before it is read.
            with contextlib.suppress(FileNotFoundError, ProcessLookupError):
                fields = (thread / "stat").read_text().rsplit(")", 1)[1].split()
                ticks[thread.name] = int(fields[11]) + int(fields[12])
    return ticks
