# SPDX-License-Identifier: GPL-3.0-or-later
"""A volume shader evaluated at every voxel: one density grid with uniform extinction, its albedo, and emission."""

import functools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import bpy
import numpy as np

from ...inference.grids.bounds import filled_bounds
from ...inference.scene import MAX_ANISOTROPY, Volume
from ...inference.scene.phase_function import PhaseFunction
from ...inference.scene.sparse_grid import SparseGrid
from ..nodes.material import EmptyMaterial, MissingGrids, Shading, VolumeMaterial
from ..nodes.phase_functions import phase_function
from .voxel_points import Probe, VoxelDomain, VoxelPoints

VOXELS_PER_BATCH = 1 << 17
# Tolerated variation of colour between voxels, relative to a coefficient's root mean square.
COLOUR_TOLERANCE = 0.01
# A blackbody emits this power of its temperature. Whether Cycles interpolates its emission, as 5.0.1 does, rather than
# its temperature, as 4.5 does.
BLACKBODY_POWER = 4
INTERPOLATES_EMISSION = bpy.app.version >= (5, 0, 0)


@dataclass
class ShadedGrid:
    """density: float32 (nx, ny, nz), or a SparseGrid. sigma_t: float64 (3,), extinction per unit density. albedo:
    float64 (3,), or grids where it varies, see `Medium`. anisotropy: mean cosine. phase: see `Medium`. notes:
    deviations from Cycles. emission: see `Volume`. extinction: where its colour varies, that of each colour channel, as
    `density`, which then is the largest of them; the albedo is three grids. blackbody: further emission, as roots of
    degree BLACKBODY_POWER, which are interpolated as temperatures.
    """

    density: np.ndarray | SparseGrid
    sigma_t: np.ndarray
    albedo: np.ndarray | tuple[np.ndarray | SparseGrid, ...]
    anisotropy: float
    notes: list[str]
    emission: None | np.ndarray | tuple[SparseGrid, ...] = None
    phase: PhaseFunction | None = None
    emission_power: int = 1
    extinction: None | tuple[np.ndarray | SparseGrid, ...] = None
    blackbody: None | np.ndarray | tuple[SparseGrid, ...] = None
    _volume: Volume | None = field(default=None, init=False, repr=False, compare=False)

    def at(self, world_from_index: np.ndarray, name: str) -> Volume:
        """A Volume of these voxels, which are checked once for all instances. Raises SceneError as Volume."""
        if self._volume is None:
            self._volume = Volume(self.density, world_from_index, name, self.emission, self.emission_power)
        return self._volume.instance(world_from_index, name)

    def cropped(self) -> tuple["ShadedGrid", np.ndarray]:
        """Arrays without the empty voxels around; and the first voxel (3,) that is left."""
        glow = [grid for grid in (self.emission, self.blackbody) if isinstance(grid, np.ndarray)]
        emission = [grid[..., c] for grid in glow for c in range(3)]
        bounds = [found for found in map(filled_bounds, (self.density, *emission)) if found is not None]
        if not bounds:
            return self, np.zeros(3, int)
        low, high = np.min([low for low, _ in bounds], axis=0), np.max([high for _, high in bounds], axis=0)
        kept = tuple(map(slice, low, high))

        def crop(grids: Any) -> Any:
            return tuple(grid[kept] for grid in grids) if isinstance(grids, tuple) else grids[kept]

        names = ["density", "emission", "extinction", "blackbody", *["albedo"] * isinstance(self.albedo, tuple)]
        held = {name: getattr(self, name) for name in names}
        return replace(self, **{name: crop(grids) for name, grids in held.items() if grids is not None}), low

    @property
    def parts(self) -> list["ShadedGrid"]:
        """Itself, or where the colour of the extinction varies, what each colour channel attenuates and emits; and the
        light of a blackbody that shines beside other emission. The same objects each time.
        """
        return [self] if self.blackbody is None and self.extinction is None else self._parts

    @functools.cached_property
    def _parts(self) -> list["ShadedGrid"]:
        if self.blackbody is not None:
            return [*replace(self, blackbody=None).parts, self._glow()]
        assert self.extinction is not None
        found = []
        for c, (density, albedo) in enumerate(zip(self.extinction, self.albedo)):
            emission = None if self.emission is None else _one_channel(self.emission, c)
            if density.max() > 0.0 or emission is not None:
                one = replace(self, density=density, sigma_t=np.eye(3)[c], albedo=(albedo,), extinction=None)
                found.append(replace(one, emission=emission))
        return found

    def _glow(self) -> "ShadedGrid":
        """The blackbody alone, where nothing scatters or absorbs."""
        density, nothing = self.density, np.zeros(3)
        empty = density.with_values(0.0 * density.values) if isinstance(density, SparseGrid) else np.zeros_like(density)
        alone = replace(self, density=empty, sigma_t=nothing, albedo=nothing, extinction=None, blackbody=None)
        return replace(alone, emission=self.blackbody, emission_power=BLACKBODY_POWER)


