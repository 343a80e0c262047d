# SPDX-License-Identifier: GPL-3.0-or-later
"""The library of compiled kernels: of the package mrpnn_kernels in an installed extension, built in a clone."""

import _ctypes
import ctypes
import importlib.util
import os
import threading
from ctypes import POINTER, c_int64
from pathlib import Path
from typing import Any

from ..scene.errors import SceneError
from . import build, structures

#: Kinds of processors, in the order of dispatch.c.
VARIANTS = ("baseline", "AVX2", "AVX-512")

#: The package that brings the library where there are no sources.
PACKAGE = "mrpnn_kernels"

_loading = threading.Lock()
#: Result of `load_kernels`: the kernels, or why there are none.
_kernels: "Kernels | Unavailable | None" = None


class Unavailable(SceneError):
    """The compiled kernels cannot be used; says why, and what to do."""

    def __init__(self, reason: str):
        super().__init__(f"the compiled part of the renderer cannot be used: {reason}")


class Kernels:
    """The functions of one library. Raises Unavailable.

    variant: 0 for any processor, 1 with AVX2, 2 with AVX-512; at first the fastest that this processor can run.
    """

    def __init__(self, path: os.PathLike):
        self.path = Path(path)
        self._library: ctypes.CDLL | None = None
        #: Variants that this processor can run: 0 to the best one.
        self.best = int(self._loaded().mrpnn_best_variant())
        self.variant = self.best

    @property
    def name(self) -> str:
        """Name of the kind of processors."""
        return VARIANTS[self.variant]

    def close(self) -> None:
        """Give the file back, which Windows keeps from being replaced while it is loaded; a later call loads it again.

        No call may be running.
        """
        library, self._library = self._library, None
        if library is not None:
            _close(library)

    def _loaded(self) -> ctypes.CDLL:
        if self._library is None:
            try:
                library = ctypes.CDLL(os.fspath(self.path))
                library.mrpnn_interface.restype = c_int64
                number = library.mrpnn_interface()
            except (OSError, AttributeError) as error:
                raise Unavailable(f"{self.path} cannot be loaded: {error}") from error
            if number != structures.INTERFACE:
                _close(library)
                raise Unavailable(
                    f"{self.path} has interface {number} instead of {structures.INTERFACE}. {_remedy(number)}"
                )
            march = (POINTER(structures.Scene), POINTER(structures.Rays), POINTER(structures.Gathered))
            declared: dict[str, tuple] = {
                "best_variant": (),
                "scratch_bytes": (POINTER(structures.Scene), POINTER(structures.Rays)),
                "march": (c_int64, *march),
                **{name: (c_int64, POINTER(data)) for name, data in structures.FUNCTIONS.items()},
            }
            for name, arguments in declared.items():
                function = getattr(library, f"mrpnn_{name}")
                function.restype, function.argtypes = c_int64, arguments
            self._library = library
        return self._library

    def scratch_bytes(self, scene: structures.Shared, rays: structures.Shared) -> int:
        """Bytes of scratch memory that rays take; sets their `most_met`."""
        return self._loaded().mrpnn_scratch_bytes(scene, rays)

    def march(self, scene: structures.Shared, rays: structures.Shared, gathered: structures.Shared) -> int:
        """March rays without Python's lock; returns how many were marched, fewer than given if `stop` was set."""
        return self._loaded().mrpnn_march(self.variant, scene, rays, gathered)

    def call(self, name: str, data: structures.Shared) -> int:
        """Call one of `structures.FUNCTIONS`, without Python's lock; its result."""
        return getattr(self._loaded(), f"mrpnn_{name}")(self.variant, data)


def _close(library: ctypes.CDLL) -> None:
    if os.name == "nt":
        _ctypes.FreeLibrary(library._handle)  # type: ignore[attr-defined]
    else:
        _ctypes.dlclose(library._handle)


def load_kernels() -> Kernels:
    """The kernels of this process. Raises Unavailable, with the same reason until `unload_kernels`."""
    global _kernels
    with _loading:
        if _kernels is None:
            _kernels = _load()
        kernels = _kernels
    if isinstance(kernels, Unavailable):
        raise kernels
    return kernels


def call(name: str, **fields: Any) -> int:
    """Call one of `structures.FUNCTIONS` with the fields of its structure; its result. Raises Unavailable."""
    return load_kernels().call(name, structures.FUNCTIONS[name](**fields))


def _load() -> Kernels | Unavailable:
    try:
        return Kernels(_find())
    except Unavailable as error:
        return error
    except (build.BuildError, OSError) as error:
        return Unavailable(str(error))


def unload_kernels() -> None:
    """Close the library; `load_kernels` then looks for it again. No call may be running."""
    global _kernels
    with _loading:
        if isinstance(_kernels, Kernels):
            _kernels.close()
        _kernels = None


def _find() -> Path:
    """The library for this process: beside this file, of the sources beside it, or of PACKAGE. Raises Unavailable,
    BuildError and OSError.
    """
    platform = build.this_platform()
    beside, packed = build.SOURCES / build.TARGETS[platform].library, packaged_library(platform)
    if beside.exists():
        return beside
    if not build.sources():
        if packed is None:
            raise Unavailable(f"the package {PACKAGE}, which MRPNN Volumes brings, is missing. {_REINSTALL}")
        return packed
    try:
        return build.build(platform)
    except build.BuildError:
        if packed is None:
            raise
        return packed


def packaged_library(platform: str) -> Path | None:
    """The library in the installed package PACKAGE; None without one."""
    spec = importlib.util.find_spec(PACKAGE)
    if spec is None or not spec.origin:
        return None
    path = Path(spec.origin).parent / build.TARGETS[platform].library
    return path if path.exists() else None


_REINSTALL = "Uninstall MRPNN Volumes, restart Blender, and install the zip for your system"


def _remedy(number: int) -> str:
    """What to do about a library of another interface."""
    if build.sources():
        return "Run python -m inference.kernels"
    # All extensions share one folder of packages, where the highest version wins.
    if number > structures.INTERFACE:
        return (
            "Another repository has a newer MRPNN Volumes, which brought it: remove one of the two in "
            "Preferences > Get Extensions, and restart Blender"
        )
    return f"It is of an older MRPNN Volumes: restart Blender. If that does not help: {_REINSTALL}"
