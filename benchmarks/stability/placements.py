# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes and cameras in extreme places, turned, scaled and sheared."""

import numpy as np

from .renders import RenderSpec, render_case
from .scenes import along, blob, camera, moved, placed, rotation

CLOUD = placed(blob())
EYE = np.array((1.7, -1.3, 2.1))


def scaled(k: float):
    return moved(CLOUD, np.diag([k, k, k])), 10.0 / k, camera(k * EYE)


def shifted(distance: float):
    offset = distance * np.array((1.0, -0.7, 0.4))
    matrix = np.eye(4)
    matrix[:3, 3] = offset
    return moved(CLOUD, matrix), 10.0, camera(EYE + offset, target=offset)


def sheared(amount: float):
    matrix = np.eye(3)
    matrix[0, 1], matrix[2, 0] = amount, -0.5 * amount
    return moved(CLOUD, matrix), 10.0, camera(EYE * (1.0 + amount / 2.0))


TURNS = {"1e-7 rad": rotation(1e-7), "1e-4 rad": rotation(1e-4), "0.7 rad": rotation(0.7)}
STRETCHED = {
    "mirrored": (-1.0, 1.0, 1.0),
    "flat to 1e-3": (1.0, 1.0, 1e-3),
    "flat to 1e-6": (1e-6, 1.0, 1.0),
    "stretched by 100": (1.0, 100.0, 1.0),
}
CAMERAS = {
    "at the centre": camera((0.0, 0.0, 0.0), target=(0.2, 0.1, -1.0)),
    "at a voxel's centre, along an axis": camera((1 / 32, 1 / 32, 1 / 32), target=(1.0, 1 / 32, 1 / 32)),
    "on a face": camera((0.0, 0.0, 0.53125)),
    "at a corner": camera((0.53125, 0.53125, 0.53125)),
    "field of view 1e-6": camera(fov=1e-6),
    "field of view 3.1": camera((0.3, 0.2, 0.1), fov=3.1),
    "1e7 away, orthographic": along((0.3, 0.2, -1.0), distance=1e7),
    "orthographic scale 1e-4": along((0.3, 0.2, -1.0), ortho_scale=1e-4),
    "orthographic scale 1e5": along((0.3, 0.2, -1.0), ortho_scale=1e5, pixels=11),
    "one pixel": camera(pixels=1),
    **{
        f"along {name}, orthographic": along(axis, pixels=11)
        for name, axis in (("x", (1, 0, 0)), ("y", (0, 1, 0)), ("-z", (0, 0, -1)))
    },
}

CASES = [
    *(
        render_case("placement", f"scale {k:g}", RenderSpec(*scaled(k)), quick=k == 1e-6)
        for k in (1e-6, 1e-3, 1e3, 1e6)
    ),
    *(
        render_case("placement", f"{d:g} from the origin", RenderSpec(*shifted(d)), quick=d == 1e7)
        for d in (1e3, 1e5, 1e7)
    ),
    *(render_case("placement", f"sheared by {a:g}", RenderSpec(*sheared(a)), alpha=5e-3) for a in (1.5, 10.0)),
    *(render_case("placement", f"turned by {name}", RenderSpec(moved(CLOUD, turn))) for name, turn in TURNS.items()),
    *(
        render_case(
            "placement", name, RenderSpec(moved(CLOUD, np.diag(size))), quick=name == "flat to 1e-6", alpha=5e-3
        )
        for name, size in STRETCHED.items()
    ),
    *(
        render_case(
            "camera",
            name,
            RenderSpec(CLOUD, view=view),
            bias=0.04,
            quick=name in ("at the centre", "along x, orthographic"),
        )
        for name, view in CAMERAS.items()
    ),
]