def _one_channel(
    emission: np.ndarray | tuple[SparseGrid, ...], channel: int
) -> np.ndarray | tuple[SparseGrid, ...] | None:
    """Emission of one colour channel alone, as of `Volume`; None where there is none."""
    if isinstance(emission, tuple):
        dark = emission[channel].with_values(np.zeros_like(emission[channel].values))
        parts = tuple(part if c == channel else dark for c, part in enumerate(emission))
        return parts if emission[channel].any() else None
    return emission * np.eye(3, dtype=np.float32)[channel] if emission[..., channel].any() else None


def shade(material: VolumeMaterial, domain: VoxelDomain, check: Callable[[], None] = lambda: None) -> ShadedGrid:
    """Evaluate a material at every voxel of a domain; density, albedo and emission have its shape.

    check: called often; an exception that it raises stops the evaluation.

    Raises SceneError, naming object and material, where the shader cannot be evaluated, or scatters or absorbs where
    every grid is 0; EmptyMaterial where it neither scatters, absorbs nor emits, MissingGrids where that is because of
    grids that do not exist.
    """
    grids, inside, shape = domain.grids, domain.inside, domain.shape

    def at(voxels: np.ndarray) -> tuple[VoxelPoints, Shading]:
        points = VoxelPoints(domain, voxels)
        return points, material.at(points)

    # Two voxels reveal which values are uniform.
    points, shading = at(np.zeros(2, int))
    varies, coloured = 0, False
    uniform, placed = _has_uniform_colour(shading), points.placed
    emits = len(shading.emission) > 1 or shading.emission.any()
    if not shading.closures and not emits:
        _refuse_nothing(material, shading.missing)
    if uniform and inside is None and shading.closures[0].grid and not shading.closures[0].phase_varies:
        # The shader's coefficients are one grid's values, unchanged.
        closure = shading.closures[0]
        density, phases = grids[closure.grid], {closure.phase: float(closure.scatter.mean())}
        if density.min() < 0.0:
            density = np.maximum(density, np.float32(0.0))
    else:
        density = np.zeros(int(np.prod(shape)), np.float32)
        # Sums over voxels of products of coefficients: extinction and scattering, three channels each.
        gram, reference, phases = np.zeros((6, 6)), 0, {}
        for voxels in _chunks(grids, placed, inside):
            check()
            points, shading = at(voxels)
            _sum_phases(phases, shading, len(voxels))
            if uniform:
                density[voxels] = most = np.maximum(shading.closures[0].weight[:, 0], 0.0)
            else:
                coefficients = _coefficients(shading)
                if not gram[reference, reference] > 0.0:
                    reference = int(coefficients[:, :3].sum(axis=0).argmax())
                gram += coefficients.T @ coefficients * (len(voxels) / len(coefficients))
                density[voxels], most = coefficients[:, reference], coefficients[:, :3].max(axis=1)
            if inside is None:
                _require_empty_background(material, points, np.broadcast_to(most, len(voxels)))
        if inside is not None:
            density *= inside.reshape(-1)
        density = density.reshape(shape)
    if not density.max() > 0.0 and not emits:
        _refuse_emptiness(material, shading.missing)
    if uniform:
        closure = shading.closures[0]
        scatter, extinction = closure.scatter[0], closure.scatter[0] + closure.absorb[0]
    else:
        extinction, scatter, varies, coloured = _one_colour(gram, reference)
    if not extinction.max() > 0.0 and not emits:
        _refuse_emptiness(material, shading.missing)
    albedo: np.ndarray | tuple[np.ndarray, ...]
    albedo = np.clip(np.divide(scatter, extinction, out=np.zeros(3), where=extinction > 0.0), 0.0, 1.0)
    if varies:
        albedo = _albedo(at, shape, _chunks(grids, placed, inside), varies, check)
    by_channel = None
    if coloured:
        by_channel = _extinction(at, shape, _chunks(grids, placed, inside), check)
        by_channel = by_channel if inside is None else by_channel * inside
        density = by_channel.max(axis=0)
    notes = shading.notes
    emitting = inside if domain.emitting is None else domain.emitting
    emission, glow, power = None, None, 1
    apart = shading.blackbody is not None and not INTERPOLATES_EMISSION

    def radiance(voxels: np.ndarray) -> np.ndarray:
        found = at(voxels)[1]
        return found.emission - found.blackbody if apart else found.emission

    if emits:
        emission = _emission(radiance, emitting, shape, _chunks(grids, placed, emitting), check)
    if emits and apart:
        glow = _emission(
            lambda voxels: at(voxels)[1].blackbody, emitting, shape, _chunks(grids, placed, emitting), check
        )
        # Cycles interpolates temperatures: the roots of what they emit.
        glow = None if glow is None else np.sign(glow) * np.abs(glow) ** np.float32(1.0 / BLACKBODY_POWER)
    if emission is None and glow is not None:
        emission, glow, power = glow, None, BLACKBODY_POWER
    if len(phases) > 1 and len(shading.closures) > 1:
        notes = notes + [
            "several shaders have different phase functions; their mix is the same everywhere, and multiple "
            "scattering uses Henyey-Greenstein with their mean Anisotropy"
        ]
    phases = {phase: amount for phase, amount in phases.items() if amount > 0.0}
    phase = PhaseFunction.mixed(phases) if phases else phase_function("HENYEY_GREENSTEIN", 0.0)
    anisotropy = float(np.clip(phase.mean_cosine(), -MAX_ANISOTROPY, MAX_ANISOTROPY))
    return ShadedGrid(
        density,
        extinction,
        albedo,
        anisotropy,
        notes,
        emission,
        None if phase.is_henyey_greenstein else phase,
        power,
        None if by_channel is None else tuple(by_channel),
        glow,
    )


