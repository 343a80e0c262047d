# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays marched by the compiled kernel where there is one, by numpy otherwise."""

import dataclasses
from collections.abc import Callable, Sequence
from ctypes import c_int32

from ..grids.bound_medium import BoundMedium
from ..kernels.library import Kernels
from .compiled_march import CompiledMarch
from .emission import emitted_radiance
from .ray_march import MarchOptions, RaySegment, march
from .ray_steps import RayBatch

#: What rays gather whose intervals contain all media, with the emission of some colour channels.
Marcher = Callable[[RayBatch], RaySegment]


def prepare_march(
    kernels: Kernels | None, media: Sequence[BoundMedium], options: MarchOptions, channels: Sequence[int], stop: c_int32
) -> Marcher:
    """How rays are marched through media, safe to use on several threads.

    channels: colour channels, by number. stop: once it is not 0, calls return soon, and what they return is incomplete.
    """
    if kernels is not None:
        return CompiledMarch(kernels, media, options, channels, stop)

    def marched(rays: RayBatch) -> RaySegment:
        emission = emitted_radiance(media, rays, channels, options.optimizations)
        return dataclasses.replace(march(media, rays, options), emission=emission)

    return marched
