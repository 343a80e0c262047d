# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered viewports: progressive pictures while nothing changes."""

from typing import Any

import bpy
import gpu
import numpy as np
from gpu_extras.presets import draw_texture_2d
from mathutils import Matrix

from ...inference import RenderCache
from ...inference.numerics.small_matmul import affine_inverse
from ...inference.scene import Camera, Lens, SceneError, Settings
from ..objects.camera import read_lens
from ..objects.visibility import visibility_state
from ..runtime.background import Worker
from ..scene.reader import SceneDescription, read_view
from ..scene.unrendered import composited, unrendered
from ..settings.properties import scene_settings
from ..volumes.loading import VolumeLoading
from ..volumes.reader import VolumeReader
from ..world import picture as world_picture
from .backdrop import Backdrop, texture, view_key
from .preview import Prepared, Preview
from .viewport_region import WHOLE, Part, part_pixels

POLL_INTERVAL = 0.05
# Seconds to wait for volumes before drawing without them.
LOADING_GRACE = 0.05


def viewport_camera(
    view_matrix: Matrix | np.ndarray,
    window_matrix: Matrix | np.ndarray,
    perspective: bool,
    size: tuple[int, int],
    clip_end: float,
    part: Part = WHOLE,
) -> Camera:
    """The camera of a 3D viewport, or of a part of it.

    view_matrix, window_matrix: (4, 4), see RegionView3D. size: (width, height) in pixels. clip_end: far distance of its
    space.

    Raises SceneError where the view is degenerate.
    """
    view, window = np.array(view_matrix), np.array(window_matrix)
    # A view through a camera of scale 0 has no inverse; Camera rejects it.
    world = affine_inverse(view) if np.isfinite(view).all() and np.linalg.det(view) else np.full((4, 4), np.nan)
    width, height = size
    left, bottom, right, top = part
    share = right - left
    half_width = 1.0 / window[0, 0]
    centre = window[:2, 2] if perspective else -window[:2, 3]
    near = 1e-3
    if not perspective:
        # An orthographic view includes what is behind its origin.
        world[:3, 3] += world[:3, 2] * clip_end
        near, clip_end = 0.0, 2.0 * clip_end
    # Shift of the part, relative to the region's width.
    shift_x = (centre[0] + left + right - 1.0) / 2.0
    shift_y = (centre[1] + bottom + top - 1.0) / 2.0 * height / width
    return Camera(
        world,
        projection="perspective" if perspective else "orthographic",
        resolution=part_pixels(part, size),
        fov=2.0 * np.arctan(share * half_width),
        ortho_scale=2.0 * share * half_width,
        shift=(shift_x / share, shift_y / share),
        clip=(near, clip_end),
    )


def viewport_lens(context: "bpy.types.Context", depsgraph: "bpy.types.Depsgraph") -> Lens | None:
    """The lens through which a 3D viewport is seen; None unless *Blur in Viewport* is on and it shows what a camera
    sees.
    """
    space: Any = context.space_data
    camera = space.camera if space.use_local_camera else depsgraph.scene.camera
    if context.region_data.view_perspective != "CAMERA" or camera is None or camera.type != "CAMERA":
        return None
    return (
        read_lens(camera.evaluated_get(depsgraph), depsgraph) if scene_settings(depsgraph.scene).viewport_blur else None
    )


