"""One render of a scene that has been read: on a worker thread, or at once."""

import json
from dataclasses import dataclass
from typing import List, Optional

from .. import inference
from ..inference.layer import Layer, empty_layer
from ..inference.scene import Cancelled, SceneError, Settings
from .cost_model import Work
from .layer_exr import write_layer
from .layer_frame import in_frame
from .runtime import check_runtime
from .scene import SceneDescription
from .worker import Worker


@dataclass
class Finished:
    """layer: in the frame of Blender's image. seconds: of the whole render.
    warnings: of reading and of rendering. asked: what there was to do, None where the scene holds nothing.
    """

    layer: Layer
    seconds: float
    warnings: List[str]
    asked: Optional[Work] = None


def render_scene(scene: SceneDescription, settings: Settings, exr_path: Optional[str] = None,
                 progress=None, cancelled=None) -> Finished:
    """Render; no bpy, so any thread may.

    exr_path: absolute path of a multi-layer EXR to write, or None.

    Raises SceneError for what cannot be rendered, Cancelled when `cancelled()` turned true, and
    OSError where the file cannot be written.
    """
    runtime_warnings = check_runtime()

    def check():
        if cancelled and cancelled():
            raise Cancelled()

    try:
        # A frame in which smoke has not begun is as good as any other.
        layer = empty_layer(scene.camera) if not scene.volumes else inference.render(
            scene.volumes, scene.suns, scene.camera, settings, progress=progress, cancelled=cancelled,
            surfaces=scene.surfaces)
        layer = in_frame(layer, scene.camera, scene.crop)
        if exr_path:
            if progress:
                progress(1.0, "writing the file")
            write_layer(exr_path, layer, scene.view_layer, metadata(scene, settings, layer.report), check)
    except MemoryError:
        raise SceneError("the machine has not enough memory for this render; use fewer depth samples, a smaller image "
                         "or smaller grids, or close other programs") from None
    warnings = [*scene.warnings, *layer.report.warnings, *runtime_warnings]
    asked = scene.work(settings.depth_samples) if scene.volumes else None
    return Finished(layer, layer.report.seconds["total"], warnings, asked)


def metadata(scene: SceneDescription, settings: Settings, report) -> dict:
    """Header attributes of an EXR: frame, settings, network and seconds a stage."""
    found = {
        "Frame": scene.frame,
        "mrpnn.depthSamples": settings.depth_samples,
        "mrpnn.seed": settings.seed,
        "mrpnn.model": report.model,
        "mrpnn.modelChecksum": report.checksum,
        "mrpnn.provider": report.provider,
        "mrpnn.report": json.dumps(report.to_dict()),
    }
    for stage, seconds in report.seconds.items():
        found[f"mrpnn.seconds.{stage.replace(' ', '_')}"] = float(seconds)
    return found


def stamp(settings: Settings, report) -> dict:
    """What Blender's own files say about a render, as text."""
    return {
        "depthSamples": str(settings.depth_samples),
        "seed": str(settings.seed),
        "model": report.model or "none",
        "modelChecksum": report.checksum,
        "provider": report.provider,
        "seconds": f"{report.seconds['total']:.2f}",
    }


class RenderJob(Worker):
    """render_scene on a worker thread. result: once done, a Finished, or None with `error` set."""

    def __init__(self, scene: SceneDescription, settings: Settings, exr_path: Optional[str]):
        self.result: Optional[Finished] = None
        self._task = scene, settings, exr_path
        self._start("mrpnn render", awaited=True)

    def _work(self):
        self.result = render_scene(*self._task, self._progress, lambda: self.stopped)

    def _progress(self, fraction: float, message: str):
        self.fraction, self.message = fraction, message
