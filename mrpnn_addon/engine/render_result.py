# SPDX-License-Identifier: GPL-3.0-or-later
"""The render result of one view layer: a coarse picture first, then finished parts."""

import time
from collections.abc import Mapping, Sequence
from typing import Any

import bpy
import numpy as np

from ...inference.image.layer import Layer
from ...inference.scene import Camera
from ..output.layer_frame import rgba
from ..output.passes import RenderPass
from ..runtime.text import stamp_field
from ..scene.film import Background, over

# Seconds between two pictures of an unfinished render: each costs as much as the whole image is large.
SHOW_INTERVAL = 0.5


class RenderResult:
    """Writes one view layer's layer to Blender's render result.

    engine: the RenderEngine. film: the camera whose window is rendered, and a `film.Background`, None for a transparent
    film. view: the name of one of several views. passes: besides Combined. A render that fails before the first picture
    shows none.
    """

    def __init__(
        self,
        engine: "bpy.types.RenderEngine",
        view_layer: "bpy.types.ViewLayer",
        film: tuple[Camera, Background | None],
        view: str = "",
        passes: Sequence[RenderPass] = (),
    ) -> None:
        self._engine, self._view_layer, (self._camera, self._background) = engine, view_layer, film
        self._view = view
        x0, y0, x1, y1 = self._camera.window
        self._image = np.zeros((y1 - y0, x1 - x0, 4), np.float32)
        self._result: bpy.types.RenderResult | None = None
        self._extras, self._shown = passes, 0.0

    def show_coarse(self, layer: Layer) -> None:
        """Show a layer of lower resolution in the whole window."""
        height, width = self._image.shape[:2]
        rows = np.arange(height) * layer.alpha.shape[0] // height
        columns = np.arange(width) * layer.alpha.shape[1] // width
        self._put(self._camera.window, rgba(layer)[rows][:, columns])
        self._show()

    def show_part(self, window: tuple[int, int, int, int], layer: Layer) -> None:
        """Show a finished part, soon. window: (x0, y0, x1, y1) in the image."""
        self._put(window, rgba(layer))
        if time.monotonic() - self._shown > SHOW_INTERVAL:
            self._show()
            self._shown = time.monotonic()

    def finish(self, layer: Layer, stamped: Mapping[str, str], mattes: Mapping[str, str] = {}) -> None:
        """Write the whole layer with all passes. stamped, mattes: names and values for the file's metadata."""
        self._put(self._camera.window, rgba(layer))
        result = self._begin()
        for extra in self._extras:
            _fill(result.layers[0].passes[extra.name], extra.pixels(layer))
        self.end()
        # Only the complete result keeps stamped metadata.
        whole = self._engine.get_result()
        for name, value in stamped.items():
            stamp_field(whole, f"mrpnn.{self._view_layer.name}.{name}", value)
        for name, value in mattes.items():
            stamp_field(whole, name, value)

    def end(self) -> None:
        """Close the result; a stopped render keeps its finished parts."""
        if self._result is not None:
            _fill(self._result.layers[0].passes["Combined"], self._image)
            self._engine.end_result(self._result)
            self._result = None

    def _begin(self) -> "bpy.types.RenderResult":
        if self._result is None:
            height, width = self._image.shape[:2]
            for extra in self._extras:
                self._engine.add_pass(extra.name, len(extra.channels), extra.channels, layer=self._view_layer.name)
            self._result = self._engine.begin_result(0, 0, width, height, layer=self._view_layer.name, view=self._view)
        return self._result

    def _put(self, window: tuple[int, int, int, int], image: np.ndarray) -> None:
        x0, y0, x1, y1 = window
        left, top = self._camera.window[:2]
        if self._background is not None:
            image = over(image, self._background.pixels(window))
        self._image[y0 - top : y1 - top, x0 - left : x1 - left] = image

    def _show(self) -> None:
        result = self._begin()
        _fill(result.layers[0].passes["Combined"], self._image)
        self._engine.update_result(result)


def _fill(render_pass: "bpy.types.RenderPass", pixels: np.ndarray) -> None:
    """pixels: float32 (H, W, channels), rows from the top; Blender's start at the bottom."""
    rect: Any = render_pass.rect
    rect.foreach_set(np.ascontiguousarray(pixels[::-1], np.float32).ravel())
