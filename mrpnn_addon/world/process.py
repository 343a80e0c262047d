# SPDX-License-Identifier: GPL-3.0-or-later
"""A Blender process that loads one World and renders pictures of it with Cycles.

bpy is called only when a WorldProcess is made.
"""

import json
import shutil
import subprocess
import tempfile
import threading
import time
import weakref
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np

from ..runtime.blender_process import blender_command

WORKER = Path(__file__).with_name("worker.py")
SECONDS, POLL_INTERVAL = 120.0, 0.05


class PictureFailed(Exception):
    """Cycles could not render the World; the message has the reason."""


class WorldProcess:
    """Renders one picture at a time, requested by any thread. The process starts with the first picture and again after
    it has ended for lack of requests.
    """

    def __init__(self, world: "bpy.types.World", scene: "bpy.types.Scene") -> None:
        """world: evaluated. scene: gives the frame. Call on Blender's main thread."""
        folder = tempfile.mkdtemp(prefix="mrpnn-")
        self._folder, self._turn = Path(folder), threading.Lock()
        self._running: list[subprocess.Popen] = []
        weakref.finalize(self, _clean, folder, self._running)
        blend, frame = str(self._folder / "world.blend"), (str(scene.frame_current), f"{scene.frame_subframe:.6f}")
        bpy.data.libraries.write(blend, {world.original}, path_remap="ABSOLUTE", fake_user=True)
        self._command = blender_command(WORKER, [blend, *frame])

    def ask(self, job: dict, check: Callable[[], None] = lambda: None, seconds: float = SECONDS) -> dict:
        """The arrays that answer a job of worker.py. Raises PictureFailed where there are none.

        check: called often; an exception that it raises stops the work and the process. seconds: time limit.
        """
        while not self._turn.acquire(timeout=POLL_INTERVAL):
            check()
        try:
            target = self._folder / "picture.npz"
            process = self._send({**job, "target": str(target)})
            self._wait(process, target, check, seconds)
            if not target.is_file() and process.poll() == 0:
                # An idle process may have ended just as it was asked: ask again once.
                process = self._send({**job, "target": str(target)})
                self._wait(process, target, check, seconds)
            if not target.is_file():
                raise PictureFailed(f"Cycles could not render it: {self._last_words()}")
            with np.load(target) as found:
                return dict(found)
        except BaseException:
            self.stop()
            raise
        finally:
            (self._folder / "picture.npz").unlink(missing_ok=True)
            self._turn.release()

    def stop(self) -> None:
        """End the process; the next picture starts another."""
        _end(self._running)

    def _send(self, job: dict) -> subprocess.Popen:
        if not self._running or self._running[0].poll() is not None:
            _end(self._running)
            with open(self._folder / "log.txt", "w") as log:
                self._running.append(
                    subprocess.Popen(self._command, stdin=subprocess.PIPE, stdout=log, stderr=log, text=True)
                )
        process = self._running[0]
        try:
            process.stdin.write(json.dumps(job) + "\n")
            process.stdin.flush()
        except OSError:
            pass  # The process has ended; `ask` notices.
        return process

    def _wait(self, process: subprocess.Popen, target: Path, check: Callable[[], None], seconds: float) -> None:
        end = time.monotonic() + seconds
        while process.poll() is None and not target.is_file():
            check()
            if time.monotonic() > end:
                raise PictureFailed(f"Cycles did not render it within {seconds:.0f} seconds")
            time.sleep(POLL_INTERVAL)
        check()

    def _last_words(self) -> str:
        lines = (self._folder / "log.txt").read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "no output"


def _end(running: list[subprocess.Popen]) -> None:
    while running:
        process = running.pop()
        process.kill()
        process.wait()
        try:
            process.stdin.close()
        except OSError:
            pass  # Unread input is lost.


def _clean(folder: str, running: list[subprocess.Popen]) -> None:
    _end(running)
    shutil.rmtree(folder, ignore_errors=True)
