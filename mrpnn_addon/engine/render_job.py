# SPDX-License-Identifier: GPL-3.0-or-later
"""One render of a scene that has been read, in the calling thread or on a worker thread."""

import json
import os
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ... import inference
from ...inference.image.layer import Layer, empty_layer
from ...inference.numerics.small_matmul import affine_inverse
from ...inference.runtime.report import Report
from ...inference.scene import Camera, Cancelled, SceneError, Settings
from ..objects.views import View, view_path
from ..objects.workload import Workload
from ..output.deep_exr import write_deep
from ..output.layer_exr import write_layers
from ..output.layer_frame import in_frame
from ..runtime.background import Worker
from ..runtime.onnxruntime_version import check_runtime
from ..scene.light_groups import sum_of_groups
from ..scene.reader import SceneDescription
from .render_result import RenderResult
from .steps import Steps, Tell

# Pixels of the first picture, which appears within about a second.
COARSE_PIXELS = 8000
# A picture with at least this alpha and at most this radiance is black to the eye.
OPAQUE, BLACK = 0.99, 1e-3


@dataclass
class Finished:
    """layer: in the frame of Blender's image. seconds: since the render was asked for. warnings: of all of it.
    workload: None without volumes. layers: of each view; `layer` is the first. files: that were written.
    """

    layer: Layer
    seconds: float
    warnings: list[str]
    workload: Workload | None = None
    layers: list[tuple[View, Layer]] = field(default_factory=list)
    files: list[str] = field(default_factory=list)


def render_scene(
    scene: SceneDescription,
    settings: Settings,
    exr_path: str | None = None,
    progress: Tell | None = None,
    cancelled: Callable[[], bool] | None = None,
    parts: Mapping[str, RenderResult] | None = None,
    started: float | None = None,
) -> Finished:
    """Render all views of a scene. Calls no bpy, so any thread may call this.

    exr_path: absolute path of a multi-layer EXR to write, or None; files of several views get their suffixes. A deep
    one is written beside it where the scene asks for that. parts:
    for each view by name, what shows its coarse picture and its finished parts. started: `time.perf_counter()` when the
    render was asked for, before the scene was read; now by default.

    Raises SceneError for what cannot be rendered, Cancelled when `cancelled()` returns True, and OSError where the file
    cannot be written.
    """
    runtime_warnings, started = check_runtime(), time.perf_counter() if started is None else started

    def check() -> None:
        if cancelled and cancelled():
            raise Cancelled()

    views = scene.views or [View("", "", scene.camera)]
    settings = replace(settings, outputs=settings.outputs | scene.wanted.outputs)
    # The views share what does not depend on them.
    cache, layers = inference.RenderCache(), []
    try:
        for number, view in enumerate(views):
            seen, part = scene.seen_by(view), parts[view.name] if parts else None
            reported = _share(progress, number, len(views)) if progress else None
            # A frame without smoke yet is valid.
            layer = (
                _render(seen, settings, reported, cancelled, part, cache)
                if seen.volumes
                else empty_layer(seen.camera, settings.outputs)
            )
            scene.wanted.add_to(layer, seen.camera)
            layers.append((view, in_frame(layer, seen.camera, seen.crop)))
        if exr_path and progress:
            progress(1.0, "writing the file")
        files = _write(exr_path, layers, scene, settings, check) if exr_path else []
    except MemoryError:
        raise SceneError(
            "not enough memory for this render; use fewer depth samples, a smaller image or smaller "
            "grids, or close other programs"
        ) from None
    reports = [layer.report for _, layer in layers]
    warnings = [*scene.warnings, *(text for report in reports for text in report.warnings), *runtime_warnings]
    warnings += [text for view, layer in layers for text in _dark(scene, view.camera, layer)]
    suns = reports[0].counts.get("suns")
    workload = scene.workload(settings.depth_samples, suns) if scene.volumes else None
    seconds = time.perf_counter() - started
    return Finished(layers[0][1], seconds, list(dict.fromkeys(warnings)), workload, layers, files)


def _dark(scene: SceneDescription, camera: Camera, layer: Layer) -> list[str]:
    """A warning where the camera is inside a volume and sees nothing but black."""
    if not scene.lights or layer.alpha.min(initial=1.0) < OPAQUE or layer.rgb.max(initial=0.0) > BLACK:
        return []
    for volume, _ in scene.volumes:
        index = (affine_inverse(volume.world_from_index) @ camera.world_matrix[:, 3])[:3]
        if np.all(index > -0.5) and np.all(index < np.array(volume.density.shape) - 0.5):
            return [
                f'the camera is inside volume "{volume.name}", which is so dense there that the picture is black; move '
                "the camera out of it, or lower its Density"
            ]
    return []


def _share(progress: Tell, number: int, count: int) -> Tell:
    """The progress of one of several views."""
    return lambda fraction, message: progress((number + fraction) / count, message)


