# SPDX-License-Identifier: GPL-3.0-or-later
"""ONNX files evaluated without onnxruntime, against onnxruntime."""

import numpy as np
import onnxruntime
import pytest

from inference.models.weights_file import WEIGHTS
from inference.onnx.model_file import MalformedFile, read_model
from inference.onnx.operators import CACHED, NEW_MEMORY, OPERATORS
from inference.onnx.products import Layer
from inference.onnx.session import Session
from tests.support.kernels import VARIANTS, variant
from tests.support.marches import random_density

FILES = sorted(WEIGHTS.rglob("*.onnx"))
# Sizes of the free axes of inputs. Of points, more than a tile of a kernel holds and a remainder.
SIZES = {"N": 212, "V": 37, "A": 3, "C": 3}


def inputs(session: onnxruntime.InferenceSession, seed: int) -> dict[str, np.ndarray]:
    """Values of the magnitude of 1, or of any below it."""
    random, made = np.random.default_rng(seed), {}
    for asked in session.get_inputs():
        shape = [size if isinstance(size, int) else SIZES[size] for size in asked.shape]
        if "int32" in asked.type:
            made[asked.name] = random.integers(0, SIZES["V"], shape, dtype=np.int32)
            continue
        made[asked.name] = random.random(shape, np.float32)
        if seed and asked.name not in ("albedo", "anisotropy", "gamma"):
            made[asked.name] *= np.float32(10.0) ** random.uniform(-8.0, 0.5, shape).astype(np.float32)
    return made


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(WEIGHTS)))
@pytest.mark.parametrize("number", VARIANTS)
def test_every_network_predicts_what_onnxruntime_predicts(path, number):
    content = path.read_bytes()
    expected = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    found = Session(content)
    assert found.get_modelmeta().custom_metadata_map == expected.get_modelmeta().custom_metadata_map
    assert [(one.name, one.type, [*one.shape]) for one in found.get_inputs()] == [
        (one.name, one.type, one.shape) for one in expected.get_inputs()
    ]
    names = [output.name for output in expected.get_outputs()]
    for seed in range(3):
        given = inputs(expected, seed)
        (theirs,) = expected.run(names, given)
        before = {name: value.copy() for name, value in given.items()}
        with variant(number):
            (ours,) = found.run(names, given)
        for name, value in before.items():
            np.testing.assert_array_equal(given[name], value)
        assert ours.dtype == theirs.dtype and np.isfinite(theirs).all()
        np.testing.assert_allclose(ours, theirs, rtol=1e-4 if seed else 1e-5, atol=1e-5 * np.abs(theirs).max())


def test_points_do_not_depend_on_their_neighbours():
    """The same bits, in tiles of any size."""
    content = (WEIGHTS / "mrpnn.onnx").read_bytes()
    session = Session(content)
    given = inputs(onnxruntime.InferenceSession(content), 0)
    (whole,) = session.run(["radiance"], given)
    some = {name: value[:48] if len(value) == SIZES["N"] else value for name, value in given.items()}
    np.testing.assert_array_equal(session.run(["radiance"], some)[0], whole[:, :48])


@pytest.mark.parametrize("shape", [(5, 7), (3, 0, 7), (2, 9, 7, 4), (CACHED // 50, 7, 30)], ids=str)
def test_arrays_are_split_along_any_axis(shape):
    x = np.random.default_rng(0).random(shape, np.float32)
    axis = shape.index(7)
    for number in (axis, axis - x.ndim):
        parts = OPERATORS["Split"](x, np.array([2, 0, 5]), axis=number)
        for found, expected in zip(parts, np.split(x, [2, 2], axis), strict=True):
            np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("operation", sorted(NEW_MEMORY & {"ReduceMax", "ReduceMean", "Softmax", "Split", "Concat"}))
@pytest.mark.parametrize("width", [1, 2, 13])
def test_what_is_said_to_be_new_shares_no_memory(operation, width):
    x = np.random.default_rng(0).random((5, width), np.float32)
    options = {"ReduceMax": {"axes": (1,)}, "ReduceMean": {"axes": (1,)}}.get(operation, {"axis": 1})
    made = OPERATORS[operation](x, *([np.array([width])] if operation == "Split" else []), **options)
    assert not any(np.shares_memory(x, value) for value in (made if isinstance(made, list) else [made]))


@pytest.mark.parametrize("number", VARIANTS)
def test_the_kernel_multiplies_matrices(number):
    random = np.random.default_rng(number)
    sizes = (1, 1, 1), (13, 7, 33), (97, 48, 192), (212, 192, 12), (0, 5, 3), (3, 0, 4), (5, 9, 16)
    for rows, inner, columns in sizes:
        left, right = (random.normal(size=shape).astype(np.float32) for shape in ((rows, inner), (inner, columns)))
        with variant(number):
            found = Layer(right)(left)
        product, near = left.astype(np.float64) @ right, {"rtol": 0.0, "atol": 2e-6 * max(inner, 1)}
        np.testing.assert_allclose(found, product, **near)
        bias, added = (random.normal(size=shape).astype(np.float32) for shape in ((columns,), (rows, columns)))
        with variant(number):
            sums, rectified = Layer(right, bias)(left, added), Layer(right, bias, rectified=True)(left)
        np.testing.assert_allclose(sums, product + bias + added, **near)
        np.testing.assert_allclose(rectified, np.maximum(product + bias, 0.0), **near)
    extreme = random_density(random, (12, 1, 20), "magnitudes").reshape(12, 20)
    extreme[3, 4], extreme[5, 6] = np.inf, np.nan
    right = np.ones((20, 18), np.float32)
    with np.errstate(all="ignore"), variant(number):
        np.testing.assert_allclose(Layer(right)(extreme), extreme @ right, rtol=1e-6)
        rectified = Layer(-right, rectified=True)(extreme)
        np.testing.assert_array_equal(rectified, np.maximum(Layer(-right)(extreme), 0.0))


def test_damaged_files_are_refused_by_their_reader():
    content = bytearray((WEIGHTS / "uncertainty" / "mrpnn.onnx").read_bytes())
    random, refused = np.random.default_rng(7), 0
    for _ in range(300):
        damaged = bytearray(content)
        # What is no weight lies at the file's ends.
        for place in random.integers(0, 4000, 2):
            damaged[place - 2000] = random.integers(256)
        if random.random() < 0.3:
            del damaged[int(random.integers(len(damaged))) :]
        try:
            Session(bytes(damaged))
        except MalformedFile:
            refused += 1
    assert refused > 50
    for nothing in (b"", b"\xff" * 100, b"version https://git-lfs.github.com/spec/v1"):
        with pytest.raises(MalformedFile):
            read_model(nothing)
