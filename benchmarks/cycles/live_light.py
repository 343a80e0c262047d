# SPDX-License-Identifier: GPL-3.0-or-later
"""Live Light after a sun has turned: errors of its light in Cycles, and when it is shown.

    python -m benchmarks.cycles.live_light [VIEW] [--turns 3]

Turns a sun to where the view's independent reference has it. Prints a row for the coarse light and one for the final
light: its error and bias in Cycles, the seconds by the clock and the processor seconds from the turn until it is shown,
and the longest call of the timer, all medians of so many turns. A further turn is rendered. Between calls, Blender
evaluates the scene, which reads the file. Needs bpy.
"""

import argparse
import statistics
import tempfile
import time
from pathlib import Path

from evaluation.error import relative_bias, relative_rmse

from ..cost.forecast import used
from ..fidelity.views import MASK_ALPHA, View, independent_views
from ..support.extension import extension
from ..support.provenance import made_by
from .baked_light import SAMPLES, stage
from .baked_light import cycles as in_cycles

PROGRAM = "benchmarks.cycles.live_light"
VIEW = "cumulus-100-side-g0.857"
# Radians by which the sun is away from its place before a turn. Each turn has other angles, so that no light is known.
AWAY, BESIDE = 0.3, 0.07
# Seconds between two calls of the timer.
INTERVAL = 0.05


class Live:
    """The live light of a scene, whose timer is called as Blender does."""

    def __init__(self, scene) -> None:
        self.scene, self.longest = scene, 0.0
        self._module = extension().mrpnn_addon.baking.live
        scene.mrpnn_live_light = True

    @property
    def key(self) -> str:
        """Of the light that is shown."""
        return next((item.key for item in self.scene.mrpnn_light.volumes), "")

    def until(self, is_shown) -> tuple[float, float]:
        """Go on until `is_shown(key)`; gives seconds by the clock and processor seconds."""
        import bpy

        start, processor = time.perf_counter(), used()
        while not is_shown(self.key):
            bpy.context.view_layer.update()
            before = time.perf_counter()
            self._module.tick()
            self.longest = max(self.longest, time.perf_counter() - before)
            status, is_problem = self._module.live_status(self.scene)
            assert not is_problem, status
            time.sleep(INTERVAL)
        return time.perf_counter() - start, used() - processor


def is_final(key: str) -> bool:
    """Whether a key is one of final light."""
    return bool(key) and not key.endswith("-coarse")


def measure(view: View, turns: int) -> None:
    """Print the table."""
    from mathutils import Euler

    halves = view.halves()
    mask = halves[..., 3].mean(axis=0) > MASK_ALPHA
    a, b = halves[..., :3] * mask[..., None]
    names = ("coarse", "final")
    times: dict[str, list[tuple[float, float, float]]] = {name: [] for name in names}
    errors = {}
    with tempfile.TemporaryDirectory() as folder:
        scene = stage(view, Path(folder))
        sun = scene.objects["Sun"]
        place = sun.matrix_world.copy()
        live = Live(scene)
        for turn in range(turns + 1):
            sun.matrix_world = place @ Euler((AWAY * (turn + 1), 0.0, 0.0)).to_matrix().to_4x4()
            before = live.key
            live.until(lambda key, before=before: is_final(key) and key != before)
            # The last turn is to the reference's place.
            more = BESIDE * (turns - turn)
            sun.matrix_world = place @ Euler((more, 0.0, 0.0)).to_matrix().to_4x4()
            before, start = live.key, (0.0, 0.0)
            for name, is_shown in (("coarse", lambda key: key.endswith("-coarse")), ("final", is_final)):
                live.longest = 0.0
                took = live.until(lambda key, before=before, shown=is_shown: shown(key) and key != before)
                start = start[0] + took[0], start[1] + took[1]
                if turn < turns:
                    times[name].append((*start, live.longest))
                else:
                    image = in_cycles(scene, Path(folder)) * mask[..., None]
                    errors[name] = relative_rmse(image, a, b, mask).value, relative_bias(image, a, b, mask).value
        scene.mrpnn_live_light = False
    print("| light | error | bias | shown after, seconds | processor seconds | longest call, seconds |")
    print("|---|---|---|---|---|---|")
    for name in names:
        seconds, processor, longest = map(statistics.median, zip(*times[name]))
        error, bias = errors[name]
        print(f"| {name} | {error:.3f} | {100 * bias:+.1f} % | {seconds:.1f} | {processor:.1f} | {longest:.2f} |")
    print(made_by(PROGRAM))


def main() -> None:
    """The command of the docstring."""
    parser = argparse.ArgumentParser(prog=PROGRAM, description=__doc__.split("\n")[0])
    parser.add_argument("view", nargs="?", default=VIEW)
    parser.add_argument("--turns", type=int, default=3)
    options = parser.parse_args()
    extension()
    [view] = [found for found in independent_views() if found.name == options.view]
    print(f"{view.name}, {SAMPLES} samples")
    measure(view, options.turns)


if __name__ == "__main__":
    main()
