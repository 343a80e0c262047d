# SPDX-License-Identifier: GPL-3.0-or-later
"""Suns along axes, faces, corners and the camera; their irradiance; phase functions and albedos."""

import numpy as np

from inference import Sun

from .placements import CLOUD
from .renders import RenderSpec, render_case
from .scenes import camera, placed

BOX = placed(np.ones((16, 16, 16)))
VIEW = camera()
DIRECTIONS = {
    "x": (1, 0, 0),
    "-x": (-1, 0, 0),
    "y": (0, 1, 0),
    "z": (0, 0, 1),
    "-z": (0, 0, -1),
    "an edge": (1, 1, 0),
    "a corner": (1, 1, 1),
    "1e-9 off x": (1, 1e-9, 0),
    "1e-3 off x": (1, 1e-3, 0),
}
TOWARDS_CAMERA = VIEW.world_matrix[:3, 2]

CASES = [
    *(
        render_case(
            "sun",
            f"along {name}, {what}, σ̂ = {s:g}",
            RenderSpec(volume, s, suns=(Sun(direction),)),
            bias=0.03,
            quick=(name, s) in (("x", 1e3), ("a corner", 10.0)) and volume is BOX,
        )
        for name, direction in DIRECTIONS.items()
        for what, volume in (("cloud", CLOUD), ("box", BOX))
        for s in (10.0, 1e3)
    ),
    render_case(
        "sun", "behind the camera (γ = π)", RenderSpec(CLOUD, suns=(Sun(TOWARDS_CAMERA),), anisotropy=0.857), quick=True
    ),
    render_case(
        "sun", "in front of the camera (γ = 0)", RenderSpec(CLOUD, suns=(Sun(-TOWARDS_CAMERA),), anisotropy=0.857)
    ),
    *(
        render_case("sun", f"irradiance {e:g}", RenderSpec(CLOUD, suns=(Sun((0.4, 0.3, 0.8), e),)))
        for e in (1e-6, 1e8, 1e30)
    ),
    *(
        render_case(
            "phase function",
            f"G = {g:g}, sun in front",
            RenderSpec(CLOUD, suns=(Sun(-TOWARDS_CAMERA),), anisotropy=g),
            quick=abs(g) == 0.999,
            single=0.15,
        )
        for g in (-0.999, -0.5, 0.0, 1e-12, 0.5, 0.95, 0.999)
    ),
    *(
        render_case("albedo", f"albedo {a!r}", RenderSpec(CLOUD, albedo=a), quick=a == 1.0)
        for a in (1e-9, 0.5, 1.0 - 1e-7, 1.0)
    ),
]
