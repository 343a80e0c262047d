# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds ONNX graphs node by node: the exported graph is the one that a network's `graph` spells out."""

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

OPSET = 17


class Graph:
    """Collects inputs, nodes, constants and outputs; methods that add nodes return the names of their results."""

    def __init__(self):
        self.inputs, self.outputs, self.nodes, self.constants = [], [], [], []

    def input(self, name: str, shape, kind=TensorProto.FLOAT):
        self.inputs.append(helper.make_tensor_value_info(name, kind, shape))

    def output(self, name: str, value: str, shape):
        self.nodes.append(helper.make_node("Identity", [value], [name]))
        self.outputs.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))

    def constant(self, value) -> str:
        name = f"c{len(self.constants)}"
        value = value.detach().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

    def number(self, value: float) -> str:
        return self.constant(np.float32(value))

    def op(self, kind: str, *inputs: str, **attributes) -> str:
        name = f"{kind.lower()}{len(self.nodes)}"
        self.nodes.append(helper.make_node(kind, inputs, [name], **attributes))
        return name

    def relu(self, x):
        return self.op("Relu", x)

    def linear(self, x, layer):
        """A torch.nn.Linear on (rows, in)."""
        inputs = [x, self.constant(layer.weight)]
        if layer.bias is not None:
            inputs.append(self.constant(layer.bias))
        return self.op("Gemm", *inputs, transB=1)

    def channel_linear(self, x, layer):
        """A ChannelLinear on (3, rows, in)."""
        product = self.op("MatMul", x, self.constant(layer.weight))
        return self.op("Add", product, self.constant(layer.bias))

    def excitation(self, e, module):
        hidden = self.relu(self.linear(e, module.squeeze))
        return self.op("Sigmoid", self.linear(hidden, module.excite))

    def reshape(self, x, shape):
        return self.op("Reshape", x, self.constant(np.array(shape, np.int64)))

    def column(self, x):
        """(N,) or any shape as (rows, 1)."""
        return self.reshape(x, (-1, 1))

    def channels_last(self, x, width: int):
        """(3, N, width / 3) as (N, width), channel after channel."""
        return self.reshape(self.op("Transpose", x, perm=[1, 0, 2]), (-1, width))

    def concat(self, parts, axis: int):
        return self.op("Concat", *parts, axis=axis)

    def split(self, x, widths, axis: int):
        """Parts of the given widths: a list of names."""
        names = [f"split{len(self.nodes)}_{i}" for i in range(len(widths))]
        inputs = [x, self.constant(np.array(widths, np.int64))]
        self.nodes.append(helper.make_node("Split", inputs, names, axis=axis))
        return names

    def repeat(self, x, width: int):
        """(N, width) once for each value of the input `albedo`: (A * N, width)."""
        one = self.constant(np.array([1], np.int64))
        shape = self.concat([self.op("Shape", "albedo"), one, one], axis=0)
        rows = self.op("Unsqueeze", x, self.constant(np.array([0])))
        return self.reshape(self.op("Expand", rows, shape), (-1, width))

    def model(self, name: str, metadata: dict) -> onnx.ModelProto:
        """The graph with string metadata, checked."""
        graph = helper.make_graph(self.nodes, name, self.inputs, self.outputs, self.constants)
        model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="mrpnn")
        model.ir_version = 8
        helper.set_model_props(model, metadata)
        onnx.checker.check_model(model, full_check=True)
        return model


def linear_layers(model: onnx.ModelProto) -> list:
    """Weight (out, in) and, if any, bias (out,) of each fully connected layer of a graph, in order, as tensors."""
    constants = {constant.name: constant for constant in model.graph.initializer}

    def tensor(name):
        return torch.from_numpy(numpy_helper.to_array(constants[name]).copy())

    layers = [node.input[1:] for node in model.graph.node if node.op_type == "Gemm"]
    return [[tensor(name) for name in names if name in constants] for names in layers]
