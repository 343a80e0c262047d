# SPDX-License-Identifier: GPL-3.0-or-later
"""The operators of the networks' graphs, as ONNX defines them (https://onnx.ai/onnx/operators/), opset 17.

Each takes a node's inputs, arrays or None, and its attributes, and returns its output or a list of outputs.
"""

import math
from collections.abc import Callable
from typing import Any

import numpy as np

Array = np.ndarray
#: Numbers that stay in a core's cache.
CACHED = 1 << 18


def _gemm(a: Array, b: Array, c: Array | None = None, **options: Any) -> Array:
    if options.get("alpha", 1.0) != 1.0 or options.get("beta", 1.0) != 1.0:
        raise ValueError("Gemm with factors is unknown")
    product = (a.T if options.get("transA", 0) else a) @ (b.T if options.get("transB", 0) else b)
    return product if c is None else np.add(product, c, out=product)


def _relu(x: Array, out: Array | None = None) -> Array:
    return np.maximum(x, np.float32(0.0), out=out)


def _sigmoid(x: Array) -> Array:
    return np.float32(1.0) / (np.float32(1.0) + np.exp(-x))


def _softmax(x: Array, axis: int = -1, out: Array | None = None) -> Array:
    powers = np.subtract(x, _reduce_max(x, (axis,)), out=out)
    np.exp(powers, out=powers)
    powers *= np.float32(1.0) / (_reduce_mean(powers, (axis,)) * np.float32(x.shape[axis]))
    return powers


def _clip(x: Array, low: Array | None = None, high: Array | None = None) -> Array:
    return np.clip(x, None if low is None else low.reshape(()), None if high is None else high.reshape(()))


def _reshape(x: Array, shape: Array, allowzero: int = 0) -> Array:
    sizes = [x.shape[axis] if size == 0 and not allowzero else int(size) for axis, size in enumerate(shape)]
    return x.reshape(sizes)


def _concat(*arrays: Array, axis: int) -> Array:
    shape = list(arrays[0].shape)
    shape[axis] = sum(array.shape[axis] for array in arrays)
    # In C order, which numpy does not take where arrays are transposed: rows are read faster.
    return np.concatenate(arrays, axis, out=np.empty(shape, arrays[0].dtype))


def _split(x: Array, sizes: Array, axis: int = 0) -> list[Array]:
    axis %= x.ndim
    before, after = x.shape[:axis], x.shape[axis + 1 :]
    width = math.prod(after)
    rows = x.reshape(math.prod(before), x.shape[axis] * width)
    columns = [size * width for size in sizes.tolist()]
    parts = [np.empty((len(rows), count), x.dtype) for count in columns]
    # Parts are read several times, which is faster in copies. Rows are copied to the cache in order, and split there.
    step = max(CACHED // max(rows.shape[1], 1), 1)
    for first in range(0, len(rows), step):
        cached, start = rows[first : first + step].copy(), 0
        for part, count in zip(parts, columns):
            part[first : first + step] = cached[:, start : start + count]
            start += count
    return [part.reshape(*before, size, *after) for part, size in zip(parts, sizes.tolist())]


def _expand(x: Array, shape: Array) -> Array:
    return np.broadcast_to(x, np.broadcast_shapes(x.shape, tuple(int(size) for size in shape)))


def _unsqueeze(x: Array, axes: Array) -> Array:
    return np.expand_dims(x, tuple(int(axis) for axis in axes))


def _shape(x: Array, start: int = 0, end: int | None = None) -> Array:
    return np.array(x.shape[start:end], np.int64)


def _kept(reduced: Array, axes: tuple[int, ...], keepdims: int) -> Array:
    return np.expand_dims(reduced, axes) if keepdims else reduced


def _reduce_max(x: Array, axes: tuple[int, ...] | None = None, keepdims: int = 1) -> Array:
    if axes is None or len(axes) != 1 or not x.shape[axes[0]]:
        return np.asarray(x.max(axis=axes, keepdims=bool(keepdims)))
    # Pairs at a time, which numpy takes in one go where rows are as long as a power of two; others are folded to one.
    rows = np.moveaxis(x, axes[0], -1)
    count = 1 << (rows.shape[-1].bit_length() - 1)
    largest, more = rows[..., :count], rows[..., count:]
    if more.shape[-1] or count == 1:
        largest = largest.copy()
        np.maximum(largest[..., : more.shape[-1]], more, out=largest[..., : more.shape[-1]])
    while largest.shape[-1] > 1:
        largest = np.maximum(largest[..., ::2], largest[..., 1::2])
    return _kept(largest[..., 0], axes, keepdims)


def _reduce_mean(x: Array, axes: tuple[int, ...] | None = None, keepdims: int = 1) -> Array:
    if axes is None or len(axes) != 1:
        return np.asarray(x.mean(axis=axes, keepdims=bool(keepdims)))
    # Several times as fast as a mean along a short axis.
    sums = np.einsum("...k->...", np.moveaxis(x, axes[0], -1))
    return _kept(sums / np.float32(x.shape[axes[0]]), axes, keepdims)


#: Operators that can write over one of their inputs, as `out`, and those whose outputs share no memory with inputs.
IN_PLACE = {*"Abs Add Cos Div Exp Log Max Min Mul Pow Relu Sin Softmax Sub Tanh".split()}
NEW_MEMORY = {*IN_PLACE, *"Clip Concat Gather Gemm MatMul ReduceMax ReduceMean Sigmoid Split".split()}

OPERATORS: dict[str, Callable[..., Any]] = {
    "Abs": np.abs,
    "Add": np.add,
    "Clip": _clip,
    "Concat": _concat,
    "Cos": np.cos,
    "Div": np.divide,
    "Exp": np.exp,
    "Expand": _expand,
    "Gather": lambda x, indices, axis=0: np.take(x, indices, axis),
    "Gemm": _gemm,
    "Identity": lambda x: x,
    "Log": np.log,
    "MatMul": np.matmul,
    "Max": np.maximum,
    "Min": np.minimum,
    "Mul": np.multiply,
    "Pow": np.power,
    "ReduceMax": _reduce_max,
    "ReduceMean": _reduce_mean,
    "Relu": _relu,
    "Reshape": _reshape,
    "Shape": _shape,
    "Sigmoid": _sigmoid,
    "Sin": np.sin,
    "Softmax": _softmax,
    "Split": _split,
    "Sub": np.subtract,
    "Tanh": np.tanh,
    "Transpose": lambda x, perm=None: np.transpose(x, perm),
    "Unsqueeze": _unsqueeze,
}
