# SPDX-License-Identifier: GPL-3.0-or-later
"""The paper's networks: MRPNN as published with its variants Narrow and Wide.

They predict suns alone. Nothing else in `inference` knows them: they register as a kind of networks.
"""

from ..features.stencil import Stencil
from ..models.abilities import Abilities
from ..network.network import Kind, register_kind
from ..plan.resolution import LEVEL0_CELLS
from .stencil_predictor import StencilPredictor

# Relative errors (docs/trust/accuracy.md).
DEVIATIONS = {"mrpnn-narrow": 0.17, "mrpnn-paper": 0.18, "mrpnn-wide": 0.18}
# Bytes of the transmittance of one sun.
SUN_BYTES = 8 * LEVEL0_CELLS**3


def register_paper() -> None:
    """Let weights files state the kind of these networks."""
    register_kind("stencil", Kind(Stencil.read, StencilPredictor, Abilities(light_bytes=SUN_BYTES), DEVIATIONS))
