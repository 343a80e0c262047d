# SPDX-License-Identifier: GPL-3.0-or-later
"""Features mu, S and P at the stencil's points around each x, as the paper's networks read them."""

import numpy as np

from ..features.descriptors import FieldLookup, angle_to_sun, distinct_rows
from ..features.mip_lattices import Lattices
from ..features.stencil import POINTS
from .phase_features import PhaseFeatures


def describe(
    lookup: FieldLookup,
    transmittance: Lattices,
    phase: PhaseFeatures,
    positions: np.ndarray,
    omega: np.ndarray,
    jitter: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Descriptors of points for one sun.

    lookup: of the density. transmittance: of the sun, for the same stencil and extent. positions, omega: (N, 3) in the
    cube's frame. jitter: as for FieldLookup. Returns features float32 (3, N, 192) in the order mu, S, P, and gamma
    float32 (N,).
    """
    first, view = distinct_rows(omega)
    features = np.empty((3, len(positions), POINTS), np.float32)
    for span, index in lookup.cells(positions, omega[first], view, jitter):
        lookup.lattices.read(index, features[0, span])
        transmittance.read(index, features[1, span])
    gamma = angle_to_sun(omega, lookup.sun)
    features[2] = phase(gamma)
    return features, gamma
