# SPDX-License-Identifier: GPL-3.0-or-later
"""The nearest surfaces in all directions around a point, and how much of the sky they leave open."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..numerics.small_matmul import product
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.camera import Camera
from ..scene.description import Surface
from ..scene.environment import Environment, pixel_directions, pixel_numbers, pixel_solid_angles
from .depth_buffer import SAMPLES, DepthBuffer
from .sky_visibility import SkyVisibility

#: Rows of images of surfaces; and sample points along an edge of each face of the cube onto which they are rasterized.
ROWS, FACE = 32, 64
# Largest mean fraction of the sphere by which the sky at several points may differ from their mean, to be the same.
ALIKE = 0.025


@dataclass(frozen=True, kw_only=True)
class SeenPoints:
    """P points of surfaces.

    points, normals: (P, 3), in the world; normals on the side that is seen. owner: int (P,), number of the surface.
    """

    points: np.ndarray
    normals: np.ndarray
    owner: np.ndarray


@dataclass(frozen=True, kw_only=True)
class SeenSurfaces(SeenPoints):
    """The surfaces that are seen around a point, in P directions.

    pixel: int (P,), of an environment's image of ROWS rows. reflectance, emission: (P, 3), as in Surface.
    """

    pixel: np.ndarray
    reflectance: np.ndarray
    emission: np.ndarray

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
    return SeenSurfaces(
        pixel=pixel,
        points=eye + distance[:, None] * towards,
        normals=normal,
        reflectance=reflectance,
        emission=emission,
        owner=owner,
    )


def _nearest_triangles(
    surfaces: Sequence[Surface], eye: np.ndarray, directions: np.ndarray, cancel: CancelToken
) -> np.ndarray:
    """Numbers int (N,), among those of all surfaces, of the triangles around a point in directions (N, 3), or -1."""
    numbers, size = np.full(len(directions), -1), FACE // SAMPLES
    axis = np.abs(directions).argmax(axis=1)
    for face in range(6):
        cancel.check()
        along, sign = face // 2, 1.0 if face % 2 == 0 else -1.0
        on_face = np.flatnonzero((axis == along) & (directions[:, along] * sign > 0.0))
        # A camera that looks along its -Z.
        columns = [sign * np.eye(3)[(along + 1) % 3], np.eye(3)[(along + 2) % 3], -sign * np.eye(3)[along]]
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = np.stack(columns, axis=1), eye
        buffer = DepthBuffer(surfaces, Camera(matrix, resolution=(size, size), fov=np.pi / 2.0), cancel)
        local = product(directions[on_face], matrix[:3, :3])
        column = np.clip((0.5 - 0.5 * local[:, 0] / local[:, 2]) * FACE, 0, FACE - 1).astype(int)
        row = np.clip((0.5 + 0.5 * local[:, 1] / local[:, 2]) * FACE, 0, FACE - 1).astype(int)
        numbers[on_face] = buffer.triangles((0, 0, size, size), cancel)[row, column]
    return numbers


def vantage(surfaces: Sequence[Surface], corners: np.ndarray, camera: Camera) -> np.ndarray | None:
    """A point (3,) in volumes that the camera sees: their middle, or halfway to a corner of their box; None if neither.

    corners: (N, 3), of the volumes.
    """
    covering = [surface.triangles for surface in surfaces if surface.covers and len(surface.triangles)]
    points = _viewpoints(corners)
    if not covering:
        return points[0]
    triangles, axis = np.concatenate(covering), camera.world_matrix[:3, 2] / np.linalg.norm(camera.world_matrix[:3, 2])
    for point in points:
        away = camera.world_matrix[:3, 3] - point
        if camera.projection == "orthographic":
            away = product(away, axis) * axis
        if not _meets(point, away, triangles):
            return point
    return None


def _viewpoints(corners: np.ndarray) -> np.ndarray:
    """The middle of volumes, and the points halfway to the corners of their box: (9, 3)."""
    low, high = corners.min(axis=0), corners.max(axis=0)
    ends = np.array(np.meshgrid(*np.stack([low, high], axis=1), indexing="ij")).reshape(3, -1).T
    middle = 0.5 * (low + high)
    return np.concatenate([middle[None], 0.5 * (middle + ends)])


def _meets(start: np.ndarray, direction: np.ndarray, triangles: np.ndarray) -> bool:
    """Whether the segment from start to start + direction meets any triangle (T, 3, 3) (Moeller and Trumbore 1997)."""
    a, along, up = triangles[:, 0], triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = np.cross(direction, up)
    with np.errstate(divide="ignore", invalid="ignore"):
        scale = 1.0 / (p * along).sum(axis=1)
        u = ((start - a) * p).sum(axis=1) * scale
        q = np.cross(start - a, along)
        v, t = product(q, direction) * scale, (q * up).sum(axis=1) * scale
        return bool(np.any((u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0) & (t < 1.0)))


@dataclass(frozen=True)
class OpenSky:
    """What surfaces let through of the sky to volumes.

    fraction: (ROWS, 2 ROWS), of the light of each direction, the same everywhere; 1 where visibility tells.
    visibility: where that differs from point to point, else None.
    """

    fraction: np.ndarray
    visibility: SkyVisibility | None = None

    def behind(self, environment: Environment) -> Environment:
        """An environment behind the surfaces."""
        fraction = self.fraction.reshape(-1)[pixel_numbers(environment.directions(), ROWS)]
        light = environment.radiance * fraction[..., None]
        return Environment(light, environment.world_from_environment, environment.name, self.visibility)


def open_sky(
    surfaces: Sequence[Surface], corners: np.ndarray, eye: np.ndarray | None, cancel: CancelToken = NEVER
) -> OpenSky:
    """The sky as surfaces let it through to volumes.

    corners: (N, 3), of the volumes. eye: (3,), from `vantage`, or None. The sky is the same everywhere if the eye, the
    volumes' middle and points halfway to each corner of their box see about the same, those that the eye does not see
    left out. Raises Cancelled.
    """
    whole = np.ones((ROWS, 2 * ROWS))
    shading = [surface for surface in surfaces if surface.shades and len(surface.triangles)]
    if not shading:
        return OpenSky(whole)
    visibility = SkyVisibility([surface.triangles for surface in shading], corners, cancel)
    if eye is None:
        return OpenSky(whole, visibility)
    points = _viewpoints(corners)
    triangles = np.concatenate([surface.triangles for surface in shading])
    points = np.stack([eye, *(point for point in points if not _meets(eye, point - eye, triangles))])
    seen = visibility.towards(points)
    if np.abs(seen - seen.mean(axis=0)).mean() > ALIKE:
        return OpenSky(whole, visibility)
    directions = pixel_directions(ROWS).reshape(-1, 3)
    views = [_nearest_triangles(shading, point, directions, cancel) < 0 for point in points]
    return OpenSky(np.mean(views, axis=0).reshape(ROWS, 2 * ROWS))
