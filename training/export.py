"""Write a network as ONNX, with its stencil or lattice and the configuration that made it inside.

    python -m training.export CHECKPOINT.pt inference/weights/NAME.onnx [--initial BEFORE.onnx --share 0.6]

Which network it is stands in the checkpoint's configuration. Output: radiance (A, N) for albedos (A,); the
other inputs are those of the network's kind: "ray", "stencil" or "lattice". Of weights that were trained on from
others, --share 0.6 goes six tenths of the way from those to these: a mean of both forgets less of what they knew.
"""

import argparse
import base64
import copy
import functools
import hashlib
import json
import os

import numpy as np
import onnx
import torch

from inference.sun_lattice import make_sun_lattice
from training.networks import NETWORKS
from training.onnx_graph import Graph
from training.stencil import load_stencil
from training.train import start_from


@functools.cache
def points_metadata(kind: str) -> dict:
    """The points around x that networks of a kind read, as metadata."""
    if kind == "lattice":
        geometry = make_sun_lattice()
        points = geometry.points
    else:
        geometry = load_stencil()
        points = np.concatenate([geometry.low.ravel(), geometry.high])
    encoded = base64.b64encode(points.astype("<f4").tobytes()).decode()
    return {"kind": kind, "points": encoded, "points_sha256": geometry.digest}


def export(net, configuration: dict) -> onnx.ModelProto:
    """The network as an ONNX model; configuration: how it was trained and its ranges."""
    graph = Graph()
    net.graph(graph)
    configuration = {**configuration, **net.ranges, "network": net.name}
    metadata = {**points_metadata(net.kind), "configuration": json.dumps(configuration, sort_keys=True)}
    return graph.model(net.name, metadata)


def save(model: onnx.ModelProto, path: str):
    """Write the model, NAME.onnx, and its checksum, NAME.sha256, each through a temporary name."""
    content = model.SerializeToString()
    line = f"{hashlib.sha256(content).hexdigest()}  {os.path.basename(path)}\n"
    for target, data in ((path, content), (os.path.splitext(path)[0] + ".sha256", line.encode())):
        partial = f"{target}.partial"
        with open(partial, "wb") as file:
            file.write(data)
        os.replace(partial, target)


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint")
    parser.add_argument("output")
    parser.add_argument("--initial", help="the weights that training started from")
    parser.add_argument("--share", type=float, default=1.0, help="of the way from --initial to the checkpoint")
    arguments = parser.parse_args(options)
    checkpoint = torch.load(arguments.checkpoint, map_location="cpu", weights_only=True)
    configuration = checkpoint["configuration"]
    net = NETWORKS[configuration["network"]]()
    net.load_state_dict(checkpoint["averaged"])
    if arguments.share != 1.0:
        # Its error is no longer that of the checkpoint.
        configuration = {key: value for key, value in configuration.items() if not key.startswith("held_")}
        configuration["share_of_training"] = arguments.share
        trained = copy.deepcopy(net.state_dict())
        if start_from(net, arguments.initial) != configuration.get("initial"):
            parser.error(f"{arguments.checkpoint} was not trained on from {arguments.initial}")
        initial = net.state_dict()
        net.load_state_dict({key: torch.lerp(initial[key], trained[key], arguments.share) for key in trained})
    save(export(net, configuration), arguments.output)


if __name__ == "__main__":
    main()
