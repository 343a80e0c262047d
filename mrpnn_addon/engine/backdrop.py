# SPDX-License-Identifier: GPL-3.0-or-later
"""The World behind a viewport's volumes: immediately from a cached panorama, then at the view's resolution."""

import traceback
from collections.abc import Callable
from dataclasses import replace

import bpy
import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d

from ...inference.scene import Camera, Cancelled
from ...inference.scene.camera_rays import camera_rays
from ..nodes.environment_image import sampler
from ..runtime.background import Worker
from ..scene.film import pixel_filter, world_behind
from ..world.picture import WorldSource
from ..world.process import PictureFailed
from .viewport_region import WHOLE, Part, part_pixels

# Panorama from the origin, +X at its centre and +Z up, as `sampler` expects it.
PANORAMA = Camera(
    np.array([[0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]),
    projection="equirectangular",
    resolution=(2048, 1024),
)
PANORAMA_SAMPLES, SAMPLES = 1, 4
# Pixels of a picture sampled from the panorama during a redraw.
ROUGH_PIXELS = 60_000
# Seconds without a change of view before Cycles renders it.
REST_SECONDS = 0.3
BRIGHTEST = float(np.finfo(np.float16).max)


class Backdrop:
    """The background of one viewport.

    watch: called with each worker whose pictures are to be drawn; see `viewport._watch`.
    """

    def __init__(self, watch: Callable[[Worker], None]) -> None:
        self._watch, self._part = watch, WHOLE
        self._behind: np.ndarray | WorldSource | None = None
        self._filter: tuple[str, float] | None = None
        self._shown: _Plain | _ViewRendering | None = None
        self._view: tuple | None = None
        self._drawn: tuple | None = None
        self._texture: gpu.types.GPUTexture | None = None

    def read(self, depsgraph: "bpy.types.Depsgraph") -> None:
        """Update the background after a change of the scene; a transparent film has none."""
        transparent = depsgraph.scene.render.film_transparent
        self._behind = None if transparent else world_behind(depsgraph)
        self._filter = pixel_filter(depsgraph.scene)

    def update(self, camera: Camera | None, part: Part = WHOLE) -> None:
        """Start over where the view or the World differs. camera: of a part of the region; None without a view."""
        self._part, behind = part, self._behind if camera is not None else None
        key = behind.key if isinstance(behind, WorldSource) else behind is not None and behind.tobytes()
        view = key, camera and view_key(camera), part, self._filter
        if view == self._view:
            return
        self.stop()
        self._view = view
        if isinstance(behind, WorldSource):
            self._shown = _ViewRendering(behind, camera, self._filter, first=self._texture is None)
            self._watch(self._shown)
        elif behind is not None:
            self._shown = _Plain(behind * np.float32(camera.exposure))
        else:
            self._shown = self._texture = None

    def draw(self, size: tuple[int, int]) -> None:
        """Draw the latest picture over its part of the region; the previous one until the first is done."""
        shown = self._shown
        if shown is not None and shown.picture is not None and self._drawn != (shown, shown.number):
            self._drawn, self._texture = (shown, shown.number), texture(shown.picture)
        if self._texture is not None:
            corner = self._part[0] * size[0], self._part[1] * size[1]
            draw_texture_2d(self._texture, corner, *part_pixels(self._part, size))

    @property
    def status(self) -> str:
        """A line for the viewport's header."""
        if self._shown is None:
            return ""
        return self._shown.message or ("" if self._shown.done else "Rendering the sky")

    def stop(self) -> None:
        """Stop rendering."""
        if isinstance(self._shown, Worker):
            self._shown.stop()


class _Plain:
    """A uniform World (3,), with the interface of a finished `_ViewRendering`."""

    number, message, done = 1, "", True

    def __init__(self, colour: np.ndarray) -> None:
        self.picture = _opaque(colour[None, None])


class _ViewRendering(Worker):
    """Has Cycles render one view of a World, and its panorama first where that is not cached.

    picture: the latest, float32 (h, w, 4), rows from the bottom, or None. number: of pictures so far.
    """

    picture: np.ndarray | None = None
    number = 0

    def __init__(self, source: WorldSource, camera: Camera, filter_type: tuple[str, float], first: bool) -> None:
        """first: whether there is no previous picture to show meanwhile."""
        self._source, self._camera, self._filter = source, camera, filter_type
        if source.panorama is not None:
            self._show(self._rough())
        elif first:
            self._show(np.zeros((1, 1, 3)))
        self._start("mrpnn backdrop", awaited=False)

    def _work(self) -> None:
        source = self._source
        try:
            if self._stop.wait(REST_SECONDS):
                return
            if source.panorama is None and not source.depends_on_view:
                around = source.view(PANORAMA, PANORAMA_SAMPLES, ("BOX", 1.0), self._check)
                source.panorama = np.clip(around, 0.0, BRIGHTEST).astype(np.float16)
                self._show(self._rough())
            self._show(source.view(self._camera, SAMPLES, self._filter, self._check))
        except Cancelled:
            pass
        except PictureFailed as failure:
            self.message = f"World: {failure}"
            self._show(np.zeros((1, 1, 3)))
        except Exception as error:
            traceback.print_exc()
            self.message = f"MRPNN failed, which is a bug: {type(error).__name__}: {error}"

    def _check(self) -> None:
        if self.stopped:
            raise Cancelled()

    def _rough(self) -> np.ndarray:
        """The view, sampled from the panorama at few pixels."""
        width, height = self._camera.resolution
        divisor = int(np.ceil(max(width * height / ROUGH_PIXELS, 1.0) ** 0.5))
        size = max(width // divisor, 1), max(height // divisor, 1)
        _, directions, _, _ = camera_rays(replace(self._camera, resolution=size))
        colours = sampler(self._source.panorama[::-1])(directions) * self._camera.exposure
        return colours.reshape(size[1], size[0], 3)

    def _show(self, rgb: np.ndarray) -> None:
        self.picture, self.number = _opaque(rgb), self.number + 1


def view_key(camera: Camera) -> tuple:
    """Equal for viewport cameras with the same view."""
    return (
        camera.world_matrix.tobytes(),
        camera.projection,
        camera.resolution,
        camera.fov,
        camera.ortho_scale,
        camera.shift,
        camera.pixel_aspect,
        camera.exposure,
        camera.lens,
    )


def texture(picture: np.ndarray) -> gpu.types.GPUTexture:
    """The texture of a picture, float32 (h, w, 4), rows from the bottom."""
    height, width = picture.shape[:2]
    pixels = gpu.types.Buffer("FLOAT", width * height * 4, picture.ravel())
    return gpu.types.GPUTexture((width, height), format="RGBA16F", data=pixels)


def _opaque(rgb: np.ndarray) -> np.ndarray:
    """float32 (h, w, 4), rows from the bottom, clamped as Cycles clamps its display. rgb: rows from the top."""
    picture = np.ones((*rgb.shape[:2], 4), np.float32)
    picture[..., :3] = np.clip(rgb[::-1], 0.0, BRIGHTEST)
    return picture
