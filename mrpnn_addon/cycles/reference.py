# SPDX-License-Identifier: GPL-3.0-or-later
"""A path-traced reference of the same view, rendered by Cycles in this process."""

import tempfile
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...inference.scene import SceneError
from ..nodes.material import SURFACES, shows_volume
from ..objects.visibility import visible_objects
from .reference_scene import CHECK_DEPTH, PathTracing, box_scene, view_scene

CHECK_TOLERANCE = 0.02
DEFAULTS = PathTracing()


@dataclass
class Reference:
    """Two independent renders of one view.

    a, b: float32 (H, W, 4), rows from the top: linear premultiplied radiance and alpha.
    seconds: wall-clock time of both, scene preparation included.
    samples: per pixel in each half.
    bounces: most scattering events along a path.
    version: of the Blender that rendered them.
    """

    a: np.ndarray
    b: np.ndarray
    seconds: float
    samples: int
    bounces: int
    version: str


def render_reference(
    scene: "bpy.types.Scene",
    objects: "Sequence[bpy.types.Object]",
    tracing: PathTracing = DEFAULTS,
    world: "bpy.types.World" = None,
    seed: int = 0,
    progress: Callable[[float, str], None] | None = None,
) -> Reference:
    """Path trace `objects` (volumes and suns) from the scene's camera, in `world` or on a black World.

    scene: gives frame, camera, resolution, render region and thread count; it is not changed.
    objects: the objects to show, whatever else the scene holds.
    tracing: its samples are those of each of the two halves.
    world: lights the objects where the layer holds its light.
    progress: called with (fraction done, text) before each render; an exception that it raises stops the work.

    Raises SceneError where the scene has no camera, Cycles is disabled or fails, or Cycles
    does not render a homogeneous box correctly here.
    """
    report = progress or (lambda fraction, text: None)
    halves = []
    with view_scene(scene, objects, tracing, world) as reference:
        report(0.0, "checking Cycles against a homogeneous box")
        check_homogeneous_box()
        start = time.perf_counter()
        for half in range(2):
            report(half / 2, f"rendering reference {half + 1} of 2 in Cycles, {tracing.samples} samples per pixel")
            reference.cycles.seed = 2 * seed + half
            halves.append(_render(reference))
    a, b = halves
    return Reference(a, b, time.perf_counter() - start, tracing.samples, tracing.bounces, bpy.app.version_string)


def volumes_and_lights(depsgraph: "bpy.types.Depsgraph", left_out: Collection[str] = ()) -> list:
    """The objects that the layer shows, or that instance them: the contents of a reference.

    left_out: see `SceneDescription`.

    Raises SceneError where one object instances volumes together with surfaces or hidden lights, which the reference
    would show too.
    """
    sources, others = {}, {}
    for shown in visible_objects(depsgraph):
        volume = shows_volume(shown.object) and shown.visible_to("camera")
        light = shown.object.type == "LIGHT" and shown.visible_to("volume_scatter")
        if (volume or light) and shown.name not in left_out:
            sources[shown.source.name] = shown.source
        elif shown.object.type in SURFACES or shown.object.type == "LIGHT" or shown.name in left_out:
            others[shown.source.name] = shown.source
    for name in sources.keys() & others.keys():
        raise SceneError(
            f'object "{name}" instances a volume or light together with something that is not '
            "rendered; Cycles' image would show both, so they cannot be compared"
        )
    return list(sources.values())


def check_homogeneous_box() -> float:
    """Cycles' alpha of a box of optical thickness CHECK_DEPTH. Raises SceneError where it is wrong."""
    with tempfile.TemporaryDirectory() as folder, box_scene(folder) as reference:
        alpha = float(_render(reference)[..., 3].mean())
    require_box_alpha(alpha)
    return alpha


def require_box_alpha(alpha: float) -> None:
    """Raises SceneError unless `alpha` is that of the check's box, within CHECK_TOLERANCE."""
    expected = 1.0 - np.exp(-CHECK_DEPTH)
    if not abs(alpha - expected) <= CHECK_TOLERANCE:
        raise SceneError(
            f"Cycles {bpy.app.version_string} does not render volumes correctly here, so nothing can be compared with "
            "it; use Blender from blender.org"
        )


def _render(scene: "bpy.types.Scene") -> np.ndarray:
    """Render `scene` through a temporary EXR file: float32 (H, W, 4), rows from the top."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "render.exr"
        scene.render.filepath = str(path)
        bpy.ops.render.render(scene=scene.name, write_still=True)
        if not path.exists():
            raise SceneError("Cycles was stopped before it finished the reference")
        return read_image(path)


def read_image(path: Path) -> np.ndarray:
    """The values of an image file: float32 (H, W, 4), rows from the top."""
    image = bpy.data.images.load(str(path))
    try:
        # No colour transform, no premultiplication.
        image.colorspace_settings.is_data = True
        image.alpha_mode = "CHANNEL_PACKED"
        width, height = image.size
        pixels = np.empty(width * height * 4, np.float32)
        values: Any = image.pixels
        values.foreach_get(pixels)
    finally:
        bpy.data.images.remove(image)
    return pixels.reshape(height, width, 4)[::-1].copy()
