# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays marched by the compiled kernel where there is one, by numpy otherwise."""

import dataclasses
from collections.abc import Callable, Sequence
from ctypes import c_int32

from ..grids.bound_medium import BoundMedium
from ..kernels.library import Kernels
from .compiled_march import CompiledMarch
from .emission import emitted_radiance
from .lamp_march import LampMarch, march_lamps
from .ray_march import MarchOptions, RaySegment, march
from .ray_steps import RayBatch

#: What rays gather whose intervals contain all media, with the emission of some colour channels.
Marcher = Callable[[RayBatch], RaySegment]


def prepare_march(
    kernels: Kernels | None,
    media: Sequence[BoundMedium],
    options: MarchOptions,
    channels: Sequence[int],
    stop: c_int32,
    lamps: LampMarch | None = None,
) -> Marcher:
    """How rays are marched through media, safe to use on several threads.

    channels: colour channels, by number. stop: once it is not 0, calls of the kernel soon raise Cancelled.
    lamps: whose light is gathered, too; None for none.
    """
    if kernels is not None:
        return CompiledMarch(kernels, media, options, channels, stop, lamps)

    def marched(rays: RayBatch) -> RaySegment:
        emission = emitted_radiance(media, rays, channels, options.optimizations)
        segment = dataclasses.replace(march(media, rays, options), emission=emission)
        if lamps is None:
            return segment
        samples = segment.sample_ray, segment.sample_distance
        return dataclasses.replace(segment, lamps=march_lamps(media, rays, lamps, options, samples))

    return marched
