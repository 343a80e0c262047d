"""A Blender process of its own that holds one World and shows it by Cycles, picture after picture.

bpy is asked only where a process is made.
"""

import json
import shutil
import subprocess
import tempfile
import threading
import time
import weakref
from pathlib import Path

import bpy
import numpy as np

from ..runtime.blender_process import blender_command

WORKER = Path(__file__).with_name("worker.py")
SECONDS, POLL_INTERVAL = 120.0, 0.05


class PictureFailed(Exception):
    """Cycles could not show the World; the message says why."""


class WorldProcess:
    """Asked on any thread, one picture at a time. The process starts with the first, and again after it was silent for
    long enough to end by itself.
    """

    def __init__(self, world, scene):
        """world: evaluated; scene: whose frame it is. Made where bpy may be asked."""
        folder = tempfile.mkdtemp(prefix="mrpnn-")
        self._folder, self._running, self._turn = Path(folder), [], threading.Lock()
        weakref.finalize(self, _clean, folder, self._running)
        blend, frame = str(self._folder / "world.blend"), (str(scene.frame_current), f"{scene.frame_subframe:.6f}")
        bpy.data.libraries.write(blend, {world.original}, path_remap='ABSOLUTE', fake_user=True)
        self._command = blender_command(WORKER, [blend, *frame])

    def ask(self, job: dict, check=lambda: None, seconds: float = SECONDS) -> dict:
        """The arrays that a job of worker.py is answered with. Raises PictureFailed where there are none.

        check: called often; what it raises ends the work, and the process with it. seconds: after which it has failed.
        """
        while not self._turn.acquire(timeout=POLL_INTERVAL):
            check()
        try:
            target = self._folder / "picture.npz"
            # One that has ended by itself may have done so just when it was asked.
            for last in (False, True):
                process = self._send({**job, "target": str(target)})
                self._wait(process, target, check, seconds)
                if target.is_file():
                    with np.load(target) as found:
                        return dict(found)
                if last or process.poll() != 0:
                    raise PictureFailed(f"Cycles could not show it: {self._last_words()}")
        except BaseException:
            self.stop()
            raise
        finally:
            (self._folder / "picture.npz").unlink(missing_ok=True)
            self._turn.release()

    def stop(self) -> None:
        """End the process at once; the next picture starts another."""
        _end(self._running)

    def _send(self, job):
        if not self._running or self._running[0].poll() is not None:
            _end(self._running)
            with open(self._folder / "log.txt", "w") as log:
                self._running.append(
                    subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=log, stderr=log, text=True))
        process = self._running[0]
        try:
            process.stdin.write(json.dumps(job) + "\n")
            process.stdin.flush()
        except OSError:
            pass  # It has ended, which `ask` finds.
        return process

    def _wait(self, process, target, check, seconds):
        end = time.monotonic() + seconds
        while process.poll() is None and not target.is_file():
            check()
            if time.monotonic() > end:
                raise PictureFailed(f"Cycles had not shown it after {seconds:.0f} seconds")
            time.sleep(POLL_INTERVAL)
        check()

    def _last_words(self):
        lines = (self._folder / "log.txt").read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "its process said nothing"


def _end(running):
    while running:
        process = running.pop()
        process.kill()
        process.wait()
        try:
            process.stdin.close()
        except OSError:
            pass  # What it has not read is lost.


def _clean(folder, running):
    _end(running)
    shutil.rmtree(folder, ignore_errors=True)
