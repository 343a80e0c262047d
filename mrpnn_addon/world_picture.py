"""Worlds whose nodes are not evaluated here, as Cycles shows them: rendered once in a Blender process of its own."""

import subprocess
import tempfile
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .cycles_process import blender_command
from .environment_image import sampler
from .world_key import world_key

WORKER = Path(__file__).with_name("world_worker.py")
SECONDS = 120.0
# Worlds that are remembered: an animated sky is another one in each frame.
MOST = 16


class PictureFailed(Exception):
    """Cycles could not show the World; the message says why."""


@dataclass
class WorldPicture:
    """sky: float32 (rows, columns, 3), equirectangular, rows from the bottom, without sun discs.

    suns: float64 (n, 7), of each disc direction, irradiance and angle across in radians.
    """

    sky: np.ndarray
    suns: np.ndarray

    def radiance(self, directions) -> np.ndarray:
        """(n, 3) from directions (n, 3), without the discs."""
        return sampler(self.sky)(directions)


_known = {}


def world_picture(world, scene) -> WorldPicture:
    """What a World shows in a scene's frame; rendered where it has not been yet, which takes some seconds.

    world: as it is evaluated. Raises PictureFailed.
    """
    key = world_key(world)
    if key not in _known:
        while len(_known) >= MOST:
            del _known[next(iter(_known))]
        _known[key] = _rendered(world.original, scene)
    return _known[key]


def _rendered(world, scene) -> WorldPicture:
    with tempfile.TemporaryDirectory(prefix="mrpnn-") as folder:
        blend, target, log = (Path(folder) / name for name in ("world.blend", "world.npz", "log.txt"))
        bpy.data.libraries.write(str(blend), {world}, path_remap='ABSOLUTE', fake_user=True)
        frame = str(scene.frame_current), f"{scene.frame_subframe:.6f}"
        with open(log, "w") as output:
            try:
                subprocess.run(blender_command(WORKER, [str(blend), *frame, str(target)]), stdin=subprocess.DEVNULL,
                               stdout=output, stderr=output, timeout=SECONDS)
            except subprocess.TimeoutExpired:
                raise PictureFailed(f"Cycles had not shown it after {SECONDS:.0f} seconds") from None
        if not target.is_file():
            lines = log.read_text(errors="replace").strip().splitlines()
            raise PictureFailed("Cycles could not show it: " + (lines[-1] if lines else "its process said nothing"))
        with np.load(target) as found:
            return WorldPicture(found["sky"], found["suns"])
