# SPDX-License-Identifier: GPL-3.0-or-later
"""What baked light was made from, so that only what has changed is baked again."""

import hashlib
from dataclasses import fields

import numpy as np

from ...inference.plan.overlap import overlapping
from ...inference.scene import Light, Medium, Settings, Surface, Volume
from ...inference.scene.sparse_grid import SparseGrid
from ..scene.reader import SceneDescription


def volume_names(description: SceneDescription) -> list[str]:
    """A name for each volume; equal ones are numbered."""
    seen: dict[str, int] = {}
    names = []
    for volume, _ in description.volumes:
        seen[volume.name] = seen.get(volume.name, 0) + 1
        names.append(volume.name if seen[volume.name] == 1 else f"{volume.name} #{seen[volume.name]}")
    return names


def light_keys(description: SceneDescription, settings: Settings) -> list[str]:
    """A digest per volume of all that its baked light depends on: lights, surfaces, network, and overlapping volumes.

    The camera counts only where other directions are not baked.
    """
    around = hashlib.sha256(repr((settings.model, settings.multiple, settings.directional)).encode())
    for sun in description.suns:
        for array in (sun.direction, sun.irradiance, *(sun.spread or ())):
            around.update(np.ascontiguousarray(array).data)
    for lamp in description.lamps:
        values = [getattr(lamp, one.name) for one in fields(lamp) if one.name not in ("name", "receivers")]
        around.update(type(lamp).__name__.encode())
        around.update(repr([v.tolist() if isinstance(v, np.ndarray) else v for v in values]).encode())
    for environment in description.environments:
        for array in (environment.radiance, environment.world_from_environment):
            around.update(np.ascontiguousarray(array).data)
    for surface in description.surfaces:
        around.update(np.ascontiguousarray(surface.triangles).data)
        around.update(repr((surface.shades, surface.stops, *surface.reflectance, *surface.emission)).encode())
    if not settings.directional:
        camera = description.camera
        around.update(np.ascontiguousarray(camera.world_matrix).data)
        around.update(
            repr((camera.projection, camera.resolution, camera.fov, camera.ortho_scale, camera.pixel_aspect)).encode()
        )
    shining = (*description.lights, *description.surfaces)
    around.update(repr([[_lights(one, surface.name) for surface in description.surfaces] for one in shining]).encode())
    own = [
        _volume_digest(volume, medium) + bytes(_lights(one, volume.name) for one in shining)
        for volume, medium in description.volumes
    ]
    keys = [""] * len(own)
    for group in overlapping(description.volumes)[0]:
        together = around.copy()
        for v in group:
            together.update(own[v])
        for v in group:
            keys[v] = hashlib.sha256(together.digest() + own[v]).hexdigest()[:16]
    return keys


def _lights(light: Light | Surface, name: str) -> bool:
    """Whether a light or a glowing surface lights the volume or surface of a name."""
    return light.receivers is None or name in light.receivers


def _volume_digest(volume: Volume, medium: Medium) -> bytes:
    digest = hashlib.sha256(repr((volume.density.shape, volume.emission_power)).encode())
    for grid in (volume.density, *volume.emission_channels(), *(medium.albedo if medium.varies else ())):
        for array in (grid.table, grid.values, grid.first) if isinstance(grid, SparseGrid) else (grid,):
            digest.update(np.ascontiguousarray(array).data)
    for array in (volume.world_from_index, medium.sigma_t, *(() if medium.varies else (medium.albedo,))):
        digest.update(np.ascontiguousarray(array).data)
    digest.update(repr((medium.anisotropy, medium.emission)).encode())
    return digest.digest()