def _extinction(
    at: Callable[[np.ndarray], tuple[VoxelPoints, Shading]],
    shape: tuple[int, ...],
    chunks: Iterable[np.ndarray],
    check: Callable[[], None],
) -> np.ndarray:
    """float32 (3, nx, ny, nz) of the voxels in chunks."""
    extinction = np.zeros((3, int(np.prod(shape))), np.float32)
    for voxels in chunks:
        check()
        extinction[:, voxels] = _coefficients(at(voxels)[1])[:, :3].T
    return extinction.reshape(3, *shape)


def _albedo(
    at: Callable[[np.ndarray], tuple[VoxelPoints, Shading]],
    shape: tuple[int, ...],
    chunks: Iterable[np.ndarray],
    count: int,
    check: Callable[[], None],
) -> tuple[np.ndarray, ...]:
    """float32 (nx, ny, nz), once for all colour channels or for each of three, of the voxels in chunks."""
    albedo = np.zeros((count, int(np.prod(shape))), np.float32)
    for voxels in chunks:
        check()
        coefficients = _coefficients(at(voxels)[1])
        extinction, scatter = coefficients[:, :3], coefficients[:, 3:]
        found = np.divide(scatter, extinction, out=np.zeros_like(scatter), where=extinction > 0.0)
        albedo[:, voxels] = np.clip(found if count == 3 else found.max(axis=1, keepdims=True), 0.0, 1.0).T
    return tuple(albedo.reshape(count, *shape))


def _emission(
    radiance: Callable[[np.ndarray], np.ndarray],
    emitting: np.ndarray | None,
    shape: tuple[int, ...],
    chunks: Iterable[np.ndarray],
    check: Callable[[], None],
) -> np.ndarray | None:
    """float32 (nx, ny, nz, 3) of the voxels in chunks; None where all are 0.

    radiance: of voxels. emitting: see VoxelDomain.
    """
    emission = np.zeros((int(np.prod(shape)), 3), np.float32)
    for voxels in chunks:
        check()
        emission[voxels] = radiance(voxels)
    emission = emission.reshape(*shape, 3)
    if emitting is not None:
        emission *= emitting[..., None]
    return emission if emission.any() else None


