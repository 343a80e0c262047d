"""Rendered shading: pictures of the viewport that get finer while nothing changes."""

from typing import Optional

import bpy
import numpy as np
from gpu_extras.presets import draw_texture_2d

from ...inference import RenderCache
from ...inference.scene import Camera, SceneError, Settings
from ..objects.visibility import visibility_state
from ..scene.reader import read_view
from ..scene.unrendered import unrendered
from ..volumes.loading import VolumeLoading
from ..volumes.reader import VolumeReader
from ..world import picture as world_picture
from .backdrop import Backdrop, texture, view_key
from .preview import Prepared, Preview
from .viewport_region import WHOLE, Part, part_pixels

SECONDS_A_LOOK = 0.05
# Of waiting for volumes before a picture without them is drawn.
MOMENT = 0.05


def viewport_camera(view_matrix, window_matrix, perspective: bool, size, clip_end: float, part: Part = WHOLE) -> Camera:
    """The camera of a 3D viewport, or of a part of it.

    view_matrix, window_matrix: (4, 4), as of RegionView3D; size: (width, height) in pixels;
    clip_end: the far distance of its space.

    Raises SceneError where the view is none.
    """
    view, window = np.array(view_matrix), np.array(window_matrix)
    # What follows a camera of scale 0 has no inverse; Camera refuses it.
    world = np.linalg.inv(view) if np.isfinite(view).all() and np.linalg.det(view) else np.full((4, 4), np.nan)
    width, height = size
    left, bottom, right, top = part
    share = right - left
    half_width = 1.0 / window[0, 0]
    centre = window[:2, 2] if perspective else -window[:2, 3]
    near = 1e-3
    if not perspective:
        # An orthographic view shows what is behind its own place, too.
        world[:3, 3] += world[:3, 2] * clip_end
        near, clip_end = 0.0, 2.0 * clip_end
    # Of the part, in units of the region's width.
    shift_x = (centre[0] + left + right - 1.0) / 2.0
    shift_y = (centre[1] + bottom + top - 1.0) / 2.0 * height / width
    return Camera(
        world, projection="perspective" if perspective else "orthographic", resolution=part_pixels(part, size),
        fov=2.0 * np.arctan(share * half_width), ortho_scale=2.0 * share * half_width,
        shift=(shift_x / share, shift_y / share), clip=(near, clip_end))


