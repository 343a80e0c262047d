# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays through pixel centres, and the pixels that can show a part of the world."""

import numpy as np

from ..numerics.small_matmul import inverse, product
from .camera import Camera, Lens, SphericalEye


def camera_rays(camera: Camera) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Rays through the pixels of the camera's window, row by row from the top.

    Returns origins and unit directions, float64 (N, 3) in the world, and the distances (N,) along each ray to the near
    and the far clipping plane.
    """
    x0, y0, x1, y1 = camera.window
    columns, rows = np.meshgrid(np.arange(x0, x1), np.arange(y0, y1))
    return pixel_rays(camera, columns.ravel(), rows.ravel())


def pixel_rays(
    camera: Camera, columns: np.ndarray, rows: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """As `camera_rays`, through pixels of the image by column and row, int (N,)."""
    origins, directions, cosine = image_rays(camera, columns + 0.5, rows + 0.5)
    # Clipping planes are perpendicular to the viewing axis; those of equirectangular cameras are spheres.
    return origins, directions, camera.clip[0] / cosine, camera.clip[1] / cosine


def image_rays(camera: Camera, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays through points (N,) of the image, in pixels from its upper left corner.

    Returns origins and unit directions, float64 (N, 3) in the world, and the cosines (N,) between ray and viewing axis;
    1 for equirectangular cameras, which clip by distance along the ray.
    """
    width, height = camera.resolution
    u, v = camera.on_plane(x, y)
    rotation = camera.world_matrix[:3, :3] / np.linalg.norm(camera.world_matrix[:3, :3], axis=0)
    eye = camera.world_matrix[:3, 3]
    forward = np.full_like(u, -1.0)
    if camera.projection == "orthographic":
        local = np.stack([u * camera.ortho_scale, v * camera.ortho_scale, np.zeros_like(u)], axis=1)
        origins = eye + product(local, rotation.T)
        directions = np.broadcast_to(-rotation[:, 2], origins.shape).copy()
        cosine = np.ones_like(u)
    elif camera.projection == "equirectangular":
        longitude = _lerp(camera.longitude, x / width)
        latitude = _lerp(camera.latitude, 1.0 - y / height)
        local = np.stack(
            [np.cos(latitude) * np.sin(longitude), np.sin(latitude), -np.cos(latitude) * np.cos(longitude)], axis=1
        )
        beside = np.zeros_like(local)
        if camera.lens is not None and camera.lens.point is not None:
            local, beside = _through_lens(camera.lens, local)
        if camera.eye is not None:
            local, aside = _spherical(camera.eye, local, latitude)
            beside = beside + aside
        directions = product(local, rotation.T)
        origins = eye + product(beside, rotation.T)
        cosine = np.ones_like(u)
    else:
        extent = 2.0 * np.tan(0.5 * camera.fov)
        local = np.stack([u * extent, v * extent, forward], axis=1)
        length = np.linalg.norm(local, axis=1)
        directions = product(local / length[:, None], rotation.T)
        origins = np.broadcast_to(eye, directions.shape).copy()
        cosine = 1.0 / length
    return origins, directions, cosine


def viewing_cosine(camera: Camera, directions: np.ndarray) -> np.ndarray:
    """Cosines (N,) between unit directions (N, 3) and the viewing axis; 1 for equirectangular cameras."""
    if camera.projection == "equirectangular":
        return np.ones(len(directions))
    return directions @ (-camera.world_matrix[:3, 2] / np.linalg.norm(camera.world_matrix[:3, 2]))


