# SPDX-License-Identifier: GPL-3.0-or-later
"""Processor seconds of environments beside those of one white sun.

    python -m benchmarks.cost.environments [--sizes 64x64 1920x1080] [--rounds 3]

Renders a procedural cloud lit by one white sun, by a grey environment, by a coloured one, and by the sun and the
coloured environment together, in turn, and prints the least seconds of each and their ratios to the sun's.
"""

from inference import Sun

from ..support.light_table import print_table
from .frame import SUN, skies

PROGRAM = "benchmarks.cost.environments"


def lights(volume) -> dict[str, list]:
    """Lights by name."""
    sun, (grey, coloured) = Sun(SUN.direction, 3.0), skies()
    return {
        "one white sun": [sun],
        "a grey environment": [grey],
        "a coloured environment": [coloured],
        "sun and coloured environment": [sun, coloured],
    }


def main(options=None):
    print_table(PROGRAM, __doc__, lights, ["64x64", "1920x1080"], options)


if __name__ == "__main__":
    main()
