# SPDX-License-Identifier: GPL-3.0-or-later
"""The nearest surfaces in all directions around a point, and how much of the sky they leave open."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..runtime.cancellation import NEVER, CancelToken
from ..scene.camera import Camera
from ..scene.description import Surface
from ..scene.environment import Environment, pixel_directions, pixel_solid_angles
from .depth_buffer import SAMPLES, DepthBuffer
from .lamp_shadow_map import LampShadowMap

#: Rows of images of surfaces; and sample points along an edge of each face of the cube on which they are found.
ROWS, FACE = 32, 64
# Distances along an edge of each face of such a cube, for what surfaces hide from its middle.
HIDING = 512
# The sky is open alike to all of a volume if what is open from several places differs by this share of the sphere on
# the average; surfaces of more triangles are not looked at from several places.
ALIKE, MAX_TRIANGLES = 0.05, 10_000


@dataclass(frozen=True)
class SeenSurfaces:
    """What of surfaces is seen around a point, in P directions.

    pixel: int (P,), of an environment's image of ROWS rows. points, normals: (P, 3), in the world; normals on the side
    that is seen. reflectance, emission: (P, 3), as in Surface. owner: int (P,), number of the surface.
    """

    pixel: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    reflectance: np.ndarray
    emission: np.ndarray
    owner: np.ndarray

    @property
    def solid_angles(self) -> np.ndarray:
        """(P,), of the pixels."""
        return np.broadcast_to(pixel_solid_angles(ROWS), (ROWS, 2 * ROWS)).ravel()[self.pixel]


def see_surfaces(surfaces: Sequence[Surface], eye: np.ndarray, cancel: CancelToken = NEVER) -> SeenSurfaces:
    """The nearest surfaces around a point (3,). Raises Cancelled."""
    directions = pixel_directions(ROWS).reshape(-1, 3)
    triangles = np.concatenate([surface.triangles for surface in surfaces])
    owner = np.repeat(np.arange(len(surfaces)), [len(surface.triangles) for surface in surfaces])
    number = _nearest_triangles(surfaces, eye, directions, cancel)
    pixel = np.flatnonzero(number >= 0)
    number, towards = number[pixel], directions[pixel]
    # Where a pixel's own direction meets the triangle's plane.
    a, b, c = triangles[number].swapaxes(0, 1)
    normal = np.cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = ((a - eye) * normal).sum(axis=1) / (towards * normal).sum(axis=1)
    met = np.isfinite(distance) & (distance > 0.0)
    pixel, number, normal, distance, towards = (values[met] for values in (pixel, number, normal, distance, towards))
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    normal *= np.where((towards * normal).sum(axis=1) > 0.0, -1.0, 1.0)[:, None]
    owner = owner[number]
    reflectance = np.stack([surface.reflectance for surface in surfaces])[owner]
    emission = np.stack([surface.emission for surface in surfaces])[owner]
    return SeenSurfaces(pixel, eye + distance[:, None] * towards, normal, reflectance, emission, owner)


def _nearest_triangles(
    surfaces: Sequence[Surface], eye: np.ndarray, directions: np.ndarray, cancel: CancelToken
) -> np.ndarray:
    """Numbers int (N,), among those of all surfaces, of the triangles around a point in directions (N, 3), or -1."""
    found, size = np.full(len(directions), -1), FACE // SAMPLES
    axis = np.abs(directions).argmax(axis=1)
    for face in range(6):
        cancel.check()
        along, sign = face // 2, 1.0 if face % 2 == 0 else -1.0
        some = np.flatnonzero((axis == along) & (directions[:, along] * sign > 0.0))
        # A camera that looks along its -Z.
        columns = [sign * np.eye(3)[(along + 1) % 3], np.eye(3)[(along + 2) % 3], -sign * np.eye(3)[along]]
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = np.stack(columns, axis=1), eye
        buffer = DepthBuffer(surfaces, Camera(matrix, resolution=(size, size), fov=np.pi / 2.0), cancel)
        local = directions[some] @ matrix[:3, :3]
        column = np.clip((0.5 - 0.5 * local[:, 0] / local[:, 2]) * FACE, 0, FACE - 1).astype(int)
        row = np.clip((0.5 + 0.5 * local[:, 1] / local[:, 2]) * FACE, 0, FACE - 1).astype(int)
        found[some] = buffer.triangles((0, 0, size, size), cancel)[row, column]
    return found


def vantage(surfaces: Sequence[Surface], corners: np.ndarray, camera: Camera) -> np.ndarray | None:
    """A place (3,) in volumes that the camera sees: their middle, or halfway to a corner of their box; None if neither.

    corners: (N, 3), of the volumes.
    """
    covering = [surface.triangles for surface in surfaces if surface.covers and len(surface.triangles)]
    places = _places(corners)
    if not covering:
        return places[0]
    triangles, axis = np.concatenate(covering), camera.world_matrix[:3, 2] / np.linalg.norm(camera.world_matrix[:3, 2])
    for place in places:
        away = camera.world_matrix[:3, 3] - place
        if camera.projection == "orthographic":
            away = (away @ axis) * axis
        if not _meets(place, away, triangles):
            return place
    return None


def _places(corners: np.ndarray) -> np.ndarray:
    """The middle of volumes, and the places halfway to the corners of their box: (9, 3)."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    ends = np.array(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij")).reshape(3, -1).T
    middle = 0.5 * (low + high)
    return np.concatenate([middle[None], 0.5 * (middle + ends)])


