# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of lamps beside those of one white sun.

    python -m benchmarks.cost.lamps [--sizes 64x64 256x256] [--rounds 3]

Renders a procedural cloud lit by one sun, and by a lamp of each kind outside of it, by a point light inside, by four
suns and four point lights, by a stage of twelve spots, a street of thirty lamps, thirty point lights inside and a
ceiling of thirty-six area lights, in turn, and prints the least seconds of each and their ratios to the sun's.
"""

import numpy as np

from inference import AreaLight, PointLight, SpotLight, Sun

from ..support.light_table import print_table
from .frame import SUN, frame_of, panel

PROGRAM = "benchmarks.cost.lamps"


def lights(volume) -> dict[str, list]:
    """Lights of the volume by name."""
    middle, size = frame_of(volume)
    towards = SUN.direction
    place, power = middle + 1.2 * size * towards, 40.0 * size**2
    area = panel(volume, SUN)
    matrix = area.world_matrix
    across = matrix[:3, 0]
    row = np.linspace(-1.0, 1.0, 30)
    spots = [place + 1.5 * size * (towards + across * along) for along in np.linspace(-0.5, 0.5, 12)]
    posts = middle + size * (np.outer(6.0 * row, [1.0, 0.0, 0.0]) + [0.0, 2.0, 1.2])
    panels = [matrix.copy() for _ in range(36)]
    for number, turn in enumerate(panels):
        x, y = np.divmod(number, 6) - np.full(2, 2.5)
        turn[:3, 3] = middle + size * (2.5 * towards + 0.5 * (x * matrix[:3, 0] + y * matrix[:3, 1]))
    turned = [np.roll(towards, 1) * [1, 1, -1], np.roll(towards, 2), towards * [-1, 1, 1]]
    around = [towards, *turned]
    filled = np.argwhere(volume.density > 0.3 * volume.density.max())
    some = filled[np.random.default_rng(5).integers(len(filled), size=30)] + 0.5
    inside = some @ volume.world_from_index[:3, :3].T + volume.world_from_index[:3, 3]
    return {
        "one white sun": [Sun(towards, 3.0)],
        "a point light": [PointLight(place, power, 0.02 * size)],
        "a spot light": [SpotLight(place, -towards, power, 0.8, 0.2, 0.02 * size)],
        "an area light": [area],
        "a point light inside": [PointLight(middle, power, 0.02 * size)],
        "four suns": [Sun(way, 3.0) for way in around],
        "four point lights": [PointLight(middle + 1.2 * size * way, power) for way in around],
        "twelve spots of a stage": [SpotLight(spot, middle - spot, power, 0.6, 0.2, 0.02 * size) for spot in spots],
        "thirty lamps of a street": [PointLight(post, power, 0.02 * size) for post in posts],
        "thirty point lights inside": [PointLight(point, power / 30.0) for point in inside],
        "thirty-six panels of a ceiling": [AreaLight(turn, "square", 0.3 * size, power) for turn in panels],
    }


def main(options=None):
    print_table(PROGRAM, __doc__, lights, ["64x64", "256x256"], options)


if __name__ == "__main__":
    main()
