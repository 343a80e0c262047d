# SPDX-License-Identifier: GPL-3.0-or-later
"""A network's graph evaluated without onnxruntime, with the methods of its sessions that this project calls."""

import functools
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .model_file import Input, MalformedFile, Model, Node, read_model
from .operators import IN_PLACE, NEW_MEMORY, OPERATORS
from .products import Layer


@dataclass(frozen=True)
class Metadata:
    """custom_metadata_map: texts of the file by key."""

    custom_metadata_map: dict[str, str]


@dataclass(frozen=True)
class _Operation:
    """A node, or several that run as one.

    inputs, outputs: names. new_memory: whether outputs share none with inputs. in_place: whether the output may take
    the memory of an input, as `out`. reshapes: whether the output is the first input in another shape.
    """

    run: Callable[..., Any]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    new_memory: bool = True
    in_place: bool = False
    reshapes: bool = False


@dataclass(frozen=True)
class _Step:
    """An operation in its place among others.

    released, spent: names. Released values are not read again; spent values may be written over.
    """

    operation: _Operation
    released: tuple[str, ...]
    spent: frozenset[str]


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
        operations = _operations(self._model)
        own = _own_memory(self._model, operations)
        self._steps = [
            _Step(operation, released, own & set(released) if operation.in_place else frozenset())
            for operation, released in zip(operations, _last_uses(self._model, operations))
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
                operation = step.operation
                arguments = [values[name] for name in operation.inputs]
                results = operation.run(*arguments, **_written_over(step, arguments))
                values.update(zip(operation.outputs, results if isinstance(results, list) else [results]))
                for name in step.released:
                    del values[name]
        return [np.asarray(values[name]) for name in outputs]


def _written_over(step: _Step, values: list[np.ndarray]) -> dict[str, np.ndarray]:
    """As `out`, the input of a step whose memory the output may use; empty if there is none."""
    if step.spent:
        shape = np.broadcast_shapes(*(value.shape for value in values))
        for name, value in zip(step.operation.inputs, values):
            if name in step.spent and value.shape == shape:
                return {"out": value}
    return {}


def _operations(model: Model) -> list[_Operation]:
    """The graph's nodes in order; those of a layer run as one, in the place of the last of them."""
    numbers = {name: number for number, node in enumerate(model.nodes) for name in node.outputs}
    sole_readers = _sole_readers(model)
    operations: dict[int, _Operation] = {}
    joined = set[str]()
    for number, node in enumerate(model.nodes):
        if node.outputs[0] in joined:
            continue
        layer = _layer(node, model.weights, sole_readers)
        if layer is None:
            operations[number] = _of_node(node)
            continue
        operation, nodes = layer
        operations[numbers[operation.outputs[0]]] = operation
        joined.update(each.outputs[0] for each in nodes)
        # A layer that another one adds does not take its sum, too.
        for name in operation.inputs:
            sole_readers.pop(name, None)
    return [operations[number] for number in sorted(operations)]


def _sole_readers(model: Model) -> dict[str, Node]:
    """The only node that reads a value, of values that no other reads, by their names."""
    readers = Counter(name for node in model.nodes for name in node.inputs) + Counter(model.outputs)
    return {name: node for node in model.nodes for name in node.inputs if readers[name] == 1}


def _of_node(node: Node) -> _Operation:
    return _Operation(
        functools.partial(OPERATORS[node.operation], **node.attributes),
        node.inputs,
        node.outputs,
        new_memory=node.operation in NEW_MEMORY,
        in_place=node.operation in IN_PLACE,
        reshapes=node.operation == "Reshape",
    )


def _layer(
    node: Node, weights: dict[str, np.ndarray], sole_readers: dict[str, Node]
) -> tuple[_Operation, list[Node]] | None:
    """A product with weights and what alone reads it, sums and a rectifier, as one operation; and their nodes.

    None where the node is no such product.
    """
    matrices = weights.get(node.inputs[1]) if node.operation in ("Gemm", "MatMul") else None
    if matrices is None or matrices.ndim not in (2, 3) or {"transA", "alpha", "beta"} & set(node.attributes):
        return None
    matrices = np.moveaxis(matrices, -1, -2) if node.attributes.get("transB") else matrices
    columns = matrices.shape[-1]
    # Rows of weights that are added to all rows of the products, and the name of the one other term.
    biases, added, nodes = np.zeros((matrices[..., 0, 0].size, columns), np.float32), "", [node]
    terms = list(node.inputs[2:])
    while True:
        for name in terms:
            shape = weights[name].shape if name in weights else ()
            if shape == (columns,) or matrices.ndim == 3 and shape == (len(matrices), 1, columns):
                biases = biases + weights[name].reshape(-1, columns)
            elif added:
                return None
            else:
                added = name
        output = nodes[-1].outputs[0]
        after = sole_readers.get(output)
        if after is None or after.operation != "Add" or added:
            break
        terms = [name for name in after.inputs if name != output]
        nodes.append(after)
    rectified = after is not None and after.operation == "Relu"
    if after is not None and rectified:
        nodes.append(after)
    layers = [
        Layer(matrix, bias, rectified) for matrix, bias in zip(matrices.reshape(-1, *matrices.shape[-2:]), biases)
    ]
    run = functools.partial(_one_layer if matrices.ndim == 2 else _layers, layers)
    inputs = (node.inputs[0], added) if added else (node.inputs[0],)
    return _Operation(run, inputs, nodes[-1].outputs), nodes


def _one_layer(layers: list[Layer], left: np.ndarray, added: np.ndarray | None = None) -> np.ndarray:
    (layer,), shape = layers, (*left.shape[:-1], layers[0].columns)
    more = None if added is None else np.broadcast_to(added, shape).reshape(-1, layer.columns)
    return layer(left.reshape(-1, left.shape[-1]), more).reshape(shape)


def _layers(layers: list[Layer], left: np.ndarray, added: np.ndarray | None = None) -> np.ndarray:
    """left: (B, N, inner) or (N, inner), for B layers."""
    out = np.empty((len(layers), left.shape[-2], layers[0].columns), np.float32)
    rows = np.broadcast_to(left, (len(layers), *left.shape[-2:]))
    more = [None] * len(layers) if added is None else np.broadcast_to(added, out.shape)
    for number, layer in enumerate(layers):
        layer(rows[number], more[number], out[number])
    return out


def _own_memory(model: Model, operations: list[_Operation]) -> frozenset[str]:
    """Values between operations that share memory with no other value that is read after them."""
    sole_readers = _sole_readers(model)
    own, shared = set[str](), set[str]()
    for operation in operations:
        if operation.new_memory or operation.reshapes and operation.inputs[0] in own & set(sole_readers):
            own.update(operation.outputs)
        else:
            shared.update(operation.inputs)
    return frozenset(own - shared)


def _last_uses(model: Model, operations: list[_Operation]) -> list[tuple[str, ...]]:
    """For each operation, the values between operations that no later one reads."""
    retained = {"", *model.weights, *(entry.name for entry in model.inputs), *model.outputs}
    last = {name: number for number, each in enumerate(operations) for name in (*each.outputs, *each.inputs)}
    released: list[list[str]] = [[] for _ in operations]
    for name, number in last.items():
        if name not in retained:
            released[number].append(name)
    return [tuple(names) for names in released]
