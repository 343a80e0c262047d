"""Grids of volume files, read on a thread before `read_scene` asks for them on Blender's main thread."""

import contextlib
from dataclasses import dataclass
from typing import List

from ..inference.scene import Cancelled
from .density_grid import EmptyGrid, read_density_grid
from .worker import Worker


@dataclass(frozen=True)
class Wanted:
    """A grid of a file, and the object it is for."""

    path: str
    grid: str
    owner: str


class GridLoading(Worker):
    """Reads grids one after the other, and keeps them in use for as long as this is.

    number: of pictures, as of a Preview.
    """

    message, number = "reading volumes", 0

    def __init__(self, wanted: List[Wanted]):
        self.wanted, self._grids, self._process = wanted, [], None
        self._start("mrpnn reading", awaited=False)

    def stop(self) -> None:
        """Ask it to end; it does at once."""
        super().stop()
        if self._process is not None:
            self._process.kill()

    def _work(self):
        try:
            for number, one in enumerate(self.wanted):
                # Whether a grid may hold nothing depends on the others.
                with contextlib.suppress(EmptyGrid):
                    self._grids.append(read_density_grid(one.path, one.grid, one.owner, self._started))
                self.fraction = (number + 1) / len(self.wanted)
        finally:
            if self.stopped:
                raise Cancelled()

    def _started(self, process):
        self._process = process
        if self.stopped:
            process.kill()
