# SPDX-License-Identifier: GPL-3.0-or-later
"""Write a trained network as ONNX, with its stencil or lattice and its training configuration in the metadata.

    python -m training.export runs/mrpnn/checkpoint.pt inference/weights/mrpnn.onnx [--with BEFORE.onnx 0.4]

Reads a checkpoint of training.train, whose configuration names the network, and writes the averaged weights and
inference/weights/mrpnn.sha256. The graph's output is radiance (A, N) for albedos (A,); its other inputs are those of
the network's kind, "ray", "stencil" or "lattice". --with, which may be repeated, averages with the exported weights
that the training started from, in the share given; the mean forgets less of what they knew, and its configuration
names them.
"""

import argparse
import base64
import functools
import hashlib
import json
import os

import onnx
import torch

from training.data.stencil import load_stencil
from training.files import complete_file
from training.networks import NETWORKS
from training.onnx_graph import Graph
from training.rpnn.rpnn_lattice import make_sun_lattice
from training.train import start_from


@functools.cache
def points_metadata(kind: str) -> dict:
    """The points around a position that networks of a kind read, as string metadata."""
    if kind == "lattice":
        geometry = make_sun_lattice()
        points = geometry.points
    else:
        geometry = load_stencil().sparse() if kind == "ray" else load_stencil()
        points = geometry.written()
    encoded = base64.b64encode(points.astype("<f4").tobytes()).decode()
    return {"kind": kind, "points": encoded, "points_sha256": geometry.digest}


def export(net, configuration: dict) -> onnx.ModelProto:
    """The network as an ONNX model; configuration: how it was trained, for what ranges."""
    graph = Graph()
    net.graph(graph)
    configuration = {**configuration, **net.ranges, "network": net.name}
    metadata = {**points_metadata(net.kind), "configuration": json.dumps(configuration, sort_keys=True)}
    return graph.model(net.name, metadata)


def save(model: onnx.ModelProto, path: str):
    """Write the model, NAME.onnx, and its checksum, NAME.sha256."""
    content = model.SerializeToString()
    line = f"{hashlib.sha256(content).hexdigest()}  {os.path.basename(path)}\n"
    for target, data in ((path, content), (os.path.splitext(path)[0] + ".sha256", line.encode())):
        with complete_file(target) as file:
            file.write(data)


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint")
    parser.add_argument("output")
    parser.add_argument("--with", dest="others", nargs=2, action="append", default=[], metavar=("NAME.onnx", "SHARE"))
    arguments = parser.parse_args(options)
    checkpoint = torch.load(arguments.checkpoint, map_location="cpu", weights_only=True)
    configuration = checkpoint["configuration"]
    net = NETWORKS[configuration["network"]]()
    net.load_state_dict(checkpoint["averaged"])
    if arguments.others:
        # The mean's error is not the checkpoint's.
        configuration = {key: value for key, value in configuration.items() if not key.startswith("held_")}
        shares = [float(share) for _, share in arguments.others]
        if min(shares) <= 0.0 or sum(shares) >= 1.0:
            parser.error("shares must be above 0 and sum to less than 1")
        mean = {key: (1.0 - sum(shares)) * value for key, value in net.state_dict().items()}
        configuration["mean_with"] = []
        for (path, _), share in zip(arguments.others, shares):
            before = start_from(net, path)
            if before != configuration.get("initial") and before != configuration.get("initial", {}).get("initial"):
                parser.error(f"{arguments.checkpoint} was not trained from {path}")
            configuration["mean_with"].append({"share": share, "configuration": before})
            mean = {key: value + share * net.state_dict()[key] for key, value in mean.items()}
        net.load_state_dict(mean)
    save(export(net, configuration), arguments.output)


if __name__ == "__main__":
    main()
