# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles in a separate Blender process, which leaves this one usable and can be ended at any time."""

import json
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path

import bpy

from ...inference.scene import SceneError
from ..runtime.blender_process import blender_command
from .choices import CHOICES, REFERENCE, Choice
from .pass_store import Job, Pass
from .reference import read_image, require_box_alpha
from .reference_scene import PathTracing, box_scene, view_scene

WORKER = Path(__file__).with_name("worker.py")
# First seed of the reference's passes, so that no candidate shares one.
REFERENCE_SEED = 1000
CHECK = "check"


class PassFailed(Exception):
    """Cycles could not render a pass; the message has the reason."""


class CyclesProcess:
    """Renders passes of a view asynchronously.

    Writes the view to a file when made, on Blender's main thread; takes the arguments of `reference_scene.view_scene`
    and raises its errors. The process starts with the first pass and checks Cycles on a homogeneous box before it.
    """

    def __init__(
        self,
        scene: "bpy.types.Scene",
        objects: "Sequence[bpy.types.Object]",
        bounces: int,
        world: "bpy.types.World" = None,
    ) -> None:
        self._folder = tempfile.TemporaryDirectory(prefix="mrpnn-")
        self._process: subprocess.Popen[str] | None = None
        self._asked, self._checked, self._bounces = "", False, bounces
        try:
            tracing = PathTracing(1, bounces)
            with view_scene(scene, objects, tracing, world) as view, box_scene(self._folder.name) as box:
                self._view, self._box = view.name, box.name
                # Blender 5.2 crashes when it writes a scene whose view layers have not been updated.
                for made in (view, box):
                    made.view_layers[0].update()
                bpy.data.libraries.write(str(self._path("scene.blend")), {view, box}, path_remap="ABSOLUTE")
        except BaseException:
            self.stop()
            raise

    def ask(self, job: Job) -> None:
        """Start a pass; `answer` returns it."""
        if self._process is None:
            self._start()
            self._send(CHECK, self._box, 64, 0, Choice())
        seed = job.seed + (REFERENCE_SEED if job.method == REFERENCE else 0)
        self._send(job.name, self._view, job.samples, seed, CHOICES[job.method])
        self._asked = job.name

    def answer(self) -> Pass | None:
        """The requested pass, or None until it is finished.

        Raises PassFailed where Cycles could not render it, SceneError where Cycles fails the check or its process has
        ended.
        """
        for name in ([] if self._checked else [CHECK]) + [self._asked]:
            found = self._answer(name)
            if found is None:
                return None
            if "error" in found:
                raise PassFailed(found["error"])
            image = read_image(self._path(f"{name}.exr"))
            self._path(f"{name}.exr").unlink()
            if name == CHECK:
                require_box_alpha(float(image[..., 3].mean()))
                self._checked = True
        return Pass(image, found["seconds"], found["cpu_seconds"])

    def stop(self) -> None:
        """End the process and remove its files."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process.stdin.close()
            self._process = None
        self._folder.cleanup()

    def _answer(self, name: str) -> dict | None:
        path = self._path(f"{name}.json")
        # Checked before the file: an ended process has written its files.
        ended = self._process.poll() is not None
        if not path.exists():
            if ended:
                raise SceneError(f"the Blender that renders Cycles' images ended: {self._last_words()}")
            return None
        return json.loads(path.read_text())

    def _start(self) -> None:
        command = blender_command(WORKER, [str(self._path("scene.blend")), self._folder.name])
        with open(self._path("log.txt"), "w") as log:
            self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=log, stderr=log, text=True)

    def _send(self, name: str, scene: str, samples: int, seed: int, choice: Choice) -> None:
        settings = {"samples": samples, "seed": seed, **choice.settings(self._bounces)}
        ask = {"name": name, "scene": scene, "settings": settings}
        try:
            self._process.stdin.write(json.dumps(ask) + "\n")
            self._process.stdin.flush()
        except OSError:
            pass  # The process has ended; `answer` reports it.

    def _last_words(self) -> str:
        lines = self._path("log.txt").read_text(errors="replace").strip().splitlines()
        return lines[-1] if lines else "no output"

    def _path(self, name: str) -> Path:
        return Path(self._folder.name) / name
