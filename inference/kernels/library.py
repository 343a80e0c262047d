# SPDX-License-Identifier: GPL-3.0-or-later
"""The library of compiled kernels: beside its sources in an installed extension, built on first use in a clone."""

import ctypes
import functools
import os
import threading
from ctypes import POINTER, c_int64
from pathlib import Path

from . import build, field_structures, structures
from .structures import INTERFACE

#: Environment variable that leaves the work to numpy where it is 0.
SWITCH = "MRPNN_COMPILED"

#: Kinds of processors, in the order of dispatch.c.
VARIANTS = ("baseline", "AVX2", "AVX-512")

_loading = threading.Lock()


class Unavailable(Exception):
    """The compiled kernels cannot be used; says why."""


class Kernels:
    """The functions of one library, in one of its variants. Raises Unavailable.

    variant: 0 for any processor, 1 with AVX2, 2 with AVX-512; None for the fastest that this processor can run.
    """

    def __init__(self, path: os.PathLike, variant: int | None = None):
        self.path = Path(path)
        try:
            self._library = ctypes.CDLL(os.fspath(path))
            self._library.mrpnn_interface.restype = c_int64
            number = self._library.mrpnn_interface()
        except (OSError, AttributeError) as error:
            raise Unavailable(f"{os.fspath(path)} cannot be loaded: {error}") from error
        if number != INTERFACE:
            raise Unavailable(f"{os.fspath(path)} has interface {number} instead of {INTERFACE}")
        self._declare("best_variant")
        self._declare("scratch_bytes", POINTER(structures.Scene), c_int64)
        self._declare(
            "march", c_int64, POINTER(structures.Scene), POINTER(structures.Rays), POINTER(structures.Gathered)
        )
        for name, data in field_structures.FUNCTIONS.items():
            self._declare(name, c_int64, POINTER(data))
        #: Variants that this processor can run: 0 to the best one.
        self.best = int(self._library.mrpnn_best_variant())
        self.variant = self.best if variant is None else min(variant, self.best)
        self.name = VARIANTS[self.variant]

    def _declare(self, name: str, *arguments: type) -> None:
        function = getattr(self._library, f"mrpnn_{name}")
        function.restype, function.argtypes = c_int64, arguments

    def scratch_bytes(self, scene: structures.Scene, max_count: int) -> int:
        """Bytes of scratch memory that rays of at most `max_count` steps take."""
        return self._library.mrpnn_scratch_bytes(scene, max_count)

    def march(self, scene: structures.Scene, rays: structures.Rays, gathered: structures.Gathered) -> int:
        """March rays without Python's lock; returns how many of them, fewer than asked for if they were to stop."""
        return self._library.mrpnn_march(self.variant, scene, rays, gathered)

    def prepare(self, name: str, data: structures.Shared) -> int:
        """Call one of `field_structures.FUNCTIONS`, without Python's lock; its result."""
        return getattr(self._library, f"mrpnn_{name}")(self.variant, data)


def load_kernels() -> Kernels:
    """The kernels of this process. Raises Unavailable, with the same reason every time."""
    with _loading:
        kernels, reason = _load()
    if kernels is None:
        raise Unavailable(reason)
    return kernels


@functools.cache
def _load() -> tuple[Kernels | None, str]:
    platform = build.this_platform()
    if platform is None:
        return None, "there is none for this kind of computer"
    shipped = build.SOURCES / build.TARGETS[platform].library
    try:
        return Kernels(shipped if shipped.exists() else build.build(platform)), ""
    except (Unavailable, build.BuildError, OSError) as error:
        return None, str(error)


def wanted(compiled: bool) -> bool:
    """Whether compiled kernels are to be used; compiled: of the settings, which the environment overrules."""
    return compiled and os.environ.get(SWITCH, "1") != "0"