def _chunks(grids: dict[str, np.ndarray], placed: bool, inside: np.ndarray | None) -> Iterator[np.ndarray]:
    """Yield voxels to shade, int64 (n,) at a time: where the mesh or any grid is not 0, or all where the shader reads
    positions.
    """
    arrays = [values.reshape(-1) for values in (grids.values() if inside is None else (inside,))]
    for start in range(0, arrays[0].size, VOXELS_PER_BATCH):
        parts = [values[start : start + VOXELS_PER_BATCH] for values in arrays]
        everywhere = placed and inside is None
        filled = [part != 0.0 for part in parts]
        voxels = np.arange(len(parts[0])) if everywhere else np.flatnonzero(np.any(filled, axis=0))
        if len(voxels):
            yield start + voxels


def _has_uniform_colour(shading: Shading) -> bool:
    return len(shading.closures) == 1 and len(shading.closures[0].scatter) == len(shading.closures[0].absorb) == 1


def _coefficients(shading: Shading) -> np.ndarray:
    """(n, 6): summed extinction and scattering of all closures."""
    total = np.zeros((1, 6))
    for closure in shading.closures:
        weight = np.maximum(closure.weight, 0.0)
        scatter, absorb = weight * closure.scatter, weight * closure.absorb
        total = total + np.concatenate(np.broadcast_arrays(scatter + absorb, scatter), axis=1)
    return total


def _sum_phases(phases: dict, shading: Shading, voxels: int) -> None:
    """Add to `phases` the scattering of so many voxels by each phase function."""
    for closure in shading.closures:
        scattered = voxels * float((np.maximum(closure.weight, 0.0) * closure.scatter).mean())
        if scattered > 0.0:
            phases[closure.phase] = phases.get(closure.phase, 0.0) + scattered


def _one_colour(gram: np.ndarray, reference: int) -> tuple[np.ndarray, np.ndarray, int, bool]:
    """(extinction, scatter) (3,) per unit of the reference channel's extinction; of how many channels the albedo
    varies: 0 where it does not, 1 where it is grey, 3 otherwise; and whether the colour of the extinction varies.
    """
    diagonal = np.maximum(np.diag(gram), 0.0)
    if not diagonal[reference] > 0.0:
        return np.zeros(3), np.zeros(3), 0, False
    share = gram[reference] / diagonal[reference]
    left = diagonal - gram[reference] ** 2 / diagonal[reference]
    varies = left > COLOUR_TOLERANCE**2 * diagonal
    if varies[:3].any():
        return share[:3], np.clip(share[3:], 0.0, share[:3]), 3, True
    if not varies[3:].any():
        return share[:3], share[3:], 0, False
    # Scattering per extinction of each channel, compared with that of the first that scatters.
    scale = np.concatenate([share[:3], share[:3]])
    scaled = gram / np.maximum(np.outer(scale, scale), 1e-30)
    first = 3 + int(np.argmax(np.diag(scaled)[3:]))
    apart = np.diag(scaled)[3:] + scaled[first, first] - 2.0 * scaled[first, 3:]
    grey = np.all((share[:3] > 0.0) & (apart <= COLOUR_TOLERANCE**2 * scaled[first, first]))
    return share[:3], share[3:], 1 if grey else 3, False


def is_linear(material: VolumeMaterial, probe: Probe) -> bool:
    """Whether doubled grid values double all coefficients: voxel values then determine those between them.

    probe: has read the grids. Blackbody emission is ignored where `INTERPOLATES_EMISSION`.
    """
    half, whole = (
        _all_coefficients(shading_at(material, probe, dict.fromkeys(probe.names, value))) for value in (0.5, 1.0)
    )
    return bool(np.allclose(2.0 * half, whole, rtol=1e-6, atol=1e-12))


def shaping_grids(material: VolumeMaterial, probe: Probe, names: list[str]) -> list[str]:
    """Those of the named grids without which a material's density differs, or else all."""
    ones = dict.fromkeys(probe.names, 1.0)

    def extinction(values: dict[str, float]) -> np.ndarray:
        return _coefficients(shading_at(material, probe, values))[0, :3]

    return [name for name in names if not np.allclose(extinction({**ones, name: 0.0}), extinction(ones))] or names


