"""The World behind a viewport's volumes: at once where it is known from all around, then as sharp as the view."""

import traceback
from dataclasses import replace
from typing import Optional

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

# The World from its middle, +X in the middle of the picture and +Z above, as `sampler` takes it.
PANORAMA = Camera(np.array([[0.0, 0.0, -1.0, 0.0], [-1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]),
                  projection="equirectangular", resolution=(2048, 1024))
PANORAMA_SAMPLES, SAMPLES = 1, 4
# Pixels of a picture that is looked up in the panorama, within a redraw.
ROUGH = 60_000
# Seconds for which a view must have rested before Cycles shows it.
REST = 0.3
BRIGHTEST = float(np.finfo(np.float16).max)


class Backdrop:
    """What one viewport shows behind its volumes.

    watch: called with each worker whose pictures are to be drawn, as `viewport._watch`.
    """

    def __init__(self, watch):
        self._watch, self._behind, self._filter = watch, None, None
        self._shown, self._view, self._drawn, self._texture = None, None, None, None
        self._part = WHOLE

    def read(self, depsgraph) -> None:
        """The scene has changed: see what is behind its volumes now; nothing is, on a transparent film."""
        transparent = depsgraph.scene.render.film_transparent
        self._behind = None if transparent else world_behind(depsgraph)
        self._filter = pixel_filter(depsgraph.scene)

    def look(self, camera: Optional[Camera], part: Part = WHOLE) -> None:
        """Start over where the view or the World differ; camera: of a part of the region, None where there is no view."""
        self._part, behind = part, self._behind if camera is not None else None
        key = behind.key if isinstance(behind, WorldSource) else behind is not None and behind.tobytes()
        view = key, camera and view_key(camera), part, self._filter
        if view == self._view:
            return
        self.stop()
        self._view = view
        if isinstance(behind, WorldSource):
            self._shown = _Showing(behind, camera, self._filter, first=self._texture is None)
            self._watch(self._shown)
        elif behind is not None:
            self._shown = _Plain(behind)
        else:
            self._shown = self._texture = None

    def draw(self, size) -> None:
        """Draw the latest picture over its part of the region; the one before until there is one."""
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
        """Stop what is at work."""
        if isinstance(self._shown, Worker):
            self._shown.stop()


class _Plain:
    """A World of one colour (3,), as a `_Showing` that is done."""

    number, message, done = 1, "", True

    def __init__(self, colour):
        self.picture = _opaque(colour[None, None])


class _Showing(Worker):
    """Has Cycles show one view of a World, from all around first where it has not yet.

    picture: the latest, float32 (h, w, 4), rows from the bottom, or None; number: of pictures so far.
    """

    picture, number = None, 0

    def __init__(self, source: WorldSource, camera: Camera, filter_of_pixels, first: bool):
        """first: whether nothing has been drawn before that could stay meanwhile."""
        self._source, self._camera, self._filter = source, camera, filter_of_pixels
        if source.panorama is not None:
            self._show(self._rough())
        elif first:
            self._show(np.zeros((1, 1, 3)))
        self._start("mrpnn backdrop", awaited=False)

    def _work(self):
        source = self._source
        try:
            if self._stop.wait(REST):
                return
            if source.panorama is None and not source.depends_on_view:
                around = source.view(PANORAMA, PANORAMA_SAMPLES, ('BOX', 1.0), self._check)
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

    def _check(self):
        if self.stopped:
            raise Cancelled()

    def _rough(self):
        """The view, looked up in the panorama at few pixels."""
        width, height = self._camera.resolution
        divisor = int(np.ceil(max(width * height / ROUGH, 1.0) ** 0.5))
        size = max(width // divisor, 1), max(height // divisor, 1)
        _, directions, _, _ = camera_rays(replace(self._camera, resolution=size))
        return sampler(self._source.panorama[::-1])(directions).reshape(size[1], size[0], 3)

    def _show(self, rgb):
        self.picture, self.number = _opaque(rgb), self.number + 1


def view_key(camera: Camera) -> tuple:
    """Equal for cameras of viewports that see the same."""
    return (camera.world_matrix.tobytes(), camera.projection, camera.resolution, camera.fov, camera.ortho_scale,
            camera.shift)


def texture(picture: np.ndarray) -> gpu.types.GPUTexture:
    """Of a picture, float32 (h, w, 4), rows from the bottom."""
    height, width = picture.shape[:2]
    pixels = gpu.types.Buffer('FLOAT', width * height * 4, picture.ravel())
    return gpu.types.GPUTexture((width, height), format='RGBA16F', data=pixels)


def _opaque(rgb):
    """float32 (h, w, 4), rows from the bottom, clamped as Cycles does what it shows; rgb: rows from the top."""
    picture = np.ones((*rgb.shape[:2], 4), np.float32)
    picture[..., :3] = np.clip(rgb[::-1], 0.0, BRIGHTEST)
    return picture
