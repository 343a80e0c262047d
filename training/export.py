"""Write an MRPNN as ONNX, with the stencil and the configuration that made it inside.

    python -m training.export CHECKPOINT.pt inference/weights/mrpnn.onnx

The graph is built node by node, so that what onnxruntime runs is plain to read:
inputs features (3, N, 192), anisotropy (N,), gamma (N,), albedo (A,); output radiance (A, N).
"""

import argparse
import base64
import json
import os

import numpy as np
import onnx
import torch
from onnx import TensorProto, helper, numpy_helper

from inference.stencil import LAYER_POINTS, LOW_LAYERS, Stencil, make_stencil
from training.networks import MRPNN, layer_slices

OPSET = 17


class Graph:
    """Collects nodes and constants; every method returns the name of its result."""

    def __init__(self):
        self.nodes, self.constants = [], []

    def constant(self, value) -> str:
        name = f"c{len(self.constants)}"
        value = value.detach().numpy() if isinstance(value, torch.Tensor) else np.asarray(value)
        self.constants.append(numpy_helper.from_array(np.ascontiguousarray(value), name))
        return name

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
        product = self.op("MatMul", x, self.constant(layer.weight))
        return self.op("Add", product, self.constant(layer.bias))

    def excitation(self, e, module):
        hidden = self.relu(self.linear(e, module.squeeze))
        return self.op("Sigmoid", self.linear(hidden, module.excite))

    def reshape(self, x, shape):
        return self.op("Reshape", x, self.constant(np.array(shape, np.int64)))

    def concat(self, parts, axis):
        return self.op("Concat", *parts, axis=axis)


def _feature_stage(g: Graph, net: MRPNN):
    slices = layer_slices()
    parts = [f"layer{i}" for i in range(len(slices))]
    widths = g.constant(np.array(LAYER_POINTS, np.int64))
    g.nodes.append(helper.make_node("Split", ["features", widths], parts, axis=2))
    angles = g.concat([g.reshape("anisotropy", (-1, 1)), g.reshape("gamma", (-1, 1))], axis=1)
    pooled, latents, o = [], [], None
    for i, f in enumerate(parts):
        mean = g.op("ReduceMean", f, axes=[2], keepdims=0)
        largest = g.op("ReduceMax", f, axes=[2], keepdims=0)
        t = g.op("Transpose", g.concat([mean, largest], axis=0), perm=[1, 0])
        pooled.append(t)
        weights = g.excitation(g.concat([t, angles], axis=1), net.excitations[i])
        weights = g.reshape(g.op("Transpose", weights, perm=[1, 0]), (3, -1, 1))
        scaled = g.op("Mul", f, weights)
        if o is not None:
            scaled = g.op("Add", scaled, o)
        h = g.relu(g.channel_linear(scaled, net.blocks[i]))
        last = i in (LOW_LAYERS - 1, len(parts) - 1)
        widens = not last and LAYER_POINTS[i + 1] != LAYER_POINTS[i]
        o = g.concat([h, f], axis=2) if widens else g.op("Add", h, f)
        if last:
            latents.append(o)
            o = None
    h1 = g.relu(g.channel_linear(latents[0], net.low_latent))
    h2 = g.relu(g.channel_linear(latents[1], net.high_latent))
    # (N, 96) and (N, 24), channel after channel.
    h1 = g.reshape(g.op("Transpose", h1, perm=[1, 0, 2]), (-1, 3, LAYER_POINTS[LOW_LAYERS - 1]))
    h2 = g.reshape(g.op("Transpose", h2, perm=[1, 0, 2]), (-1, 3, LAYER_POINTS[-1]))
    return h1, h2, g.concat([*pooled, angles], axis=1)


def _repeat(g: Graph, x, tail):
    """(N, ...) once for each albedo: (A * N, ...)."""
    one = g.constant(np.array([1], np.int64))
    dims = g.concat([g.op("Shape", "albedo"), one, *([one] * len(tail))], axis=0)
    expanded = g.op("Expand", g.op("Unsqueeze", x, g.constant(np.array([0], np.int64))), dims)
    return g.reshape(expanded, (-1, *tail))