def shading_at(material: VolumeMaterial, probe: Probe, values: dict[str, float]) -> Shading:
    """The shading at a point where each grid that the probe has read has one value."""
    grids = {name: np.full((1, 1, 1), values[name], np.float32) for name in probe.names}
    frames = {kind: np.eye(4) for kind in ("object", "world", "generated")}
    domain = VoxelDomain(grids, frames, vectors=probe.vectors)
    return material.at(VoxelPoints(domain, np.zeros(1, int)))


def _all_coefficients(shading: Shading) -> np.ndarray:
    """(9,) extinction, scattering and emission at one point.

    Blackbody emission is ignored where `INTERPOLATES_EMISSION`.
    """
    emits = np.zeros(3) if shading.blackbody is not None and INTERPOLATES_EMISSION else shading.emission[0]
    return np.concatenate([_coefficients(shading)[0], emits])


def refine(values: np.ndarray, outside: float = 0.0) -> np.ndarray:
    """Twice as many voxels per axis, at the old ones, halfway between them and halfway to the value outside.

    float32 (nx, ny, nz) to (2 nx + 1, 2 ny + 1, 2 nz + 1); the trilinear interpolant is unchanged.
    """
    for axis in range(3):
        padded = np.pad(values, [(1, 1) if a == axis else (0, 0) for a in range(3)], constant_values=outside)
        shape = list(values.shape)
        shape[axis] = 2 * shape[axis] + 1
        fine = np.empty(shape, np.float32)
        at = [slice(None)] * 3
        at[axis] = slice(1, None, 2)
        fine[tuple(at)] = values
        at[axis] = slice(0, None, 2)
        lower, upper = [slice(None)] * 3, [slice(None)] * 3
        lower[axis], upper[axis] = slice(None, -1), slice(1, None)
        fine[tuple(at)] = 0.5 * padded[tuple(lower)] + 0.5 * padded[tuple(upper)]
        values = fine
    return values


def require_empty_background(material: VolumeMaterial, shading: Shading, backgrounds: dict[str, float]) -> None:
    """Raise SceneError where a shading at a point outside all grids, whose values there are given, has density."""
    if not shading.closures or not _coefficients(shading)[:, :3].max() > 0.0:
        return
    for name, background in backgrounds.items():
        if background:
            material.refuse(
                f'grid "{name}" has background {background:g}, endless fog outside its voxels; save it with '
                "background 0"
            )
    _refuse_background(material)


def require_a_grid(material: VolumeMaterial, probe: Probe) -> None:
    """Raise SceneError where a material, evaluated by the probe, reads no grid that exists."""
    if probe.names:
        return
    shading = material.at(probe)
    if shading.missing or not (shading.closures or shading.emission.any()):
        _refuse_nothing(material, shading.missing)
    material.refuse(
        "the material reads no grid, so no grid shapes the volume; enter a grid's name in Density Attribute or link "
        f"an Attribute node (grids: {', '.join(probe.available)})"
    )


def _require_empty_background(material: VolumeMaterial, points: VoxelPoints, density: np.ndarray) -> None:
    empty = np.ones(len(density), bool)
    for name in points.names:
        empty &= points.grids[name].reshape(-1)[points.voxels] == 0.0
    if np.any(density[empty] > 0.0):
        _refuse_background(material)


def _refuse_nothing(material: VolumeMaterial, missing: list[str]) -> None:
    if missing:
        raise MissingGrids(" and ".join(missing))
    material.refuse("it neither scatters, absorbs nor emits, so there is nothing to render", EmptyMaterial)


def _refuse_emptiness(material: VolumeMaterial, missing: list[str]) -> None:
    problem = "its density is 0 everywhere, so the volume is empty"
    if missing:
        raise MissingGrids(" and ".join(missing))
    material.refuse(problem, EmptyMaterial)


def _refuse_background(material: VolumeMaterial) -> None:
    material.refuse(
        "it has density where the grids are 0, endless fog that Cycles cuts off at boxes around the "
        "voxels; multiply the result by a grid in the last node"
    )