def _write(
    path: str, layers: list[tuple[View, Layer]], scene: SceneDescription, settings: Settings, check: Callable[[], None]
) -> list[str]:
    """Write the layers of all views, to one file or to one each; returns the paths."""
    if scene.in_one_file:
        files = {path: layers}
    else:
        files = {view_path(path, view.suffix): [(View("", "", view.camera), layer)] for view, layer in layers}
    for file, held in files.items():
        of_views = {view.name: layer for view, layer in held}
        told = metadata(scene, settings, held[0][1].report) | scene.wanted.metadata(scene.view_layer, held[0][1])
        write_layers(file, of_views, scene.view_layer, told, check)
    return [*files, *write_deep_files(path, layers, check)]


def deep_path(path: str) -> str:
    """The path of the deep file beside a picture."""
    return f"{os.path.splitext(path)[0]}_deep.exr"


def write_deep_files(
    path: str, layers: list[tuple[View, Layer]], check: Callable[[], None] = lambda: None
) -> list[str]:
    """Write the deep samples of all views beside a picture at a path, one file each; returns the paths.

    Empty where the layers have none. Raises OSError where a file cannot be written.
    """
    files = []
    for view, layer in layers:
        if layer.deep is not None:
            files.append(view_path(deep_path(path), view.suffix))
            write_deep(files[-1], layer.deep, {"mrpnn.model": layer.report.model}, check)
    return files


def _render(
    scene: SceneDescription,
    settings: Settings,
    progress: Tell | None,
    cancelled: Callable[[], bool] | None,
    parts: RenderResult | None,
    cache: inference.RenderCache,
) -> Layer:
    # The final picture reuses what the coarse one computes; lookup lattices cover only the view.
    groups = list(scene.groups.parts(scene)) if scene.groups.names else []
    pictures = max(len(groups) + bool(groups and "deep" in settings.outputs), 1)
    steps, first = Steps(progress, pictures, parts is not None), None
    if parts is not None:
        settings_of_first = replace(settings, depth_samples=1, outputs=frozenset())
        camera = coarse_camera(scene.camera)
        first = inference.render(
            scene.volumes, scene.lights, camera, settings_of_first, steps.coarse, cancelled, cache, scene.surfaces
        )
        parts.show_coarse(first)
    if groups:
        # The opacity is the same in all of them. Deep samples are those of all light together.
        deep = settings.outputs & {"deep"}
        outputs = [settings.outputs - deep] + [frozenset()] * (len(groups) - 1)
        layer = sum_of_groups(
            {
                name: inference.render(
                    volumes,
                    lights,
                    scene.camera,
                    replace(settings, outputs=outputs[number]),
                    steps.picture(number),
                    cancelled,
                    cache,
                    surfaces,
                )
                for number, (name, volumes, lights, surfaces) in enumerate(groups)
            }
        )
        if deep:
            last, settings = steps.picture(len(groups)), replace(settings, outputs=deep)
            deep_layer = inference.render(
                scene.volumes, scene.lights, scene.camera, settings, last, cancelled, cache, scene.surfaces
            )
            layer.deep = deep_layer.deep.showing(layer.rgb) if deep_layer.deep else None
    else:
        for window, layer in inference.render_tiles(
            scene.volumes,
            scene.lights,
            scene.camera,
            settings,
            steps.picture(0),
            cancelled,
            cache,
            scene.surfaces,
        ):
            if parts is not None and layer.report is None:
                parts.show_part(window, layer)
    if first is not None:
        # What the coarse picture has computed for the whole.
        layer.report.add_seconds(first.report)
    return layer


def coarse_camera(camera: Camera) -> Camera:
    """A camera with the same window at about COARSE_PIXELS."""
    x0, y0, x1, y1 = camera.window
    divisor = max(int(np.ceil(((x1 - x0) * (y1 - y0) / COARSE_PIXELS) ** 0.5)), 1)
    width, height = (max(-(-n // divisor), 1) for n in camera.resolution)
    left, top = min(x0 // divisor, width - 1), min(y0 // divisor, height - 1)
    right, bottom = max(x1 // divisor, left + 1), max(y1 // divisor, top + 1)
    return replace(camera, resolution=(width, height), region=(left, top, right, bottom))


def metadata(scene: SceneDescription, settings: Settings, report: Report) -> dict:
    """Header attributes of an EXR: frame, settings, network and seconds per stage."""
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


def stamp(settings: Settings, report: Report, seconds: float) -> dict:
    """Metadata of files that Blender writes, as text. seconds: since the render was asked for."""
    return {
        "depthSamples": str(settings.depth_samples),
        "seed": str(settings.seed),
        "model": report.model or "none",
        "modelChecksum": report.checksum,
        "provider": report.provider,
        "seconds": f"{seconds:.2f}",
    }


class RenderJob(Worker):
    """render_scene on a worker thread. result: a Finished when done, or None with `error` set."""

    def __init__(
        self, scene: SceneDescription, settings: Settings, exr_path: str | None, started: float | None = None
    ) -> None:
        """started: as of `render_scene`."""
        self.result: Finished | None = None
        self._task, self._asked = (scene, settings, exr_path), started
        self._start("mrpnn render", awaited=True)

    def _work(self) -> None:
        self.result = render_scene(*self._task, self._progress, lambda: self.stopped, started=self._asked)

    def _progress(self, fraction: float, message: str) -> None:
        self.fraction, self.message = fraction, message
