"""What this scene needs, decided before any work: pure functions of the scene."""

from dataclasses import dataclass, field, replace
from typing import FrozenSet, List, Tuple

import numpy as np

from .dense_grid import refinement
from .omissions import ALL
from .overlap import overlapping
from .ray_light import COLUMNS
from .scene import Camera, Medium, SceneError, Settings, Sun, Volume
from .shared_pixels import BAND
from .sparse_columns import column_bytes
from .sparse_grid import SparseGrid
from .stencil import LEVEL0_CELLS

# Suns count as parallel, and are merged, below this angle in radians.
PARALLEL = 1e-6
# Bytes that the fields of one volume need at the peak, whatever its resolution.
FIELD_BYTES = 42 * LEVEL0_CELLS**3
# Bytes that a voxel of the input needs on top, for itself and for each sun.
VOXEL_BYTES, VOXEL_SUN_BYTES = 16, 5
# Bytes that volumes that are seen as one need on top.
MERGED_BYTES = 12 * LEVEL0_CELLS**3
# Bytes of a voxel that emits, on top.
VOXEL_EMISSION_BYTES = 24
# Bytes for a block of a sparse grid's largest slab, and for any of its blocks.
SLAB_BYTES, CELLS_BYTES = 3 * 4 * 512, 3 * 8
# Bytes of a pixel's images; of its ray while it is rendered; and of each of its depth samples, where every pixel shows
# a volume.
IMAGE_BYTES, RAY_BYTES, SAMPLE_BYTES = 76, 200, 50
# Bytes of a depth sample on top, for each volume and sun: the light along the ray.
LIGHT_BYTES = 2 * 4 * COLUMNS

# Grids whose largest density lies outside are scaled, and their extinction the other way round.
USUAL_DENSITY = (2.0**-20, 2.0**20)
# Pixels that are rendered together.
TILE_PIXELS = 1 << 18

# Optical densities beyond the largest give the same picture, those below the least none at all.
SIGMA_HAT_LEAST, SIGMA_HAT_MOST = 1e-20, 1e12
# Voxels are counted in 32 bits.
MOST_VOXELS = 2**31 - 1


@dataclass
class Channels:
    """Colour channels with one extinction, rendered together.

    indices: of the RGB channels. sigma_t: (V,), of each volume.
    """

    indices: List[int]
    sigma_t: np.ndarray


@dataclass
class Plan:
    """The work that a scene asks for, and in words what it does not."""

    volumes: List[Tuple[Volume, Medium]]
    suns: List[Sun]
    channels: List[Channels]
    groups: List[List[int]]  # (G,), volumes that the network sees as one
    multiple: List[bool]  # (G,), whether the network runs for them
    scattered_glow: List[bool]  # (G,), whether they scatter light that they emit
    planned: List[str] = field(default_factory=list)
    left_out: List[str] = field(default_factory=list)
    leave_out: FrozenSet[str] = ALL  # as in Settings
    memory: int = 0  # bytes, estimated peak on top of the input
    tiles: List[Tuple[int, int]] = field(default_factory=list)  # rows, first and end, that are rendered together

    def pairs(self) -> List[List[Tuple[Volume, Medium]]]:
        """The Volume and Medium of each volume in each group."""
        return [[self.volumes[v] for v in group] for group in self.groups]


def distinct_albedos(medium: Medium, indices: List[int], leave_out: FrozenSet[str] = ALL):
    """Albedos above 0 among some channels, and the channels of each; or those of all channels."""
    if "equal_albedos" not in leave_out:
        return [(float(medium.albedo[c]), [c]) for c in indices]
    values = sorted({float(medium.albedo[c]) for c in indices if medium.albedo[c] > 0.0})
    return [(value, [c for c in indices if medium.albedo[c] == value]) for value in values]


