# SPDX-License-Identifier: GPL-3.0-or-later
"""The nearest surfaces in all directions around a point, and how much of the sky they leave open."""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..numerics.small_matmul import product
from ..runtime.cancellation import NEVER, CancelToken
from ..scene.camera import Camera
from ..scene.description import Surface
from ..scene.environment import Environment, PlaceWeight, pixel_directions, pixel_numbers, pixel_solid_angles
from .depth_buffer import SAMPLES, DepthBuffer
from .lamp_shadow_map import LampShadowMap

#: Rows of images of surfaces; and sample points along an edge of each face of the cube on which they are found.
ROWS, FACE = 32, 64
# Distances along an edge of each face of such a cube, for what surfaces hide from its middle.
HIDING = 512
# The sky is the same everywhere, or varies linearly, if what is open from several places differs from that by no more
# than this share of the sphere on the average; surfaces of more triangles are not looked at from several places.
ALIKE, LINEAR, MAX_TRIANGLES = 0.025, 0.05, 10_000


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


@dataclass(frozen=True)
class OpenSky:
    """Share (ROWS, 2 ROWS) of each direction's light that surfaces let through to volumes, and where it does."""

    share: np.ndarray
    weight: PlaceWeight | None = None


def open_sky(
    surfaces: Sequence[Surface], corners: np.ndarray, eye: np.ndarray, cancel: CancelToken = NEVER
) -> list[OpenSky]:
    """What surfaces let through to volumes: one sky where it is alike to all of them, else the sum of 2, 4 or 8.

    corners: (N, 3), of the volumes. eye: (3,), from `vantage`. It is seen from there, from the volumes' middle and from
    halfway to each corner of their box, unless surfaces hide these from the eye, and varies linearly along as few axes
    as do. Empty where it varies otherwise, which is checked halfway to the faces of the box. Raises Cancelled.
    """
    shading = [surface for surface in surfaces if surface.shades and len(surface.triangles)]
    if sum(len(surface.triangles) for surface in shading) > MAX_TRIANGLES:
        return []
    if not shading:
        return [OpenSky(np.ones((ROWS, 2 * ROWS)))]
    places, directions = _places(corners), pixel_directions(ROWS).reshape(-1, 3)
    shadows = LampShadowMap(shading, eye, HIDING, cancel)

    def look(places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Those of places (N, 3) that the eye sees, and what is open to each, float64 (N, P)."""
        seen = places[shadows.visibility(places) >= 0.5]
        views = [_nearest_triangles(shading, place, directions, cancel) < 0 for place in seen]
        return seen, np.array(views, np.float64).reshape(len(seen), len(directions))

    seen, views = look(places)
    own = _nearest_triangles(shading, eye, directions, cancel) < 0
    seen, views = np.concatenate([eye[None], seen]), np.concatenate([own[None], views])
    mean = views.mean(axis=0)
    if _difference(views, mean) <= ALIKE:
        return [OpenSky(mean.reshape(ROWS, 2 * ROWS))]
    low, high = places[1:].min(axis=0), places[1:].max(axis=0)
    faces = places[0] + np.concatenate([np.diag(high - places[0]), np.diag(low - places[0])])
    others, checked = look(faces)
    for count in (1, 2, 3):
        fits = []
        for axes in itertools.combinations(range(3), count):
            weights = _linear(low, high, axes)
            shares, known = (np.stack([weight(at) for weight in weights], axis=1) for at in (seen, others))
            found = mean + np.linalg.lstsq(shares, views - mean, rcond=1e-6)[0]
            found = found.clip(0.0, 1.0)
            all_views, all_shares = np.concatenate([views, checked]), np.concatenate([shares, known])
            fits.append((_difference(all_views, all_shares @ found), found, weights))
        difference, found, weights = min(fits, key=lambda fit: fit[0])
        if difference <= LINEAR:
            return [OpenSky(sky.reshape(ROWS, 2 * ROWS), weight) for sky, weight in zip(found, weights)]
    return []


def _difference(views: np.ndarray, sky: np.ndarray) -> float:
    """Mean share of the sphere in which views (N, P) are not a sky, (P,) or (N, P)."""
    angles = np.broadcast_to(pixel_solid_angles(ROWS), (ROWS, 2 * ROWS)).ravel() / (4.0 * np.pi)
    return float(product(np.abs(views - sky), angles).mean())


def _linear(low: np.ndarray, high: np.ndarray, axes: Sequence[int]) -> list[PlaceWeight]:
    """Weights that are linear between the corners (3,) of a box along some axes, and sum to 1."""
    ways = [((low[a], high[a]), (high[a], low[a])) if a in axes else (None,) for a in range(3)]
    return [PlaceWeight(ends) for ends in itertools.product(*ways)]


def behind(environment: Environment, sky: OpenSky) -> Environment:
    """An environment behind surfaces."""
    share = sky.share.reshape(-1)[pixel_numbers(environment.directions(), ROWS)]
    return Environment(
        environment.radiance * share[..., None],
        environment.world_from_environment,
        environment.name,
        sky.weight,
    )
