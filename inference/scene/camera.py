# SPDX-License-Identifier: GPL-3.0-or-later
"""The camera."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from .description import affine_matrix
from .errors import SceneError


@dataclass(frozen=True)
class SphericalEye:
    """An eye that looks around: its rays start beside the camera, to the right of their direction.

    offset: distance of the rays' start from the camera, world units; negative for the left eye. convergence: distance
    from the camera at which both eyes' rays of a pixel meet. merge: angles above and below the horizon between which
    the offset fades to 0, radians.
    """

    offset: float
    convergence: float = np.inf
    merge: tuple[float, float] | None = None


@dataclass(frozen=True)
class Lens:
    """A thin lens.

    radius: of its aperture, world units. focus: distance from the camera to what is sharp, along the viewing axis;
    along each ray for equirectangular cameras. blades: corners of the aperture; below 3 it is round. rotation: of its
    corners, radians. ratio: the aperture's height over its width. point: (x, y) through which all rays pass, world
    units to the right and up; None for the whole aperture.

    Raises SceneError for values out of range.
    """

    radius: float
    focus: float
    blades: int = 0
    rotation: float = 0.0
    ratio: float = 1.0
    point: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if not 0.0 <= self.radius < np.inf:
            raise SceneError(f"camera: the aperture's radius {self.radius:g} must not be negative")
        if not 0.0 < self.focus < np.inf:
            raise SceneError(f"camera: the focus distance {self.focus:g} must be positive")
        if not 0.0 < self.ratio < np.inf:
            raise SceneError(f"camera: the aperture's ratio {self.ratio:g} must be positive")


@dataclass(frozen=True)
class Shutter:
    """The time during which a picture is taken, and how the camera moves in it.

    world_matrices: float64 (S, 4, 4) camera to world, at S > 1 evenly spaced times from opening to closing; () for a
    camera that stands still. fovs: (S,) horizontal fields of view then, radians; () for that of the camera. curve:
    fractions of light that the shutter lets through at evenly spaced times; () for all of it.

    Raises SceneError for values out of range.
    """

    world_matrices: np.ndarray | tuple[()] = ()
    fovs: tuple[float, ...] = ()
    curve: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        matrices = [affine_matrix(matrix, "camera: transform") for matrix in self.world_matrices]
        object.__setattr__(self, "world_matrices", np.array(matrices).reshape(-1, 4, 4))
        if len(matrices) == 1 or len(self.fovs) == 1:
            raise SceneError("camera: a shutter needs transforms and fields of view at two times or more")
        if not all(0.0 < fov < np.pi for fov in self.fovs):
            raise SceneError("camera: fields of view in the shutter must lie between 0 and pi")
        if self.curve and not (min(self.curve) >= 0.0 and 0.0 < max(self.curve) < np.inf):
            raise SceneError("camera: the shutter curve lets no light through; raise it above 0")


@dataclass
class Camera:
    """A camera with the axes of Blender: it looks along -Z, +Y is up.

    world_matrix: (4, 4) camera to world; its scale is ignored.
    resolution: (width, height) in pixels.
    fov: horizontal field of view in radians (perspective).
    ortho_scale: world units across the width of the image (orthographic).
    shift: (x, y) lens shift in units of the image's width; positive values move the window right and up.
    pixel_aspect: height of a pixel over its width (perspective, orthographic).
    longitude, latitude: (left, right) and (lower, upper) edges in radians, 0 straight ahead, positive to the right and
        up (equirectangular).
    clip: (near, far) distances along the viewing axis; along each ray for equirectangular cameras.
    exposure: factor of radiance in the layer, which Cycles calls *Film > Exposure*.
    eye: of spherical stereo (equirectangular).
    lens: that blurs what is out of focus; None for a pinhole.
    shutter: in which the camera or volumes move; None for an instant.
    region: (x0, y0, x1, y1) pixels, upper left inclusive, lower right exclusive, rows from the top; None renders the
        whole image. The layer has the size of the region.

    Raises SceneError for values out of range.
    """

    world_matrix: np.ndarray
    projection: Literal["perspective", "orthographic", "equirectangular"] = "perspective"
    resolution: tuple[int, int] = (1920, 1080)
    fov: float = 0.6911112070083618
    ortho_scale: float = 6.0
    shift: tuple[float, float] = (0.0, 0.0)
    pixel_aspect: float = 1.0
    longitude: tuple[float, float] = (-np.pi, np.pi)
    latitude: tuple[float, float] = (-np.pi / 2.0, np.pi / 2.0)
    clip: tuple[float, float] = (0.0, np.inf)
    region: tuple[int, int, int, int] | None = None
    exposure: float = 1.0
    eye: SphericalEye | None = None
    lens: Lens | None = None
    shutter: Shutter | None = None

    def __post_init__(self) -> None:
        self.world_matrix = affine_matrix(self.world_matrix, "camera: transform")
        if self.projection not in ("perspective", "orthographic", "equirectangular"):
            raise SceneError(f"camera: projection {self.projection!r} is not supported")
        width, height = (int(n) for n in self.resolution)
        if width < 1 or height < 1:
            raise SceneError(f"camera: resolution {width}x{height} has no pixels")
        self.resolution = (width, height)
        if self.projection == "perspective" and not 0.0 < self.fov < np.pi:
            raise SceneError(f"camera: field of view {self.fov:g} must lie between 0 and pi")
        if self.projection == "orthographic" and not 0.0 < self.ortho_scale < np.inf:
            raise SceneError(f"camera: orthographic scale {self.ortho_scale:g} must be positive")
        if not 0.0 < self.pixel_aspect < np.inf:
            raise SceneError(f"camera: pixel aspect {self.pixel_aspect:g} must be positive")
        if self.longitude[0] == self.longitude[1] or self.latitude[0] == self.latitude[1]:
            raise SceneError(f"camera: longitudes {self.longitude} and latitudes {self.latitude} span nothing")
        if not np.all(np.isfinite([*self.shift, *self.longitude, *self.latitude])):
            raise SceneError("camera: shift, longitudes and latitudes must be finite")
        if not 0.0 <= self.exposure < np.inf:
            raise SceneError(f"camera: exposure {self.exposure:g} must not be negative")
        near, far = self.clip
        if not 0.0 <= near < far:
            raise SceneError(f"camera: clip range {near:g} to {far:g} is empty")
        if self.region is not None:
            x0, y0, x1, y1 = (int(n) for n in self.region)
            if not (0 <= x0 < x1 <= width and 0 <= y0 < y1 <= height):
                raise SceneError(f"camera: region {self.region} does not lie in the image")
            self.region = (x0, y0, x1, y1)

    def on_plane(self, columns: np.ndarray, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Image plane coordinates, in units of the image's width from the viewing axis, x to the right and y up.

        columns, rows: places in the image, in pixels from its upper left corner.
        """
        width, height = self.resolution
        return (
            (columns - 0.5 * width) / width + self.shift[0],
            (0.5 * height - rows) / width * self.pixel_aspect + self.shift[1],
        )

    def in_image(self, x: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Columns and rows of image plane coordinates: the inverse of `on_plane`."""
        width, height = self.resolution
        return (x - self.shift[0] + 0.5) * width, 0.5 * height - (y - self.shift[1]) * width / self.pixel_aspect

    @property
    def window(self) -> tuple[int, int, int, int]:
        """(x0, y0, x1, y1) of the pixels to render: the region, or the whole image."""
        return self.region or (0, 0, *self.resolution)
