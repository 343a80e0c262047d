# SPDX-License-Identifier: GPL-3.0-or-later
"""A network's graph evaluated without onnxruntime, with the methods of its sessions that this project calls."""

import functools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .model_file import Input, MalformedFile, Model, Node, read_model
from .operators import IN_PLACE, NEW_MEMORY, OPERATORS
from .products import Weights


@dataclass(frozen=True)
class Metadata:
    """custom_metadata_map: texts of the file by key."""

    custom_metadata_map: dict[str, str]


@dataclass(frozen=True)
class _Step:
    """A node that is ready to run.

    inputs, outputs, released, spent: names. Released values are not read again; spent values may be written over.
    """

    run: Callable[..., Any]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    released: tuple[str, ...]
    spent: frozenset[str] = frozenset()


class Session:
    """Evaluates an ONNX file on the calling thread. Immutable and safe on several threads.

    content: of the file. Raises MalformedFile for content that is no
    ONNX file, or whose graph has operators that are not known here.
    """

    def __init__(self, content: bytes):
        self._model = read_model(content)
        unknown = {node.operation for node in self._model.nodes} - set(OPERATORS)
        if unknown:
            raise MalformedFile(f"its operators {', '.join(sorted(unknown))} are unknown")
        own = _own_memory(self._model)
        self._steps = [
            _step(node, self._model.weights, released, own)
            for node, released in zip(self._model.nodes, _last_uses(self._model))
        ]

    def get_inputs(self) -> tuple[Input, ...]:
        """The graph's inputs."""
        return self._model.inputs

    def get_modelmeta(self) -> Metadata:
        """The file's metadata."""
        return Metadata(self._model.metadata)

    def get_providers(self) -> list[str]:
        """The execution providers, by onnxruntime's names."""
        return ["CPUExecutionProvider"]

    def run(self, outputs: Sequence[str], inputs: Mapping[str, np.ndarray]) -> list[np.ndarray]:
        """Values of outputs, by name. inputs: arrays of the types and shapes that `get_inputs` returns."""
        values: dict[str, Any] = {"": None, **self._model.weights, **inputs}
        # As silent as onnxruntime about infinities.
        with np.errstate(all="ignore"):
            for step in self._steps:
                arguments = [values[name] for name in step.inputs]
                results = step.run(*arguments, **_written_over(step, arguments))
                values.update(zip(step.outputs, results if isinstance(results, list) else [results]))
                for name in step.released:
                    del values[name]
        return [np.asarray(values[name]) for name in outputs]


def _written_over(step: _Step, values: list[np.ndarray]) -> dict[str, np.ndarray]:
    """As `out`, the input of a step whose memory the output may use; empty if there is none."""
    if step.spent:
        shape = np.broadcast_shapes(*(value.shape for value in values))
        for name, value in zip(step.inputs, values):
            if name in step.spent and value.shape == shape:
                return {"out": value}
    return {}


def _step(
    node: Node,
    weights: dict[str, np.ndarray],
    released: tuple[str, ...],
    own: frozenset[str],
) -> _Step:
    """A node with its attributes; a product with a matrix of weights holds it packed."""
    operator, attributes, inputs = OPERATORS[node.operation], node.attributes, node.inputs
    run: Callable[..., Any] = functools.partial(operator, **attributes)
    plain = not {"transA", "alpha", "beta"} & set(attributes)
    if node.operation in ("Gemm", "MatMul") and plain and weights.get(inputs[1], np.empty(0)).ndim == 2:
        matrix = weights[inputs[1]]
        run = _product(Weights(matrix.T if attributes.get("transB") else matrix))
        inputs = (inputs[0], *inputs[2:])
    spent = own & set(released) if node.operation in IN_PLACE else frozenset()
    return _Step(run=run, inputs=inputs, outputs=node.outputs, released=released, spent=frozenset(spent))


def _product(matrix: Weights) -> Callable[..., np.ndarray]:
    def run(left: np.ndarray, more: np.ndarray | None = None) -> np.ndarray:
        rows = matrix.product(left.reshape(-1, left.shape[-1]))
        products = rows.reshape(*left.shape[:-1], rows.shape[-1])
        return products if more is None else np.add(products, more, out=products)

    return run


def _own_memory(model: Model) -> frozenset[str]:
    """Values between nodes that share memory with no other value."""
    new = {name for node in model.nodes if node.operation in NEW_MEMORY for name in node.outputs}
    shared = {name for node in model.nodes if node.operation not in NEW_MEMORY for name in node.inputs}
    return frozenset(new - shared)


def _last_uses(model: Model) -> list[tuple[str, ...]]:
    """For each node, the values between nodes that no later node reads."""
    retained = {"", *model.weights, *(entry.name for entry in model.inputs), *model.outputs}
    last = {name: number for number, node in enumerate(model.nodes) for name in (*node.outputs, *node.inputs)}
    released: list[list[str]] = [[] for _ in model.nodes]
    for name, number in last.items():
        if name not in retained:
            released[number].append(name)
    return [tuple(names) for names in released]
