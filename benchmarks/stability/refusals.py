# SPDX-License-Identifier: GPL-3.0-or-later
"""Input that must be refused, and what the message must say."""

import numpy as np

from inference import Camera, Medium, Settings, Sun, Volume, render
from inference.network.network import load_network

from .case import refused
from .placements import CLOUD, EYE, moved, scaled
from .scenes import SUN, camera, placed


def drawn(volumes=None, suns=(SUN,), view=None, settings=None):
    return lambda: render(
        volumes or [(CLOUD, Medium(10.0, 0.5))],
        list(suns),
        view or camera(),
        settings or Settings(1, "single-scattering"),
    )


def beside(k: float):
    """The cloud and a copy, k times as large."""
    return [(CLOUD, Medium(1.0, 0.5)), (moved(CLOUD, np.diag([k, k, k])), Medium(1.0 / k, 0.5))]


def crowd(count: int):
    """So many instances of a single voxel, all over the cloud."""
    one, medium, matrices = placed(np.ones((1, 1, 1))), Medium(1.0, 0.5), np.tile(0.01 * np.eye(4), (count, 1, 1))
    matrices[:, :3, 3] = np.random.default_rng(0).uniform(-0.5, 0.5, (count, 3))
    matrices[:, 3, 3] = 1.0
    return [(one.instance(matrix, f"voxel {n}"), medium) for n, matrix in enumerate(matrices)]


def voxel(value):
    density = CLOUD.density.copy()
    density[3, 4, 5] = value
    return lambda: Volume(density, np.eye(4), "cloud")


CASES = [
    refused("a voxel of NaN", voxel(np.nan), "NaN"),
    refused("a voxel of infinity", voxel(np.inf), "infinite"),
    refused("a negative voxel", voxel(-1.0), "negative"),
    refused("G = 1", lambda: Medium(1.0, 0.5, 1.0), "anisotropy"),
    refused("G = -1", lambda: Medium(1.0, 0.5, -1.0), "anisotropy"),
    refused("G is NaN", lambda: Medium(1.0, 0.5, np.nan), "anisotropy"),
    refused("albedo 1 + 1e-7", lambda: Medium(1.0, 1.0 + 1e-7), "albedo"),
    refused("extinction without end", lambda: Medium(np.inf), "finite"),
    refused("irradiance 1e38", lambda: Sun((0, 0, 1), 1e38), "irradiance"),
    refused("scaled to nothing", lambda: moved(CLOUD, np.diag([1.0, 0.0, 1.0])), "scaled to nothing"),
    refused("camera shifted by NaN", lambda: Camera(np.eye(4), shift=(np.nan, 0.0)), "shift"),
    refused("30000 × 30000 pixels in 8 GiB", drawn(view=camera(pixels=30000)), "raise the limit"),
    refused("1e9 depth samples", lambda: Settings(10**9), "depth samples"),
    refused("a negative seed", lambda: Settings(seed=-1), "seed"),
    refused("a million threads", lambda: Settings(threads=10**6), "threads"),
    refused("memory limit of NaN", lambda: Settings(memory_limit=float("nan")), "memory limit"),
    refused("a network named by a path", lambda: load_network("../../mrpnn"), "no network called"),
    refused(
        "one volume a million times as large as another",
        # An odd number of pixels: the ray in the middle meets both.
        drawn(beside(1e6), view=camera(1e6 * EYE, pixels=11)),
        "view layers of their own",
    ),
    refused(
        "one volume 1e12 times as large as another",
        drawn([(scaled(k)[0], Medium(1.0 / k, 0.5)) for k in (1e-6, 1e6)], view=camera(1e6 * EYE, pixels=11)),
        "view layers of their own",
    ),
    refused(
        "100 000 instances of a voxel in 8 GiB",
        lambda: drawn(crowd(100_000), view=camera(pixels=256))(),
        "raise the limit",
        quick=False,
    ),
    refused("no voxel above 0", drawn([(placed(np.zeros((4, 4, 4))), Medium(1.0))]), "zero everywhere"),
]
