# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes and media within the range of single precision, for the same picture."""

from dataclasses import replace
from typing import Any

import numpy as np

from ..scene.description import Medium, Volume
from ..scene.errors import SceneError
from ..scene.sparse_grid import SparseGrid

# A grid whose largest density lies outside is rescaled, and its extinction inversely.
DENSITY_RANGE = (2.0**-20, 2.0**20)
# Albedos whose voxels differ by less are uniform.
SAME_ALBEDO = 1e-6
# Optical thickness of the working cube below which nothing is visible, and above which the picture no longer changes.
MIN_SIGMA_HAT, MAX_SIGMA_HAT = 1e-20, 1e12
# Voxels are indexed with 32-bit integers.
MAX_VOXELS = 2**31 - 1


# Arrays of volumes and of varying albedos by their identity, and what became of them: volume, albedo, and the exponent
# of the factor of density and inverse extinction.
Rescaled = dict[tuple[int, ...], tuple[Volume, Any, int]]


def in_range(volume: Volume, medium: Medium, known: Rescaled | None = None) -> tuple[Volume, Medium]:
    """The volume and medium rescaled into the range of single precision, for the same picture.

    known: of other volumes of the scene, whose instances share what becomes of their voxels; it is added to.

    Raises SceneError for a grid with more voxels than 32 bits can count.
    """
    density = volume.density
    # Dense grids are padded by three voxels on each axis.
    if isinstance(density, SparseGrid):
        voxels = float(density.values.size)
    else:
        voxels = float(np.prod([n + 3.0 for n in density.shape]))
    if voxels > MAX_VOXELS:
        raise SceneError(f"{volume.name}: its grid has more voxels than can be rendered; crop or resample it")
    known = {} if known is None else known
    key = *volume.voxels_key, *(id(grid) for grid in medium.albedo if medium.varies)
    if key not in known:
        known[key] = _rescaled(volume, medium)
    like, albedo, exponent = known[key]
    if like.voxels_key != volume.voxels_key:
        volume = like.instance(volume.world_from_index, volume.name)
    if medium.varies:
        medium = replace(medium, albedo=albedo)
    peak = volume.peak
    if peak == 0.0:
        return volume, medium
    sigma_t = np.ldexp(medium.sigma_t, exponent) if exponent else medium.sigma_t
    size = (np.linalg.norm(volume.world_from_index[:3, :3], axis=0) * volume.density.shape).max()
    sigma_t = np.minimum(sigma_t, MAX_SIGMA_HAT / (peak * size))
    sigma_t = np.where(sigma_t * peak * size < MIN_SIGMA_HAT, 0.0, sigma_t)
    return volume, medium if np.array_equal(sigma_t, medium.sigma_t) else replace(medium, sigma_t=sigma_t)


def _rescaled(volume: Volume, medium: Medium) -> tuple[Volume, Any, int]:
    """As of Rescaled."""
    volume, medium = _bound_albedo(volume, medium)
    if volume.peak == 0.0 or DENSITY_RANGE[0] < volume.peak < DENSITY_RANGE[1]:
        return volume, medium.albedo, 0
    exponent = int(np.frexp(volume.peak)[1])
    scattering = volume.scattering and tuple(_scaled(grid, -exponent) for grid in volume.scattering)
    return replace(volume, density=_scaled(volume.density, -exponent), scattering=scattering), medium.albedo, exponent


def _scaled(grid: np.ndarray | SparseGrid, exponent: int) -> np.ndarray | SparseGrid:
    """Values times a power of two."""
    if isinstance(grid, SparseGrid):
        return grid.with_values(np.ldexp(grid.values, exponent))
    return np.ldexp(grid, exponent)


def _bound_albedo(volume: Volume, medium: Medium) -> tuple[Volume, Medium]:
    """A medium whose albedo varies as a Volume that holds its scattering, and a Medium of the mean albedo.

    Others unchanged. Raises SceneError where albedo and density have different voxels.
    """
    if not medium.varies:
        return volume, medium
    density, scattering, mean, constant = volume.density, [], [], True
    total = _sum(density)
    filled = _voxels(density) > 0.0
    for albedo in medium.albedo:
        if isinstance(density, SparseGrid):
            matches = isinstance(albedo, SparseGrid) and albedo.table is density.table
        else:
            matches = isinstance(albedo, np.ndarray) and albedo.shape == density.shape
        if not matches:
            raise SceneError(f"{volume.name}: an albedo that varies must have the density's voxels")
        inside = _voxels(albedo)[filled]
        low, high = (float(inside.min()), float(inside.max())) if len(inside) else (0.0, 0.0)
        if isinstance(density, SparseGrid):
            scattering.append(density.with_values(density.values * albedo.values))
        else:
            scattering.append(density * albedo)
        constant &= high - low <= SAME_ALBEDO
        mean.append(min(_sum(scattering[-1]) / total, 1.0) if high - low > SAME_ALBEDO else high)
    if constant:
        # One colour costs what a colour costs.
        return volume, replace(medium, albedo=np.array(mean if len(mean) == 3 else mean * 3))
    bound = replace(medium, albedo=np.array(mean if len(mean) == 3 else mean * 3))
    return replace(volume, scattering=tuple(scattering)), bound


def _voxels(grid: np.ndarray | SparseGrid) -> np.ndarray:
    return grid.values if isinstance(grid, SparseGrid) else grid


def _sum(grid: np.ndarray | SparseGrid) -> float:
    return float(_voxels(grid).sum(dtype=np.float64))
