"""Worlds whose nodes are not evaluated here, as Cycles shows them: rendered once in a Blender process of its own."""

import shutil
import subprocess
import tempfile
import time
import weakref
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

from .cycles_process import blender_command
from .environment_image import sampler
from .world_key import world_key

WORKER = Path(__file__).with_name("world_worker.py")
SECONDS, SECONDS_A_LOOK = 120.0, 0.05
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


class WorldSource:
    """A World as it was found in a scene, for a Blender of its own to show: read on any thread, as a `VolumeSource`.

    key: equal where the World looks the same. Made where bpy may be asked.
    """

    def __init__(self, world, scene):
        """world: evaluated; scene: whose frame it is."""
        self.key = "world", world_key(world)
        folder = tempfile.mkdtemp(prefix="mrpnn-")
        weakref.finalize(self, shutil.rmtree, folder, ignore_errors=True)
        self._folder, frame = Path(folder), (str(scene.frame_current), f"{scene.frame_subframe:.6f}")
        blend = str(self._folder / "world.blend")
        bpy.data.libraries.write(blend, {world.original}, path_remap='ABSOLUTE', fake_user=True)
        self._command = blender_command(WORKER, [blend, *frame, str(self._target)])

    @property
    def _target(self) -> Path:
        return self._folder / "world.npz"

    def read(self, started=lambda process: None, check=lambda: None):
        """The WorldPicture, or a PictureFailed that says why there is none; `world_picture` knows it from then on.

        started: called with the process. check: called often; what it raises ends the work.
        """
        log = self._folder / "log.txt"
        with open(log, "w") as output:
            process = subprocess.Popen(self._command, stdin=subprocess.DEVNULL, stdout=output, stderr=output)
        started(process)
        try:
            found = self._answer(process, log, check)
        finally:
            process.kill()
            process.wait()
        while len(_known) >= MOST:
            del _known[next(iter(_known))]
        _known[self.key] = found
        return found

    def _answer(self, process, log, check):
        end = time.monotonic() + SECONDS
        while process.poll() is None:
            check()
            if time.monotonic() > end:
                return PictureFailed(f"Cycles had not shown it after {SECONDS:.0f} seconds")
            time.sleep(SECONDS_A_LOOK)
        # What is asked to stop kills the process.
        check()
        if not self._target.is_file():
            lines = log.read_text(errors="replace").strip().splitlines()
            return PictureFailed("Cycles could not show it: " + (lines[-1] if lines else "its process said nothing"))
        with np.load(self._target) as found:
            return WorldPicture(found["sky"], found["suns"])


def is_known(world) -> bool:
    """Whether `world_picture` has nothing to render."""
    return ("world", world_key(world)) in _known


def world_picture(world, scene, check=lambda: None) -> WorldPicture:
    """What an evaluated World shows in its scene's frame; rendered where it has not been yet, which takes some seconds.

    check: as of `WorldSource.read`. Raises PictureFailed.
    """
    found = _known.get(("world", world_key(world))) or WorldSource(world, scene).read(check=check)
    if isinstance(found, PictureFailed):
        raise found
    return found
