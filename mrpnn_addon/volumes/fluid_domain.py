"""Smoke and fire that the domain of a fluid simulation holds, as grids."""

import zlib
from dataclasses import dataclass
from typing import Dict

import numpy as np

from .shaded_grid import refuse_nothing, shade
from .source import VolumeSource
from .voxel_points import Probe

#: Grids of one number a voxel, by the names that shaders know them by.
GRIDS = ("density", "flame", "heat", "temperature")


def gas_domain(shown_object):
    """Settings of an evaluated object's gas domain, None where it is none."""
    for modifier in shown_object.modifiers:
        if modifier.type == 'FLUID' and modifier.fluid_type == 'DOMAIN' and modifier.domain_settings.domain_type == 'GAS':
            return modifier.domain_settings
    return None


def read_grids(domain) -> Dict[str, np.ndarray]:
    """What there is of GRIDS in this frame, float32 (nx, ny, nz) each, on the density's voxels."""
    coarse = np.array(domain.domain_resolution)[::-1]
    times = domain.noise_scale if domain.use_noise else 1
    found = {}
    for name in GRIDS:
        values = _values(domain, name)
        if not len(values):
            continue
        # Along x first. Noise makes smoke finer, but not what drives it.
        finer = times if len(values) == coarse.prod() * times**3 else 1
        grid = values.reshape(coarse * finer).T
        if finer < times:
            for axis in range(3):
                grid = np.repeat(grid, times, axis)
        found[name] = np.ascontiguousarray(grid)
    return found


def holds_nothing(domain) -> bool:
    """Whether the domain holds neither smoke nor fire in this frame."""
    return not any(_values(domain, name).any() for name in ("density", "flame"))


def checksum(domain) -> int:
    """Of what there is in this frame: it changes under one name."""
    result = 0
    for name in GRIDS:
        result = zlib.crc32(_values(domain, name), result)
    return result


def _values(domain, name: str) -> np.ndarray:
    held = getattr(domain, f"{name}_grid")
    values = np.zeros(len(held), np.float32)
    if len(values):
        held.foreach_get(values)
    return values


def probe_grids(material, grids) -> Probe:
    """That has met a VolumeMaterial where all grids are 0.

    Raises SceneError where the material reads a grid that is not there, or none.
    """
    probe = Probe(list(grids), fills_its_bounds=False)
    at_zero = material.at(probe)
    for name in probe.names:
        if name not in grids:
            material.refuse(f"the fluid domain holds no grid \"{name}\"; there are: {', '.join(grids)}")
    if not probe.names:
        if not at_zero.closures and not at_zero.emission.any():
            refuse_nothing(material)
        material.refuse("the material reads no grid, so no smoke shapes the volume; enter density in Density Attribute or "
                        f"link an Attribute node (grids of the domain: {', '.join(grids)})")
    return probe


@dataclass
class FluidSource(VolumeSource):
    """grids: those of `read_grids` that the material reads. generated: (4, 4), object to texture space, which the domain
    fills.
    """

    grids: Dict[str, np.ndarray]
    generated: np.ndarray

    def _read(self, started, check):
        shape = np.array(next(iter(self.grids.values())).shape)
        texture_from_index = np.diag([*(1.0 / shape), 1.0])
        texture_from_index[:3, 3] = 0.5 / shape
        object_from_index = np.linalg.inv(self.generated) @ texture_from_index
        frames = {"object": object_from_index, "world": self.matrix @ object_from_index, "generated": texture_from_index}
        return shade(self.material, self.grids, frames, check=check), object_from_index, []
