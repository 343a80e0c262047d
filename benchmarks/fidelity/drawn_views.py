# SPDX-License-Identifier: GPL-3.0-or-later
"""Views drawn at random from the whole range that the network was trained for, to measure stated errors on.

Everything follows from a view's number: a volume, its density, G, albedo, the camera and the sun. None of the volumes
was trained on, by the network or by that for its error.
"""

import functools
import pathlib

import numpy as np

from inference.scene.description import Volume
from training.data.targets import SIGMA_HAT_RANGE, draw_anisotropy, rays_towards, unit_vectors
from training.procedural.seeded_volume import seeded_volume

from .references import traced_parts
from .views import FOV, View, ViewSpec

#: First seeds of the usual volumes, of those with evened dense parts and of solids.
CALIBRATION_SEEDS = (2_300, 602_300, 502_300)
TEST_SEEDS = (1_000_300, 1_600_300, 1_500_300)
CALIBRATION_VIEWS, TEST_VIEWS = 40, 104
#: Kinds of volumes, numbers in the tuples above, in turn.
KINDS = (0, 1, 0, 0, 1, 0, 2, 0, 1, 0)
#: Pixels per edge; independent parts of a reference and paths per pixel in each. Few pixels with many paths: the
#: network's error is smooth across an image, the references' noise is not.
SIZE, PARTS, PATHS = 16, 8, 256
#: Distance of the camera in edges of the cube.
DISTANCE = 1.5
#: Beyond what was trained: optical thickness and G of the views outside, in turn.
OUTSIDE = ((6000.0, None), (20000.0, None), (None, 0.97), (None, 0.985), (None, -0.6), (6000.0, 0.97))


def seed_of(seeds: tuple[int, int, int], number: int) -> int:
    """The volume's seed of a view's number."""
    return seeds[KINDS[number % len(KINDS)]] + number


@functools.lru_cache(1)
def _volume(seed: int) -> Volume:
    return seeded_volume(seed)[0]


def _density(seed: int) -> np.ndarray:
    return _volume(seed).density


def drawn_view(seed: int, folder: pathlib.Path, outside: tuple[float | None, float | None] = (None, None)) -> View:
    """The view of a volume's seed. folder: of references. outside: sigma_hat and G that replace the drawn ones."""
    random = np.random.default_rng([seed, 29])
    low, high = np.log(SIGMA_HAT_RANGE)
    sigma_hat = float(np.exp(random.uniform(low, high)))
    anisotropy = float(draw_anisotropy(random, 1)[0])
    albedo = 1.0 if random.random() < 0.5 else float(1.0 - 10.0 ** random.uniform(-3.0, -0.3))
    position = DISTANCE * unit_vectors(random, 1)[0]
    # The sun's angle to the camera's axis is uniform, as in training.
    sun = rays_towards(random, -position[None] / DISTANCE, 1)[0]
    up = (0.0, 0.0, 1.0) if abs(position[2]) < 0.9 * DISTANCE else (0.0, 1.0, 0.0)
    sigma_hat, anisotropy = outside[0] or sigma_hat, anisotropy if outside[1] is None else outside[1]
    spec = ViewSpec(str(seed), "drawn", sigma_hat, (albedo,) * 3, anisotropy, SIZE, PATHS)
    reference = functools.partial(traced_parts, folder=folder, parts=PARTS)
    name = f"drawn-{seed}" + ("" if outside == (None, None) else f"-{sigma_hat:g}-g{anisotropy:g}")
    return View(name, spec, functools.partial(_density, seed), sun, position, up, FOV, reference)


def drawn_views(seeds: tuple[int, int, int], count: int, folder: pathlib.Path) -> list[View]:
    """The first `count` views of CALIBRATION_SEEDS or TEST_SEEDS."""
    return [drawn_view(seed_of(seeds, number), folder) for number in range(count)]


def outside_views(folder: pathlib.Path) -> list[View]:
    """Views outside the trained range, one for each of OUTSIDE."""
    numbers = range(len(OUTSIDE))
    return [drawn_view(seed_of(CALIBRATION_SEEDS, 80 + n), folder, OUTSIDE[n % len(OUTSIDE)]) for n in numbers]
