# SPDX-License-Identifier: GPL-3.0-or-later
"""Smoke and fire of a fluid simulation's domain, as grids."""

import subprocess
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from ...inference.numerics.small_matmul import affine_inverse
from ..nodes.material import VolumeMaterial
from .shaded_grid import ShadedGrid, refine, require_a_grid, shade
from .source import VolumeSource, is_refined
from .voxel_points import Probe, VoxelDomain, components

# Densities up to this have no colour.
MIN_AMOUNT = 1e-6

# Scalar grids, by their names in shaders, and the colour, which is stored times the density, and the density.
GRIDS = ("density", "flame", "heat", "temperature")
COLOUR = "color"
# Three numbers in each voxel.
VELOCITY = "velocity"


def gas_domain(shown_object: "bpy.types.Object") -> Any:
    """Settings of an evaluated object's gas domain; None without one."""
    modifiers: Any = shown_object.modifiers
    for modifier in modifiers:
        if modifier.type == "FLUID" and modifier.fluid_type == "DOMAIN":
            if modifier.domain_settings.domain_type == "GAS":
                return modifier.domain_settings
    return None


def read_grids(domain: Any) -> dict[str, np.ndarray]:
    """The GRIDS that exist in this frame, float32 (nx, ny, nz) each, on the density's voxels, and the components of the
    colour.
    """
    coarse = np.array(domain.domain_resolution)[::-1]
    times = domain.noise_scale if domain.use_noise else 1
    found = {}
    for name in GRIDS:
        values = _values(domain, name)
        if not len(values):
            continue
        # The x axis varies fastest. Noise refines smoke, but not the grids that drive it.
        finer = times if len(values) == coarse.prod() * times**3 else 1
        grid = values.reshape(coarse * finer).T
        if finer < times:
            for axis in range(3):
                grid = np.repeat(grid, times, axis)
        found[name] = np.ascontiguousarray(grid)
    colour = _values(domain, COLOUR).reshape(-1, 4)
    if "density" in found and len(colour) == found["density"].size and colour.any():
        amount = colour[:, 3:]
        plain = np.where(amount > MIN_AMOUNT, colour[:, :3] / np.maximum(amount, MIN_AMOUNT), colour[:, :3])
        for name, values in zip(components(COLOUR), plain.T):
            found[name] = np.ascontiguousarray(values.reshape(found["density"].shape[::-1]).T)
    return found


def velocities(domain: Any) -> tuple[np.ndarray, ...]:
    """Components float32 (nx, ny, nz) of the velocity in this frame, which noise does not refine; () without any."""
    values, coarse = _values(domain, VELOCITY), np.array(domain.domain_resolution)[::-1]
    if len(values) != 3 * coarse.prod():
        return ()
    values[~np.isfinite(values)] = 0.0
    return tuple(np.ascontiguousarray(part.reshape(coarse).T) for part in values.reshape(-1, 3).T)


def is_empty(domain: Any) -> bool:
    """Whether the domain has neither smoke nor fire in this frame."""
    return not any(_values(domain, name).any() for name in ("density", "flame"))


def checksum(domain: Any) -> int:
    """Checksum of the grids in this frame; their names do not change with their content."""
    result = 0
    for name in (*GRIDS, COLOUR):
        result = zlib.crc32(_values(domain, name).data, result)
    return result


def _values(domain: Any, name: str) -> np.ndarray:
    held = getattr(domain, f"{name}_grid")
    values = np.zeros(len(held), np.float32)
    if len(values):
        held.foreach_get(values)
    return values


def vectors_of(grids: dict[str, np.ndarray]) -> tuple[str, ...]:
    """Names of the grids of vectors whose components are among the grids of `read_grids`."""
    return (COLOUR,) if all(name in grids for name in components(COLOUR)) else ()


def probe_grids(material: VolumeMaterial, grids: dict[str, np.ndarray]) -> Probe:
    """A probe that has evaluated a VolumeMaterial where all grids are 0.

    Raises SceneError where the material reads no grid that exists.
    """
    vectors = vectors_of(grids)
    probe = Probe([*grids, *vectors], fills_its_bounds=False, vectors=vectors)
    material.at(probe)
    require_a_grid(material, probe)
    return probe


@dataclass
class FluidSource(VolumeSource):
    """grids: those of `read_grids` that the material reads. generated: (4, 4), object to texture space, which the
    domain fills. probe: has evaluated the shader where all grids are 0.
    """

    grids: dict[str, np.ndarray]
    generated: np.ndarray
    probe: Probe

    def _read(
        self, started: Callable[[subprocess.Popen], None], check: Callable[[], None]
    ) -> tuple[ShadedGrid, np.ndarray, list[str]]:
        grids, shape = self.grids, np.array(next(iter(self.grids.values())).shape)
        texture_from_index = np.diag([*(1.0 / shape), 1.0])
        texture_from_index[:3, 3] = 0.5 / shape
        is_negative = any(values.min() < 0.0 for values in grids.values())
        if is_refined(self.material, self.probe, int(shape.prod()), is_negative):
            grids = {name: refine(values) for name, values in grids.items()}
            texture_from_index[:3, :3] *= 0.5
            texture_from_index[:3, 3] = 0.0
        object_from_index = affine_inverse(self.generated) @ texture_from_index
        frames = {
            "object": object_from_index,
            "world": self.matrix @ object_from_index,
            "generated": texture_from_index,
        }
        domain = VoxelDomain(grids, frames, vectors=vectors_of(grids))
        # Smoke fills a part of most domains, and cells of light are as large as what they hold asks for.
        shaded, first = shade(self.material, domain, check).cropped()
        shifted = object_from_index.copy()
        shifted[:3, 3] += object_from_index[:3, :3] @ first
        return shaded, shifted, []
