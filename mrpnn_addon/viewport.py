"""Rendered shading: pictures of the viewport that get finer while nothing changes."""

import threading
from dataclasses import replace

import bpy
import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d

from .. import inference
from ..inference.scene import Camera, Cancelled, SceneError, Settings
from .layer_frame import rgba

# (pixels of the region along a pixel of the picture, depth samples) of each picture but the last.
ROUGH = ((8, 1), (3, 1))
SECONDS_A_LOOK = 0.05


def viewport_camera(view_matrix, window_matrix, perspective: bool, size, clip_end: float) -> Camera:
    """The camera of a 3D viewport.

    view_matrix, window_matrix: (4, 4), as of RegionView3D; size: (width, height) in pixels;
    clip_end: the far distance of its space.
    """
    world, window = np.linalg.inv(np.array(view_matrix)), np.array(window_matrix)
    width, height = size
    half_width = 1.0 / window[0, 0]
    centre = window[:2, 2] if perspective else -window[:2, 3]
    near = 1e-3
    if not perspective:
        # An orthographic view shows what is behind its own place, too.
        world[:3, 3] += world[:3, 2] * clip_end
        near, clip_end = 0.0, 2.0 * clip_end
    return Camera(
        world, projection="perspective" if perspective else "orthographic", resolution=size,
        fov=2.0 * np.arctan(half_width), ortho_scale=2.0 * half_width,
        shift=(centre[0] / 2.0, centre[1] / 2.0 * height / width), clip=(near, clip_end))


class Preview:
    """Renders one view on a thread of its own, coarse to fine.

    picture: the latest, float32 (H, W, 4) with rows from the bottom, or None; number: of pictures so
    far. message: what went wrong, or "". done: whether the last one is there.
    """

    def __init__(self, description, camera: Camera, settings: Settings):
        self.picture, self.number, self.message, self.done = None, 0, "", False
        self._stop = threading.Event()
        threading.Thread(target=self._run, args=(description, camera, settings), name="mrpnn preview",
                         daemon=True).start()

    def stop(self):
        """Ask it to end; no picture comes afterwards."""
        self._stop.set()

    @property
    def stopped(self) -> bool:
        return self._stop.is_set()

    def _run(self, description, camera, settings):
        try:
            for divisor, samples in (*ROUGH, (1, settings.depth_samples)):
                size = tuple(max(pixels // divisor, 1) for pixels in camera.resolution)
                layer = inference.render(
                    description.volumes, description.suns, replace(camera, resolution=size),
                    replace(settings, depth_samples=samples), cancelled=self._stop.is_set)
                if self.stopped:
                    return
                self.picture, self.number = np.ascontiguousarray(rgba(layer)[::-1]), self.number + 1
            self.done = True
        except Cancelled:
            pass
        except SceneError as error:
            self.message, self.done = str(error), True


class Viewport:
    """What one viewport shows; owned by the engine that draws it."""

    def __init__(self):
        self.description, self.message = None, ""
        self._preview, self._view, self._texture, self._drawn = None, None, None, (None, 0)

    def describe(self, description, message: str = "") -> None:
        """The scene has changed; `description` is None where it cannot be rendered, for the reason in `message`."""
        self.close()
        self.description, self.message, self._view = description, message, None
        if description is None:
            self._texture = None

    def look(self, camera: Camera, settings: Settings) -> None:
        """Start over where the view or the settings differ; the scene that was read is kept."""
        view = (camera.world_matrix.tobytes(), camera.projection, camera.resolution, camera.fov, camera.ortho_scale,
                camera.shift, settings)
        if self.description is None or view == self._view:
            return
        self.close()
        self._view, self._preview = view, Preview(self.description, camera, settings)
        bpy.app.timers.register(_redraw_when_new(self._preview), first_interval=SECONDS_A_LOOK)

    def draw(self, size) -> None:
        """Draw the latest picture over the region; the one before until there is one."""
        preview = self._preview
        if preview is not None and preview.picture is not None and self._drawn != (preview, preview.number):
            self._drawn = preview, preview.number
            height, width = preview.picture.shape[:2]
            pixels = gpu.types.Buffer('FLOAT', width * height * 4, preview.picture.ravel())
            self._texture = gpu.types.GPUTexture((width, height), format='RGBA16F', data=pixels)
        if self._texture is not None:
            draw_texture_2d(self._texture, (0, 0), *size)

    @property
    def status(self) -> str:
        """A line for the viewport's header."""
        if self.message or self._preview is None:
            return self.message
        return self._preview.message or ("" if self._preview.done else "Refining")

    def close(self) -> None:
        if self._preview is not None:
            self._preview.stop()
            self._preview = None


def _redraw_when_new(preview: Preview):
    """A timer that redraws viewports for each new picture, and ends with the preview.

    The thread must not do it: Blender frees engines while threads run.
    """
    shown = 0

    def look():
        nonlocal shown
        if preview.stopped:
            return None
        # Read before `number`: else the last picture could come between.
        done = preview.done
        if preview.number > shown or done:
            shown = preview.number
            for window in bpy.context.window_manager.windows:
                for area in window.screen.areas:
                    if area.type == 'VIEW_3D':
                        area.tag_redraw()
        return None if done else SECONDS_A_LOOK
    return look
