# SPDX-License-Identifier: GPL-3.0-or-later
"""A volume's bounding box, voxel size and approximate density, known without reading the volume."""

import weakref
from dataclasses import dataclass

import numpy as np

from ...inference.plan.resolution import refinement
from ...inference.scene import Medium, SceneError, Volume
from ...inference.scene.sparse_grid import SparseGrid
from ..nodes.material import VolumeMaterial, first_material
from ..objects.visibility import VisibleObject
from ..objects.workload import Box
from .fluid_domain import gas_domain
from .mesh_fill import CELLS
from .reader import density_scale
from .voxel_points import Probe

# Peak of a grid while none has been read: clouds have 1, simulated smoke more.
USUAL_PEAK = 2.0


class _OnesProbe(Probe):
    """One point where every grid is 1."""

    def has(self, name: str) -> bool:
        return True

    def _read(self, name: str) -> np.ndarray:
        return np.ones((1, 1))


@dataclass
class _Density:
    """What reading a volume revealed.

    extinction: its largest, per world unit. unit: `_extinctions` at that time. density: reference to its grid. peak:
    the grid's maximum. filled: share of positive voxels.
    """

    extinction: float
    unit: float
    density: weakref.ref
    peak: float
    filled: float


_densities: dict[str, _Density] = {}


def box_around(shown: VisibleObject) -> tuple[Box, int]:
    """The box of a visible volume, and how many of its colour channels differ in extinction."""
    corners = np.array(shown.object.bound_box, float)
    low, high = corners.min(axis=0), corners.max(axis=0)
    edges = np.maximum((high - low) * np.linalg.norm(shown.matrix[:3, :3], axis=0), 1e-9)
    voxel, longest = _voxel(shown, edges)
    cells = max(edges.max() / longest, 1.0)
    # The renderer refines small grids.
    times = refinement((int(np.ceil(cells)),))
    unit = _extinctions(shown)
    extinction = _extinction(shown.name, float(unit.max()))
    box = Box(
        shown.name,
        shown.matrix,
        low,
        high,
        voxel / times,
        extinction * longest / times,
        cells * times,
        _densities[shown.name].filled if shown.name in _densities else None,
        times,
    )
    return box, len(set(np.round(unit, 6).tolist()))


def remember_density(shown: VisibleObject, volume: Volume, medium: Medium) -> None:
    """Remember the density of a volume that has been read."""
    known = _densities.get(shown.name)
    if known is not None and known.density() is volume.density:
        peak, filled = known.peak, known.filled
    else:
        peak, density = float(volume.density.max()), volume.density
        values = density.values if isinstance(density, SparseGrid) else density
        filled = np.count_nonzero(values) / float(np.prod(volume.density.shape, dtype=float))
    _densities[shown.name] = _Density(
        peak * float(np.max(medium.sigma_t)),
        float(_extinctions(shown).max()),
        weakref.ref(volume.density),
        peak,
        filled,
    )


def forget_densities() -> None:
    """Forget all volumes."""
    _densities.clear()


def _extinction(name: str, unit: float) -> float:
    """Largest extinction of a volume, per world unit: of the volume as read, scaled by the change of its material
    since; otherwise as if its grid were like those read.
    """
    if name in _densities and _densities[name].unit > 0.0:
        return _densities[name].extinction * unit / _densities[name].unit
    peaks = [known.extinction / known.unit for known in _densities.values() if known.unit > 0.0]
    return unit * (float(np.mean(peaks)) if peaks else USUAL_PEAK)


def _extinctions(shown: VisibleObject) -> np.ndarray:
    """(3,) extinction per world unit where all grids are 1; 1 for materials that cannot be evaluated."""
    scale = 1.0
    if shown.object.type == "VOLUME":
        scale = density_scale(shown.data.render.space, shown.matrix)
    meshed = shown.object.type != "VOLUME" and not gas_domain(shown.object)
    try:
        material = VolumeMaterial(first_material(shown.object), shown.name, shown.object)
        shading = material.at(_OnesProbe((), fills_its_bounds=meshed))
    except SceneError:
        # Rendering reports the problem.
        return np.full(3, scale)
    found = np.zeros(3)
    for closure in shading.closures:
        found += np.max(closure.weight * (closure.scatter + closure.absorb), axis=0)
    return scale * found


def _voxel(shown: VisibleObject, edges: np.ndarray) -> tuple[float, float]:
    """Shortest and longest edge of a voxel, world units."""
    domain, data = gas_domain(shown.object), shown.data
    if shown.object.type == "VOLUME" and data.grids.is_loaded and len(data.grids):
        matrix = shown.matrix @ np.array(data.grids[0].matrix_object)
        sizes = np.linalg.norm(matrix[:3, :3], axis=0)
        if sizes.min() > 0.0:
            return float(sizes.min()), float(sizes.max())
    cells = max(domain.domain_resolution) if domain else CELLS
    return (float(edges.max() / cells),) * 2
