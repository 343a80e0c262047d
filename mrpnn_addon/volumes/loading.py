# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads volumes, and has Cycles render the World, on a thread.

`read_scene` then finds them cached on Blender's main thread.
"""

import subprocess
from collections.abc import Sequence
from typing import TYPE_CHECKING

from ...inference.scene import Cancelled
from ..runtime.background import Worker
from ..world.picture import WorldSource
from .source import VolumeSource
from .velocity import VelocitySource

if TYPE_CHECKING:
    from .reader import VolumeReader


class VolumeLoading(Worker):
    """Reads sources one after the other into a VolumeReader.

    message: the current step.
    """

    def __init__(
        self, reader: "VolumeReader", sources: "Sequence[VolumeSource | VelocitySource | WorldSource]"
    ) -> None:
        self.reader, self.sources = reader, sources
        self._process: subprocess.Popen | None = None
        self.message = sources[0].message if sources else ""
        self._start("mrpnn reading", awaited=False)

    def stop(self) -> None:
        """Ask the thread to stop, which it does at once."""
        super().stop()
        if self._process is not None:
            self._process.kill()

    def _work(self) -> None:
        try:
            for number, source in enumerate(self.sources):
                self.message = source.message
                self.reader.load(source, self._started, self._check)
                self.fraction = (number + 1) / len(self.sources)
        finally:
            self._check()

    def _check(self) -> None:
        if self.stopped:
            raise Cancelled()

    def _started(self, process: subprocess.Popen) -> None:
        self._process = process
        if self.stopped:
            process.kill()