class Viewport:
    """What one viewport shows; owned by the engine that draws it.

    reader: of volumes; what it has read is good until a volume's data or material changes.
    backdrop: the World behind them.
    """

    def __init__(self):
        self.backdrop = Backdrop(_watch)
        self.reader, self._prepared = VolumeReader(), Prepared(RenderCache())
        self.description, self.message, self._unrendered = None, "", ""
        self._preview, self._view, self._texture, self._drawn = None, None, None, (None, 0)
        self._loading, self._before, self._shown = None, None, None
        # Of the view, and of the texture.
        self._part, self._place = WHOLE, WHOLE

    def shows(self, depsgraph, space) -> bool:
        """Whether it has described the scene, and the space hides, and makes of objects, what it did then."""
        return self.description is not None and self._shown == _state(depsgraph, space)

    def read(self, depsgraph, space) -> None:
        """The scene, or what a SpaceView3D shows of it, has changed: describe it.

        First a thread reads its volumes, where that takes a while.
        """
        self._shown = _state(depsgraph, space)
        sources, loading = self.reader.wanted(depsgraph, space), self._loading
        if loading is not None and not loading.done and loading.reader is self.reader and (
                {source.key for source in sources} == {source.key for source in loading.sources}):
            return
        self._stop_loading()
        if sources:
            self._stop_preview()
            self._loading = VolumeLoading(self.reader, sources)
            self._loading.wait(MOMENT)
            if not self._loading.done:
                # The last picture stays meanwhile, and what it was made of in use.
                self._before = self.description or self._before
                self.description, self.message, self._view = None, "", None
                return _watch(self._loading)
        self._describe(depsgraph, space)

    def read_on(self, depsgraph, space) -> None:
        """Describe the scene where its volumes have been read meanwhile."""
        if self._loading is not None and self._loading.done:
            self._describe(depsgraph, space)

    def _describe(self, depsgraph, space) -> None:
        error = self._loading and self._loading.error
        self._stop_loading()
        self._unrendered = unrendered(depsgraph).summary
        try:
            if error is not None:
                return self.describe(None, str(error))
            self.describe(read_view(depsgraph, space, self.reader))
        except SceneError as error:
            self.describe(None, str(error))

    def _stop_loading(self) -> None:
        if self._loading is not None:
            self._loading.stop()
            self._loading = None

    def describe(self, description, message: str = "") -> None:
        """The scene has changed; `description` is None where it cannot be rendered, for the reason in `message`."""
        self._stop_preview()
        self.description, self.message, self._view, self._before = description, message, None, None
        if description is None or not description.volumes:
            self._texture = None

    def look(self, camera: Optional[Camera], settings: Settings, part: Part = WHOLE) -> None:
        """Start over where the view or the settings differ; the scene that was read is kept.

        camera: of the part of the region that is rendered; None where nothing is.
        """
        self.backdrop.look(camera, part)
        view = camera and (view_key(camera), settings, part)
        if self.description is None or view is not None and view == self._view:
            return
        self._stop_preview()
        self._part = part
        if camera is None:
            self._view = self._texture = None
            return
        self._view, self._preview = view, Preview(self.description, camera, settings, self._prepared)
        _watch(self._preview)

    def draw(self, size) -> None:
        """Draw the latest picture over its part of the region, and the World behind it; the one before until there is one."""
        self.backdrop.draw(size)
        preview = self._preview
        if preview is not None and preview.picture is not None and self._drawn != (preview, preview.number):
            self._drawn, self._place = (preview, preview.number), self._part
            self._texture = texture(preview.picture)
        if self._texture is not None:
            corner = self._place[0] * size[0], self._place[1] * size[1]
            draw_texture_2d(self._texture, corner, *part_pixels(self._place, size))

    @property
    def status(self) -> str:
        """A line over the viewport: what it is doing, and what of the scene it cannot render."""
        if self._loading is not None:
            return self._loading.message.capitalize()
        if self.message or self.description is None:
            return self.message
        refining = "Refining" if self._preview is not None and not self._preview.done else ""
        doing = self._preview and self._preview.message or self.backdrop.status or refining
        return " | ".join(filter(None, [doing, _left_out(self.description), self._unrendered]))

    def close(self) -> None:
        """Stop what is at work."""
        self._stop_loading()
        self._stop_preview()
        self.backdrop.stop()

    def _stop_preview(self) -> None:
        if self._preview is not None:
            self._preview.stop()
            self._preview = None


def _state(depsgraph, space):
    """What differs where another description is due although no object has changed."""
    return visibility_state(depsgraph, space), depsgraph.scene.mrpnn.world_directions


def _left_out(description) -> str:
    """The first of what cannot be rendered, and how many more there are."""
    more = f", and {len(description.refused) - 1} more" if len(description.refused) > 1 else ""
    return description.refused[0] + more if description.refused else ""


# Previews and readings at work, and how many pictures of each the windows have been told of.
_watched = {}


def _watch(preview) -> None:
    """Redraw viewports for each new picture until the Preview ends, or once a VolumeLoading has.

    By a timer: its thread must not do it, since Blender frees engines while threads run.
    """
    _watched[preview] = 0
    if not bpy.app.timers.is_registered(_redraw):
        bpy.app.timers.register(_redraw, first_interval=SECONDS_A_LOOK)


def _redraw():
    new = False
    for preview, shown in list(_watched.items()):
        # `done` is read before `number`: else the last picture could come between.
        done = preview.done or preview.stopped
        if not preview.stopped and (preview.number > shown or done):
            _watched[preview], new = preview.number, True
        if done:
            del _watched[preview]
    if new:
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == 'VIEW_3D':
                    area.tag_redraw()
    return SECONDS_A_LOOK if _watched else None


def unregister():
    """Stop what is at work."""
    for preview in _watched:
        preview.stop()
    _watched.clear()
    world_picture.forget()
    if bpy.app.timers.is_registered(_redraw):
        bpy.app.timers.unregister(_redraw)