def _meets(start: np.ndarray, way: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether a line from a point (3,) along a way (3,) meets any triangle (T, 3, 3) (Moeller and Trumbore 1997)."""
    a, along, up = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(way, up)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (p * along).sum(axis=1)
        u = ((start - a) * p).sum(axis=1) * scale
        q = np.cross(start - a, along)
        v, t = (q @ way) * scale, (q * up).sum(axis=1) * scale
        return bool(np.any((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & (t < 1.0)))


def open_sky(
    surfaces: Sequence[Surface], corners: np.ndarray, eye: np.ndarray, cancel: CancelToken = NEVER
) -> np.ndarray | None:
    """Share (ROWS, 2 ROWS) of each direction's light that surfaces let through to volumes; None where places differ.

    corners: (N, 3), of the volumes. eye: (3,), from `vantage`. Places are it, the volumes' middle and halfway to each
    corner of their box, unless surfaces hide them from the eye. Raises Cancelled.
    """
    shading = [surface for surface in surfaces if surface.shades and len(surface.triangles)]
    if sum(len(surface.triangles) for surface in shading) > MAX_TRIANGLES:
        return None
    if not shading:
        return np.ones((ROWS, 2 * ROWS))
    places = _places(corners)
    hidden = LampShadowMap(shading, eye, HIDING, cancel).visibility(places) < 0.5
    directions = pixel_directions(ROWS).reshape(-1, 3)
    views = [_nearest_triangles(shading, place, directions, cancel) < 0 for place in (eye, *places[~hidden])]
    mean = np.mean(views, axis=0)
    angles = np.broadcast_to(pixel_solid_angles(ROWS), (ROWS, 2 * ROWS)).ravel() / (4.0 * np.pi)
    if np.mean([np.abs(view - mean) @ angles for view in views]) > ALIKE:
        return None
    return mean.reshape(ROWS, 2 * ROWS)


def behind(environment: Environment, sky: np.ndarray) -> Environment:
    """An environment behind surfaces; sky: from `open_sky`."""
    towards = environment.directions()
    row = ((0.5 - np.arcsin(np.clip(towards[..., 2], -1.0, 1.0)) / np.pi) * ROWS).astype(int).clip(0, ROWS - 1)
    column = np.floor(np.arctan2(towards[..., 1], towards[..., 0]) * (ROWS / np.pi)).astype(int) % (2 * ROWS)
    return Environment(
        environment.radiance * sky[row, column, None], environment.world_from_environment, environment.name
    )
