# SPDX-License-Identifier: GPL-3.0-or-later
"""The gallery's scenes by name, in the order of its page."""

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from . import clouds, rooms, smoke


class Entry(NamedTuple):
    """A scene of the gallery.

    make: of the folder for its .vdb files and the detail of its volumes, 1 for the full one; gives Blender's scene.
    text: what the page says of it.
    """

    title: str
    make: Callable[[Path, float], object]
    text: str


SCENES = {
    "noon": Entry(
        "Cumulus at noon",
        clouds.noon,
        "The cloud is white because its light scatters many times. With a few bounces, it would be grey.",
    ),
    "dusk": Entry("Cumulus at dusk", clouds.dusk, "Baked light, so that Cycles shows the cloud in the water, too."),
    "inside": Entry("Among clouds", clouds.inside, "The camera stands within the volume, and looks towards a low sun."),
    "storm": Entry("Thunderstorm", clouds.storm, "Point lights within the cloud are its lightning."),
    "plume": Entry(
        "Smoke",
        smoke.plume,
        "Dark smoke, which absorbs half of the light at each scattering. It comes from a simulation.",
    ),
    "fire": Entry("Fire", smoke.fire, "A grid of temperatures makes the fire glow. Its light scatters in the smoke."),
    "explosion": Entry("Explosion", smoke.explosion, "A sequence of 24 files: render it as an animation."),
    "fog": Entry("Fog in a church", rooms.fog, "Walls shade the fog and light it. Composite over Cycles renders them."),
    "stage": Entry(
        "Stage",
        rooms.lights,
        "Seven coloured spots in haze, over a stage that Cycles renders.",
    ),
    "milk": Entry(
        "Milk in water",
        rooms.milk,
        "Baked light alone shows a volume behind a surface that refracts. Cycles alone errs less here.",
    ),
    "nebula": Entry("Nebula", rooms.nebula, "Gas that glows, and dust around three stars."),
}