def _through_lens(lens: Lens, local: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """As `_spherical`, of rays through the lens' point. The lens faces each ray, its first axis towards -Z."""
    assert lens.point is not None
    across = local[:, 2:] * local + [0.0, 0.0, -1.0]
    across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
    beside = lens.point[0] * across + lens.point[1] * np.cross(local, across)
    directions = lens.focus * local - beside
    return directions / np.linalg.norm(directions, axis=1, keepdims=True), beside


def _spherical(eye: SphericalEye, local: np.ndarray, latitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions of rays and where they start, (N, 3) each, of an eye that looks along `local` at `latitude`."""
    offset = np.full_like(latitude, eye.offset)
    if eye.merge is not None:
        low, high = eye.merge
        fraction = np.clip((np.abs(latitude) - low) / max(high - low, 1e-12), 0.0, 1.0)
        offset *= np.cos(0.5 * np.pi * fraction)
    right = np.stack([-local[:, 2], np.zeros_like(latitude), local[:, 0]], axis=1)
    right /= np.maximum(np.linalg.norm(right, axis=1, keepdims=True), 1e-12)
    beside = offset[:, None] * right
    if np.isfinite(eye.convergence):
        local = eye.convergence * local - beside
        local = local / np.linalg.norm(local, axis=1, keepdims=True)
    return local, beside


def pixel_size(camera: Camera, distance: np.ndarray) -> np.ndarray:
    """Approximate length (N,) of a pixel's shorter side at distances (N,) along its ray, in world units."""
    width = camera.resolution[0] / min(camera.pixel_aspect, 1.0)
    if camera.projection == "orthographic":
        return np.full_like(distance, camera.ortho_scale / width)
    if camera.projection == "equirectangular":
        return distance * abs(camera.longitude[1] - camera.longitude[0]) / camera.resolution[0]
    return distance * (2.0 * np.tan(0.5 * camera.fov) / width)


def widest_angle(camera: Camera) -> float:
    """Approximate angle between the rays at the ends of the image's longer edge; radians."""
    if camera.projection == "orthographic":
        return 0.0
    if camera.projection == "equirectangular":
        return max(abs(ends[1] - ends[0]) for ends in (camera.longitude, camera.latitude))
    width, height = camera.resolution
    return float(2.0 * np.arctan(np.tan(0.5 * camera.fov) * max(width, height * camera.pixel_aspect) / width))


def _lerp(ends: tuple[float, float], fraction: np.ndarray) -> np.ndarray:
    return ends[0] + (ends[1] - ends[0]) * fraction


def image_points(camera: Camera, points: np.ndarray) -> np.ndarray | None:
    """Where world points (..., 3) are seen, (2, ...) in pixels from the image's upper left corner.

    None if any point lies beside or behind the camera, and for equirectangular cameras.
    """
    if camera.projection == "equirectangular":
        return None
    if camera.projection == "perspective":
        x, y, z = np.moveaxis(_local(camera, points), -1, 0)
        if not z.max() < -1e-6 * max(np.abs(x).max(), np.abs(y).max(), np.abs(z).max()):
            return None
    return seen_at(camera, points)


def _local(camera: Camera, points: np.ndarray) -> np.ndarray:
    """World points (..., 3) along the camera's axes, from its eye."""
    rotation = camera.world_matrix[:3, :3] / np.linalg.norm(camera.world_matrix[:3, :3], axis=0)
    return product(points - camera.world_matrix[:3, 3], inverse(rotation).T)


def seen_at(camera: Camera, points: np.ndarray) -> np.ndarray:
    """Where world points (..., 3) are seen, (2, ...) in pixels from the image's upper left corner; NaN behind it."""
    x, y, z = np.moveaxis(_local(camera, points), -1, 0)
    (width, height), (left, right), (lower, upper) = camera.resolution, camera.longitude, camera.latitude
    if camera.projection == "equirectangular":
        if camera.lens is not None and camera.lens.point is not None:
            # Rays through the lens' point leave the middle's by so much there.
            distance = np.maximum(np.sqrt(x * x + y * y + z * z), 1e-12)
            towards = np.stack([x, y, z], axis=-1) / distance[..., None]
            _, beside = _through_lens(camera.lens, towards.reshape(-1, 3))
            aside = beside.reshape(towards.shape) * (distance / camera.lens.focus - 1.0)[..., None]
            x, y, z = np.moveaxis(towards * distance[..., None] + aside, -1, 0)
        latitude = np.arctan2(y, np.hypot(x, z))
        return np.stack(
            [(np.arctan2(x, -z) - left) / (right - left) * width, (upper - latitude) / (upper - lower) * height]
        )
    extent: np.ndarray | float = camera.ortho_scale
    if camera.projection == "perspective":
        extent = np.where(z < 0.0, -2.0 * np.tan(0.5 * camera.fov) * z, np.nan)
    return np.stack(camera.in_image(x / extent, y / extent))


def places_in_image(
    camera: Camera, pixel: np.ndarray, directions: np.ndarray, by_direction: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Where rays are in the image, (N,) pixels each from the left and from above.

    pixel: int (N,), of the camera's window, row by row. directions: (N, 3) of the rays. by_direction: whether they are
    not the rays of those pixels; then where the camera has rays along the directions, or nearest to that.
    """
    if by_direction and camera.projection != "orthographic":
        width, height = camera.resolution
        x, y = np.nan_to_num(seen_at(camera, camera.world_matrix[:3, 3] + directions))
        return np.clip(x, 0.0, width), np.clip(y, 0.0, height)
    x0, y0, x1, _ = camera.window
    row, column = np.divmod(pixel, x1 - x0)
    return column + x0 + 0.5, row + y0 + 0.5


def windows_around(camera: Camera, corners: np.ndarray) -> np.ndarray:
    """Parts of the camera's window whose pixels can show the convex hulls of V times N world points (V, N, 3).

    int (V, 4), x0, y0, x1, y1 each; empty behind the camera.
    """
    x0, y0, x1, y1 = camera.window
    windows = np.tile([x0, y0, x1, y1], (len(corners), 1))
    if camera.projection == "equirectangular":
        # Rays that do not start at the camera see points elsewhere.
        return windows if camera.eye or camera.lens else _windows_on_sphere(camera, corners)
    ahead = -_local(camera, corners)[..., 2]
    nearest, farthest = ahead.min(axis=1), ahead.max(axis=1)
    windows[farthest < 0.0] = 0
    size = np.abs(corners - camera.world_matrix[:3, 3]).max(axis=(1, 2))
    seen = np.flatnonzero((nearest > 1e-6 * size.max(initial=0.0)) | (camera.projection == "orthographic"))
    pixels = image_points(camera, corners[seen]) if len(seen) else None
    if pixels is None:
        return windows
    # One pixel more on each side, for rounding.
    low, high = np.floor(pixels.min(axis=2)) - 1.0, np.ceil(pixels.max(axis=2)) + 1.0
    finite = (np.isfinite(low) & np.isfinite(high)).all(axis=0)
    first, end = np.array([[x0], [y0]]), np.array([[x1], [y1]])
    found = np.concatenate([np.clip(low, first, end), np.clip(high, first, end)])[:, finite].T
    windows[seen[finite]] = found.astype(int)
    return windows


def _windows_on_sphere(camera: Camera, corners: np.ndarray) -> np.ndarray:
    """As `windows_around`, of an equirectangular camera: around what it sees of spheres around the points."""
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    x, y, z = _local(camera, centre).T
    level = np.hypot(x, z)
    sine = np.minimum(radius / np.maximum(np.hypot(level, y), 1e-300), 1.0)
    half, latitude = np.arcsin(sine), np.arctan2(y, level)
    # A sphere that holds a pole is seen all around.
    beside = np.arcsin(np.minimum(sine / np.maximum(np.cos(latitude), 1e-300), 1.0))
    beside[(np.abs(latitude) + half >= 0.5 * np.pi) | (sine >= 1.0)] = np.pi
    half[sine >= 1.0] = np.pi
    (width, height), (left, right), (lower, upper) = camera.resolution, camera.longitude, camera.latitude
    begin = np.mod(np.arctan2(x, -z) - beside - min(left, right), 2.0 * np.pi)
    ends = np.stack([begin, begin + 2.0 * beside])
    # What is seen at both edges, or more than once.
    ends[:, (ends[1] >= 2.0 * np.pi) | (abs(right - left) > 2.0 * np.pi)] = [[0.0], [abs(right - left)]]
    columns = ends / (right - left) * width + (width if right < left else 0.0)
    rows = (upper - np.stack([latitude - half, latitude + half])) / (upper - lower) * height
    # One pixel more on each side, for rounding.
    places = np.stack([columns, rows])
    low, high = np.floor(places.min(axis=1)) - 1.0, np.ceil(places.max(axis=1)) + 1.0
    first, end = np.array(camera.window).reshape(2, 2, 1)
    return np.concatenate([np.clip(low, first, end), np.clip(high, first, end)]).T.astype(int)


def pixels_around(camera: Camera, cells: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """bool (rows, columns): pixels of the camera's window that can show any of the cells.

    cells: bool (x, y, z). corners: (x + 1, y + 1, z + 1, 3), of the whole lattice in the world. All pixels where
    `image_points` is None.
    """
    x0, y0, x1, y1 = camera.window
    pixels = image_points(camera, corners)
    if pixels is None or not np.isfinite(pixels).all():
        return np.ones((y1 - y0, x1 - x0), bool)
    low, high = pixels, pixels
    for axis in range(1, 4):
        lower, upper = ((slice(None),) * axis + (half,) for half in (slice(None, -1), slice(1, None)))
        low, high = np.minimum(low[lower], low[upper]), np.maximum(high[lower], high[upper])
    # One pixel more on each side, for rounding. Where rectangles begin and end tells how many cover each pixel.
    origin, size = np.array([[x0], [y0]]), np.array([[x1 - x0], [y1 - y0]])
    visible = np.zeros((y1 - y0, x1 - x0), bool)
    first = np.clip(np.floor(low[:, cells]) - 1.0 - origin, 0, size).astype(int)
    end = np.clip(np.ceil(high[:, cells]) + 1.0 - origin, 0, size).astype(int)
    if not first.size:
        return visible
    (left0, top0), (right0, bottom0) = first.min(axis=1), end.max(axis=1)
    (left, top), (right, bottom) = first - [[left0], [top0]], end - [[left0], [top0]]
    width, height = right0 - left0 + 1, bottom0 - top0 + 1
    change, ends = (
        np.bincount(np.concatenate([top * width + corner, bottom * width + opposite]), minlength=width * height)
        for corner, opposite in ((left, right), (right, left))
    )
    change -= ends
    covered = np.cumsum(np.cumsum(change.reshape(height, width), axis=0, dtype=np.int32), axis=1, dtype=np.int32)
    visible[top0:bottom0, left0:right0] = covered[:-1, :-1] > 0
    return visible