def merge_parallel(suns: List[Sun]) -> List[Sun]:
    """Suns with one direction become one, since light is linear."""
    merged = []
    for sun in suns:
        for other in merged:
            if np.linalg.norm(sun.direction - other.direction) < PARALLEL and sun.spread is None and other.spread is None:
                other.irradiance = other.irradiance + sun.irradiance
                break
        else:
            merged.append(replace(sun))
    return merged


def in_range(volume: Volume, medium: Medium) -> Tuple[Volume, Medium]:
    """The same picture from numbers that single precision holds.

    Raises SceneError for a grid of more voxels than can be counted.
    """
    sparse = isinstance(volume.density, SparseGrid)
    if (volume.density.values.size if sparse else np.prod([n + 3.0 for n in volume.density.shape])) > MOST_VOXELS:
        raise SceneError(f"{volume.name}: its grid has more voxels than can be rendered; crop or resample it")
    density, sigma_t, peak = volume.density, medium.sigma_t, float(volume.density.max())
    if peak == 0.0:
        return volume, medium
    if not USUAL_DENSITY[0] < peak < USUAL_DENSITY[1]:
        exponent = int(np.frexp(peak)[1])
        sigma_t, peak = np.ldexp(sigma_t, exponent), np.ldexp(peak, -exponent)
        if sparse:
            density = density.with_values(np.ldexp(density.values, -exponent))
        else:
            density = np.ldexp(density, -exponent)
        volume = Volume(density, volume.world_from_index, volume.name, volume.emission, volume.emission_power)
    size = (np.linalg.norm(volume.world_from_index[:3, :3], axis=0) * density.shape).max()
    sigma_t = np.minimum(sigma_t, SIGMA_HAT_MOST / (peak * size))
    sigma_t = np.where(sigma_t * peak * size < SIGMA_HAT_LEAST, 0.0, sigma_t)
    return volume, Medium(sigma_t, medium.albedo, medium.anisotropy, medium.emission, medium.phase)


def glows(volume: Volume, medium: Medium) -> bool:
    """Whether a volume emits light."""
    shines = volume.emission is not None and medium.emission > 0.0
    return shines and any(channel.any() for channel in volume.emission_channels())


def attenuates(volume: Volume, medium: Medium) -> bool:
    """Whether a volume takes light away or scatters it."""
    return bool(np.any(medium.sigma_t > 0.0) and volume.density.max() > 0.0)


