# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of lamps beside those of one white sun.

    python -m benchmarks.cost.lamps [--sizes 64x64 256x256] [--rounds 3]

Renders a procedural cloud lit by one sun, and by a lamp of each kind outside of it, by a point light inside, by four
suns and four point lights, by a stage of twelve spots, a street of thirty lamps, thirty point lights inside and a
ceiling of thirty-six area lights, in turn, and prints the least seconds of each, their ratios to the sun's, and those
of many lamps to one of them.
"""

import numpy as np

from inference import AreaLight, PointLight, SpotLight, Sun

from ..support.light_table import print_table
from .frame import SUN, frame_of, panel

PROGRAM = "benchmarks.cost.lamps"
#: Of several lamps, the name of one of them.
ALONE = {
    "twelve spots of a stage": "a spot of the stage",
    "thirty lamps of a street": "a lamp of the street",
    "thirty point lights inside": "a point light inside",
    "thirty-six panels of a ceiling": "a panel of the ceiling",
}


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
    stage = [SpotLight(spot, middle - spot, power, 0.6, 0.2, 0.02 * size) for spot in spots]
    street = [PointLight(post, power, 0.02 * size) for post in posts]
    ceiling = [AreaLight(turn, "square", 0.3 * size, power) for turn in panels]
    return {
        "one white sun": [Sun(towards, 3.0)],
        "a point light": [PointLight(place, power, 0.02 * size)],
        "a spot light": [SpotLight(place, -towards, power, 0.8, 0.2, 0.02 * size)],
        "an area light": [area],
        "a point light inside": [PointLight(middle, power, 0.02 * size)],
        "four suns": [Sun(way, 3.0) for way in around],
        "four point lights": [PointLight(middle + 1.2 * size * way, power) for way in around],
        "a spot of the stage": stage[5:6],
        "twelve spots of a stage": stage,
        "a lamp of the street": street[15:16],
        "thirty lamps of a street": street,
        "thirty point lights inside": [PointLight(point, power / 30.0) for point in inside],
        "a panel of the ceiling": ceiling[14:15],
        "thirty-six panels of a ceiling": ceiling,
    }


def main(options=None):
    print_table(PROGRAM, __doc__, lights, ["64x64", "256x256"], options, ALONE)


if __name__ == "__main__":
    main()
