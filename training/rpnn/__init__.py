# SPDX-License-Identifier: GPL-3.0-or-later
"""RPNN, the network that the paper compares MRPNN with. Importing it lets Settings.model name "rpnn".

Its 5 MB of weights lie beside this file.
"""

from pathlib import Path

from inference.models.weights_file import read_weights
from inference.network.network import Kind, open_network, register_kind, register_system

from .lattice_predictor import LatticePredictor
from .rpnn_lattice import POINTS, SunLattice

WEIGHTS = Path(__file__).parent
NAME = "rpnn"
# Relative error (docs/trust/accuracy.md).
DEVIATIONS = {NAME: 0.12}

register_kind(
    "lattice", Kind(lambda values: SunLattice(values.reshape(POINTS, 3)), LatticePredictor, deviations=DEVIATIONS)
)
register_system(NAME, lambda: open_network(NAME, read_weights(NAME, WEIGHTS)))