def tiles_of(y0: int, y1: int, rows: int) -> List[Tuple[int, int]]:
    """Rows of pixels from y0 to y1 in tiles of about `rows`: whole bands of the image, in which pixels share."""
    size = max(rows // BAND, 1) * BAND
    starts = [y0, *range(y0 // BAND * BAND + size, y1, size)]
    return list(zip(starts, [*starts[1:], y1]))


def grid_bytes(volume: Volume, glows: bool, suns: List[Sun]) -> int:
    """Bytes that a volume's grid needs on top of the volume, for itself and its optical depths towards suns."""
    if not isinstance(volume.density, SparseGrid):
        voxel = VOXEL_BYTES + VOXEL_SUN_BYTES * max(len(suns), 1) + VOXEL_EMISSION_BYTES * glows
        return volume.density.size * refinement(volume.density.shape) ** 3 * voxel
    linear = np.linalg.inv(volume.world_from_index)[:3, :3]
    depths = sum(column_bytes(volume.density, linear @ sun.direction) for sun in suns)
    # A row of blocks as an array, and the cells that rays skip.
    blocks = volume.density.table.shape
    return depths + SLAB_BYTES * blocks[1] * blocks[2] + CELLS_BYTES * volume.density.table.size


def make_plan(volumes, suns, camera: Camera, settings: Settings) -> Plan:
    """Decide what to render.

    Raises SceneError where there is nothing to render or the memory limit is too small.
    """
    if not volumes:
        raise SceneError("there is no volume to render")
    if not suns and not any(glows(*pair) for pair in volumes):
        raise SceneError("there is no sun: without light the image would be black")
    planned, left_out = [], []
    volumes = [in_range(volume, medium) for volume, medium in volumes]

    kept = [pair for pair in volumes if attenuates(*pair) or glows(*pair)]
    for volume, medium in volumes:
        if glows(volume, medium):
            planned.append(f"{volume.name}: emission")
        elif not np.any(medium.sigma_t > 0.0):
            left_out.append(f"{volume.name}: its extinction is 0")
        elif not volume.density.max() > 0.0:
            raise SceneError(f"{volume.name}: the density grid is zero everywhere")

    merged = list(suns)
    if "needless_suns" in settings.leave_out:
        bright = [sun for sun in suns if np.any(sun.irradiance > 0.0)]
        left_out += [f"{sun.name}: its irradiance is 0" for sun in suns if not np.any(sun.irradiance > 0.0)]
        merged = merge_parallel(bright)
        if len(merged) < len(bright):
            left_out.append(f"{len(bright) - len(merged)} suns parallel to another: merged")

    # Channels in which every volume has the same extinction share rays, fields and feature stage.
    channels = []
    for c in range(3):
        sigma_t = np.array([m.sigma_t[c] for _, m in kept])
        for group in channels:
            if "equal_channels" in settings.leave_out and np.array_equal(group.sigma_t, sigma_t):
                group.indices.append(c)
                break
        else:
            channels.append(Channels([c], sigma_t))
    if len(channels) == 1:
        left_out.append("two of three colour channels: extinction is grey")

    groups, _ = overlapping([volume for volume, _ in kept])
    multiple, scattered_glow = [], []
    for group in groups:
        names = " and ".join(kept[v][0].name for v in group)
        scatters = any(attenuates(*kept[v]) and bool(distinct_albedos(kept[v][1], [0, 1, 2], settings.leave_out))
                       for v in group)
        multiple.append(settings.multiple and scatters and bool(merged))
        scattered_glow.append(settings.multiple and scatters and any(glows(*kept[v]) for v in group))
        if scattered_glow[-1]:
            planned.append(f"{names}: scattered emission")
        if not multiple[-1]:
            reason = "its albedo or density is 0" if not scatters else "no sun shines"
            reason = reason if settings.multiple else "turned off"
            left_out.append(f"{names}: multiple scattering, {reason}")
        elif len(group) > 1:
            planned.append(f"{names}: multiple scattering, as one medium")
        else:
            stages = len(distinct_albedos(kept[group[0]][1], [0, 1, 2], settings.leave_out))
            planned.append(f"{names}: multiple scattering" + (f" of {stages} albedos" if stages > 1 else ""))

    memory = FIELD_BYTES + sum(grid_bytes(volume, glows(volume, medium), merged) for volume, medium in kept)
    memory += sum(len(group) > 1 for group in groups) * MERGED_BYTES
    x0, y0, x1, y1 = camera.window
    memory += (x1 - x0) * (y1 - y0) * IMAGE_BYTES
    sample = SAMPLE_BYTES + LIGHT_BYTES * len(kept) * len(merged)
    row = (x1 - x0) * (RAY_BYTES + sample * settings.depth_samples)
    rows = -(-TILE_PIXELS // (x1 - x0))
    if len(merged) > 1:
        # The fields of each sun are made for every tile: as few tiles as memory allows.
        rows = max(rows, int((settings.memory_limit - memory) // row))
    tiles = tiles_of(y0, y1, rows)
    memory += row * max(end - start for start, end in tiles)
    if len(tiles) > 1:
        planned.append(f"{len(tiles)} tiles of up to {max(end - start for start, end in tiles)} rows")
    if memory > settings.memory_limit:
        raise SceneError(
            f"the render needs about {memory / 2**30:.1f} GiB and the limit is "
            f"{settings.memory_limit / 2**30:.1f} GiB; raise the limit, or use fewer depth samples, "
            "a smaller image or smaller grids"
        )
    return Plan(
        kept, merged, channels, groups, multiple, scattered_glow, planned, left_out, settings.leave_out, memory, tiles)