class Viewport:
    """The contents of one viewport, owned by its engine.

    reader: of volumes; valid until a volume's data or material changes. backdrop: the World behind the volumes.
    playing: whether an animation plays. postponed: whether the scene has changed since it was described.
    """

    def __init__(self) -> None:
        self.backdrop = Backdrop(_watch)
        self.reader, self._prepared = VolumeReader(), Prepared(RenderCache())
        self.description: SceneDescription | None = None
        self.playing = self.postponed = False
        self.message, self._unrendered = "", ""
        self._preview: Preview | None = None
        self._view: tuple | None = None
        self._texture: gpu.types.GPUTexture | None = None
        self._drawn: tuple[Preview | None, int] = (None, 0)
        self._loading: VolumeLoading | None = None
        self._before: SceneDescription | None = None
        self._shown: tuple | None = None
        # Parts of the region: of the view and of the texture.
        self._part, self._place = WHOLE, WHOLE

    @property
    def holds(self) -> bool:
        """Whether an animation plays on while a frame has no picture yet.

        The frame gets its first one before another is begun, or none would be seen where frames follow sooner.
        """
        preview = self._preview
        return self.playing and preview is not None and not (preview.number or preview.done)

    def shows(self, depsgraph: "bpy.types.Depsgraph", space: "bpy.types.SpaceView3D") -> bool:
        """Whether it has a description of the scene with the current visibility."""
        return self.description is not None and self._shown == _state(depsgraph, space)

    def read(self, depsgraph: "bpy.types.Depsgraph", space: "bpy.types.SpaceView3D") -> None:
        """Describe the scene after a change of it or of its visibility in a SpaceView3D.

        A thread reads volumes first where that takes long.
        """
        self._shown, self.postponed = _state(depsgraph, space), False
        sources, loading = self.reader.wanted(depsgraph, space), self._loading
        if (
            loading is not None
            and not loading.done
            and loading.reader is self.reader
            and ({source.key for source in sources} == {source.key for source in loading.sources})
        ):
            return
        self._stop_loading()
        if sources:
            self._stop_preview()
            self._loading = VolumeLoading(self.reader, sources)
            self._loading.wait(LOADING_GRACE)
            if not self._loading.done:
                # Keep the previous picture, and its data in use, meanwhile.
                self._before = self.description or self._before
                self.description, self.message, self._view = None, "", None
                return _watch(self._loading)
        self._describe(depsgraph, space)

    def read_on(self, depsgraph: "bpy.types.Depsgraph", space: "bpy.types.SpaceView3D") -> None:
        """Describe the scene once its volumes are read."""
        if self._loading is not None and self._loading.done:
            self._describe(depsgraph, space)

    def _describe(self, depsgraph: "bpy.types.Depsgraph", space: "bpy.types.SpaceView3D") -> None:
        failure = self._loading and self._loading.error
        self._stop_loading()
        self._unrendered = "" if composited(depsgraph.scene) else unrendered(depsgraph).summary
        try:
            if failure is not None:
                return self.describe(None, str(failure))
            self.describe(read_view(depsgraph, space, self.reader))
        except SceneError as error:
            self.describe(None, str(error))

    def _stop_loading(self) -> None:
        if self._loading is not None:
            self._loading.stop()
            self._loading = None

    def describe(self, description: SceneDescription | None, message: str = "") -> None:
        """Set the description of the scene; None where it cannot be rendered, for the reason in `message`."""
        self._stop_preview()
        self.description, self.message, self._view, self._before = description, message, None, None
        if description is None or not description.volumes:
            self._texture = None

    def update(self, camera: Camera | None, settings: Settings, part: Part = WHOLE) -> None:
        """Start over where the view or the settings differ, with the scene as described.

        camera: of the rendered part of the region; None where nothing is rendered.
        """
        self.backdrop.update(camera, part)
        view = (view_key(camera), settings, part) if camera else None
        if self.description is None or self.holds or view is not None and view == self._view:
            return
        self._stop_preview()
        self._part = part
        if camera is None:
            self._view = self._texture = None
            return
        self._view, self._preview = view, Preview(self.description, camera, settings, self._prepared)
        _watch(self._preview)

    def draw(self, size: tuple[int, int]) -> None:
        """Draw the World and the latest picture over their parts of the region; the previous ones until the first are
        done.
        """
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
        """The status line: current step, and objects that cannot be rendered."""
        if self._loading is not None:
            return self._loading.message.capitalize()
        if self.message or self.description is None:
            return self.message
        refining = "Refining" if self._preview is not None and not self._preview.done else ""
        doing = self._preview and self._preview.message or self.backdrop.status or refining
        return " | ".join(filter(None, [doing, _left_out(self.description), self._unrendered]))

    def close(self) -> None:
        """Stop all threads."""
        self._stop_loading()
        self._stop_preview()
        self.backdrop.stop()

    def _stop_preview(self) -> None:
        if self._preview is not None:
            self._preview.stop()
            self._preview = None


def _state(depsgraph: "bpy.types.Depsgraph", space: "bpy.types.SpaceView3D") -> tuple:
    """A value that changes where the scene must be described again although no object has changed."""
    world = depsgraph.scene.world
    return visibility_state(depsgraph, space), world and world.name_full


def _left_out(description: SceneDescription) -> str:
    """The first object that cannot be rendered, and how many more there are."""
    more = f", and {len(description.refused) - 1} more" if len(description.refused) > 1 else ""
    return description.refused[0] + more if description.refused else ""


# Active previews and loadings, and the number of pictures drawn of each.
_watched: dict["Worker | Preview", int] = {}


def _watch(preview: Worker | Preview) -> None:
    """Redraw viewports for each new picture of a Preview, or when a VolumeLoading ends.

    A timer does this, because Blender may free an engine while its thread runs.
    """
    _watched[preview] = 0
    if not bpy.app.timers.is_registered(_redraw):
        bpy.app.timers.register(_redraw, first_interval=POLL_INTERVAL)


def _redraw() -> float | None:
    new = False
    for preview, shown in list(_watched.items()):
        # Read `done` before `number`, or the last picture could be missed.
        done = preview.done or preview.stopped
        if not preview.stopped and (preview.number > shown or done):
            _watched[preview], new = preview.number, True
        if done:
            del _watched[preview]
    if new:
        for window in bpy.context.window_manager.windows:
            for area in window.screen.areas:
                if area.type == "VIEW_3D":
                    area.tag_redraw()
    return POLL_INTERVAL if _watched else None


def unregister() -> None:
    """Stop all threads."""
    for preview in _watched:
        preview.stop()
    _watched.clear()
    world_picture.forget()
    if bpy.app.timers.is_registered(_redraw):
        bpy.app.timers.unregister(_redraw)
