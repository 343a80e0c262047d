# SPDX-License-Identifier: GPL-3.0-or-later
"""Reads the files of an animation's next frame while this one renders."""

import re
import subprocess
from collections.abc import Sequence
from pathlib import Path

from ...inference.scene import SceneError
from ..runtime.background import Worker
from ..vdb.density_grid import DensityGrid, read_density_grid
from ..world.picture import WorldSource
from .source import FileSource, VolumeSource
from .velocity import FileVelocity, VelocitySource


def following_file(path: str, step: int) -> str | None:
    """The file `step` numbers behind one of a numbered sequence, if there is one."""
    match = re.search(r"(\d+)(\D*)$", Path(path).name)
    if match is None:
        return None
    digits = match[1]
    name = f"{Path(path).name[: match.start()]}{int(digits) + step:0{len(digits)}d}{match[2]}"
    found = Path(path).with_name(name)
    return str(found) if found.is_file() else None


class ReadAhead(Worker):
    """Reads the grids that sources will want `step` frames later, and holds them until it is dropped.

    `read_density_grid` then finds them in use. A file that cannot be read is left for its own frame to report.
    """

    message = "reading volumes"

    def __init__(self, sources: "Sequence[VolumeSource | VelocitySource | WorldSource]", step: int) -> None:
        self.wanted = [
            (path, name, source.owner)
            for source in sources
            if isinstance(source, (FileSource, FileVelocity)) and source.is_sequence
            for path in [following_file(source.path, step)]
            if path is not None
            for name in source.names
        ]
        self.held: list[DensityGrid] = []
        self._process: subprocess.Popen | None = None
        self._start("mrpnn reading ahead", awaited=False)

    def stop(self) -> None:
        """Ask the thread to stop, which it does at once."""
        super().stop()
        if self._process is not None:
            self._process.kill()

    def _work(self) -> None:
        for path, name, owner in self.wanted:
            if self.stopped:
                return
            try:
                self.held.append(read_density_grid(path, name, owner, self._started))
            except (SceneError, MemoryError):
                pass

    def _started(self, process: subprocess.Popen) -> None:
        self._process = process
        if self.stopped:
            process.kill()
