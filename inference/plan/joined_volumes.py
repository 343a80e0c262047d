# SPDX-License-Identifier: GPL-3.0-or-later
"""Many volumes that overlap, which camera rays are marched through as one."""

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..numerics.alike import alike_vector
from ..scene.camera import Camera
from ..scene.description import Medium, Volume
from ..scene.settings import Settings
from .detail import box_corners, smallest_pixels
from .overlap import MANY
from .plan import SortedScene, attenuates, emits

# Voxels of a joined volume at most, bytes of each while a picture is rendered, and fraction of the memory limit that
# they may take.
MOST_VOXELS, VOXEL_BYTES, SHARE_OF_MEMORY = 1 << 26, 24, 0.25
# Edge of its voxels in pixels, and over that of its members' voxels: smaller ones would show nothing more.
PIXELS, FINER = 0.5, 0.5


@dataclass(frozen=True)
class Join:
    """Volumes of a scene, by number, that become one; edge: of its voxels, at least, in world units."""

    members: list[int]
    edge: float
    name: str


def find_joins(scene: SortedScene, camera: Camera, settings: Settings) -> list[Join]:
    """The volumes that become one: of a group, those that differ in density, albedo and strength alone."""
    # Lights are linked to volumes by name, and coverage tells volumes apart.
    receivers = [*(light.receivers for light in scene.lights), *(surface.receivers for surface in scene.surfaces)]
    linked = any(names is not None for names in receivers)
    if "joined_volumes" not in settings.optimizations or linked or "coverage" in settings.outputs:
        return []
    found = []
    for group in scene.groups:
        alike: dict[Hashable, list[int]] = {}
        for v in group if len(group) >= MANY else ():
            volume, medium = scene.volumes[v]
            # Each moves its own way.
            moves = camera.shutter is not None and (volume.motion is not None or volume.velocity is not None)
            if attenuates(volume, medium) and not medium.holdout and not moves:
                alike.setdefault(_kind(*scene.volumes[v]), []).append(v)
        for members in alike.values():
            if len(members) >= MANY:
                found += _joins(scene, members, camera, settings)
    return found


def _kind(volume: Volume, medium: Medium) -> Hashable:
    """Equal for volumes that can become one."""
    colour = alike_vector(medium.sigma_t / medium.sigma_t.max())
    return colour, medium.anisotropy, medium.phase, emits(volume, medium)


def _joins(scene: SortedScene, members: list[int], camera: Camera, settings: Settings) -> list[Join]:
    """One, or none where its voxels would be too many."""
    volumes = [scene.volumes[v][0] for v in members]
    corners = box_corners(volumes).reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    finest = min(float(np.linalg.norm(volume.world_from_index[:3, :3], axis=0).min()) for volume in volumes)
    wanted = max(PIXELS * float(smallest_pixels(camera, settings, corners[None])[0]), FINER * finest)
    # In octaves, so that the voxels stay the same while the camera moves.
    edge = finest * 2.0 ** float(np.floor(np.log2(wanted / finest)))
    most = min(MOST_VOXELS, SHARE_OF_MEMORY * settings.memory_limit / VOXEL_BYTES)
    # The members' own voxels are good enough.
    while np.prod((high - low) / edge) > most and edge < finest:
        edge *= 2.0
    if np.prod((high - low) / edge) > most:
        return []
    return [Join(members, edge, f"{volumes[0].name} and {len(members) - 1} more")]


def with_joined(scene: SortedScene, joins: Sequence[Join], joined: Sequence[tuple[Volume, Medium]]) -> SortedScene:
    """The scene in which one volume each stands at the place of the first member of each Join."""
    volumes, number = dict(enumerate(scene.volumes)), list(range(len(scene.volumes)))
    for join, pair in zip(joins, joined):
        for v in join.members:
            number[v] = join.members[0]
            volumes.pop(v)
        volumes[join.members[0]] = pair
    places = {v: place for place, v in enumerate(sorted(volumes))}
    groups = [sorted({places[number[v]] for v in group}) for group in scene.groups]
    planned = [f"{join.name}: camera rays see one volume" for join in joins]
    return replace(
        scene, volumes=[volumes[v] for v in sorted(volumes)], groups=groups, planned=[*scene.planned, *planned]
    )
