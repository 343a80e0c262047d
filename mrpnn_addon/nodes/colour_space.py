# SPDX-License-Identifier: GPL-3.0-or-later
"""The space of scene linear colours, which the OpenColorIO configuration or the file chooses: Rec. 709 by default.

Cycles converts blackbodies and the colours of images to it, and a colour's grey is its luminance in it.
"""

import numpy as np
from mathutils import Color

PRIMARIES = np.eye(3)


def from_rec709(colours: np.ndarray) -> np.ndarray:
    """Scene linear colours (..., 3) of linear Rec. 709 ones."""
    columns = [Color(primary).from_rec709_linear_to_scene_linear() for primary in PRIMARIES]
    return colours @ np.array(columns)


def luminance(colours: np.ndarray) -> np.ndarray:
    """(..., 1) of scene linear colours (..., 3)."""
    return colours @ np.array([[Color(primary).from_scene_linear_to_xyz_d65()[1]] for primary in PRIMARIES])
