# SPDX-License-Identifier: GPL-3.0-or-later
"""The networks that the project trains, by the name that weights files and Settings.model give them."""

from .mrpnn import RayMRPNN
from .mrpnn_narrow import MRPNNNarrow
from .mrpnn_paper import MRPNN
from .mrpnn_wide import MRPNNWide
from .rpnn import RPNN

NETWORKS = {network.name: network for network in (RayMRPNN, MRPNN, MRPNNNarrow, MRPNNWide, RPNN)}

__all__ = ["MRPNN", "MRPNNNarrow", "MRPNNWide", "NETWORKS", "RPNN", "RayMRPNN"]