def _albedo_stage(g: Graph, net: MRPNN, h1, h2, pooled_and_angles):
    low, high, pooled = LAYER_POINTS[LOW_LAYERS - 1], LAYER_POINTS[-1], 6 * len(LAYER_POINTS)
    repeated = _repeat(g, pooled_and_angles, (pooled + 2,))
    points = g.op("Shape", "gamma")
    one = g.constant(np.array([1], np.int64))
    column = g.op("Unsqueeze", "albedo", g.constant(np.array([1], np.int64)))
    spread = g.op("Expand", column, g.concat([one, points], axis=0))
    albedo = g.reshape(spread, (-1, 1))
    t, anisotropy, gamma = (
        f"{name}_rows" for name in ("pooled", "anisotropy", "gamma")
    )
    widths = g.constant(np.array([pooled, 1, 1], np.int64))
    g.nodes.append(helper.make_node("Split", [repeated, widths], [t, anisotropy, gamma], axis=1))
    h_albedo = g.relu(g.linear(g.concat([anisotropy, albedo, gamma], axis=1), net.albedo_latent))
    weights = g.excitation(g.concat([t, albedo, anisotropy, gamma], axis=1), net.albedo_excitation)
    weights = g.reshape(weights, (-1, 6, 1))
    g.nodes.append(
        helper.make_node("Split", [weights, g.constant(np.array([3, 3], np.int64))], ["w_low", "w_high"], axis=1)
    )
    low_rows = g.reshape(g.op("Mul", _repeat(g, h1, (3, low)), "w_low"), (-1, 3 * low))
    high_rows = g.reshape(g.op("Mul", _repeat(g, h2, (3, high)), "w_high"), (-1, 3 * high))
    o = g.concat([low_rows, high_rows, h_albedo], axis=1)
    for layer in net.reduction:
        o = g.relu(g.linear(o, layer))
    for k in range(0, net.RESIDUAL_LAYERS, 2):
        odd = g.relu(g.linear(o, net.residual[k]))
        even = g.linear(odd, net.residual[k + 1])
        o = even if k + 2 == net.RESIDUAL_LAYERS else g.op("Add", g.relu(even), odd)
    radiance = g.op("Mul", albedo, g.op("Exp", o))
    shape = g.concat([g.op("Shape", "albedo"), points], axis=0)
    g.nodes.append(helper.make_node("Reshape", [radiance, shape], ["radiance"]))


def export(net: MRPNN, stencil: Stencil, configuration: dict) -> onnx.ModelProto:
    """The network as an ONNX model with its stencil and configuration as metadata."""
    g = Graph()
    _albedo_stage(g, net, *_feature_stage(g, net))
    def value(name, shape):
        return helper.make_tensor_value_info(name, TensorProto.FLOAT, shape)

    graph = helper.make_graph(
        g.nodes,
        "mrpnn",
        [value("features", [3, "N", 192]), value("anisotropy", ["N"]), value("gamma", ["N"]), value("albedo", ["A"])],
        [value("radiance", ["A", "N"])],
        g.constants,
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="mrpnn")
    model.ir_version = 8
    points = np.concatenate([stencil.low.ravel(), stencil.high])
    helper.set_model_props(
        model,
        {
            "stencil": base64.b64encode(points.astype("<f4").tobytes()).decode(),
            "stencil_sha256": stencil.digest,
            "configuration": json.dumps(configuration, sort_keys=True),
        },
    )
    onnx.checker.check_model(model, full_check=True)
    return model


def save(model: onnx.ModelProto, path: str):
    """Write the model through a temporary name."""
    partial = f"{path}.partial"
    onnx.save(model, partial)
    os.replace(partial, path)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint")
    parser.add_argument("output")
    arguments = parser.parse_args()
    checkpoint = torch.load(arguments.checkpoint, map_location="cpu", weights_only=True)
    net = MRPNN()
    net.load_state_dict(checkpoint["averaged"])
    save(export(net, make_stencil(), checkpoint["configuration"]), arguments.output)


if __name__ == "__main__":
    main()
