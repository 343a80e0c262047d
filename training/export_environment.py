# SPDX-License-Identifier: GPL-3.0-or-later
"""Write the trained network for light from everywhere as ONNX, with its configuration in the metadata.

python -m training.export_environment runs/environment/checkpoint.pt inference/weights/environment/mrpnn.onnx
"""

import argparse
import json

import torch

from training.export import save
from training.networks.environment import EnvironmentNet
from training.onnx_graph import Graph


def main(options=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkpoint")
    parser.add_argument("output")
    arguments = parser.parse_args(options)
    checkpoint = torch.load(arguments.checkpoint, map_location="cpu", weights_only=True)
    weights = checkpoint["averaged"]
    net = EnvironmentNet(len(weights["first.bias"]))
    net.load_state_dict(weights)
    graph = Graph()
    net.graph(graph)
    metadata = {"configuration": json.dumps(checkpoint["configuration"], sort_keys=True)}
    save(graph.model(net.name, metadata), arguments.output)


if __name__ == "__main__":
    main()
