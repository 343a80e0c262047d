# SPDX-License-Identifier: GPL-3.0-or-later
"""Small scenes, one for each feature, for `benchmarks.cycles.scenes`.

A builder takes a `Stage` and changes it. MEASURED are compared with Cycles; NAMED must give a message.
"""

from . import cameras, colours, emission, lights, materials, surfaces, volumes
from .named import NAMED
from .stage import CELLS, SEED, make_stage

__all__ = ["CELLS", "MEASURED", "NAMED", "SEED", "make_stage"]

MEASURED = {
    name: builder
    for subject in (volumes, materials, colours, surfaces, emission, lights, cameras)
    for name, builder in subject.MEASURED.items()
}
