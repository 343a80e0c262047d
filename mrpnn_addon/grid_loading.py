"""Grids of volume files, read on a thread before `read_scene` asks for them on Blender's main thread."""

import contextlib
import threading
from dataclasses import dataclass
from typing import List

from ..inference.scene import Cancelled
from .density_grid import EmptyGrid, read_density_grid


@dataclass(frozen=True)
class Wanted:
    """A grid of a file, and the object it is for."""

    path: str
    grid: str
    owner: str


class GridLoading:
    """Reads grids one after the other, and keeps them in use for as long as this is.

    done: whether it is at its end. error: what ended it early, or None. fraction, message: how far it is.
    stopped: whether it was asked to end. number: of pictures, as of a Preview.
    """

    message, number = "reading volumes", 0

    def __init__(self, wanted: List[Wanted]):
        self.wanted, self.error, self.fraction, self.stopped = wanted, None, 0.0, False
        self._grids, self._process = [], None
        self._thread = threading.Thread(target=self._run, args=(wanted,), name="mrpnn reading", daemon=True)
        self._thread.start()

    @property
    def done(self) -> bool:
        return not self._thread.is_alive()

    @property
    def cancelled(self) -> bool:
        return isinstance(self.error, Cancelled)

    def stop(self) -> None:
        """Ask it to end; it does at once."""
        self.stopped = True
        if self._process is not None:
            self._process.kill()

    def wait(self, seconds=None) -> None:
        """Until it is done, but no longer than that."""
        self._thread.join(seconds)

    def _run(self, wanted):
        try:
            for number, one in enumerate(wanted):
                # Whether a grid may hold nothing depends on the others.
                with contextlib.suppress(EmptyGrid):
                    self._grids.append(read_density_grid(one.path, one.grid, one.owner, self._started))
                self.fraction = (number + 1) / len(wanted)
        except BaseException as error:  # Carried to the main thread, which knows how to show it.
            self.error = error
        if self.stopped:
            self.error = Cancelled()

    def _started(self, process):
        self._process = process
        if self.stopped:
            process.kill()
