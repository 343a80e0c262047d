# SPDX-License-Identifier: GPL-3.0-or-later
"""One comparison of a Blender scene, from reading the scene to writing the report."""

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import bpy
import numpy as np

from ...inference import available_models
from ...inference.network.baselines import OCTAVES, SINGLE, register_baselines
from ...inference.scene import SceneError, Settings
from ..cycles.choices import has_null_scattering
from ..cycles.pass_store import Job, PassStore, scene_key
from ..cycles.process import CyclesProcess
from ..cycles.reference import read_image, volumes_and_lights
from ..scene.kept_frame import goes_to
from ..scene.reader import read_scene, require_volumes
from ..volumes.reader import VolumeReader
from . import report as comparison_report
from .job import ComparisonJob
from .plan import Request, ladders, usual_jobs
from .results import Comparison, compare, halves

REPORT_FOLDER = "//mrpnn-comparison"
# Depth samples of the judged network's ladder, besides the scene's own.
DEPTHS = (1, 2, 4, 16)
POLL_INTERVAL = 0.02


@dataclass
class Options:
    """samples, seconds, ladder: see Request. denoised: whether Cycles is measured with denoising too; usual: as artists
    set it. all_models: every network, not only the scene's. models: names of further ones. depths: of the judged
    network. bounces: of Cycles. scale: per cent of the resolution. reference_path: an .exr, or "". folder: of the
    report, as a Blender path.
    """

    samples: int = 32
    seconds: float = 0.0
    ladder: int = 64
    denoised: bool = True
    usual: bool = False
    all_models: bool = False
    models: tuple[str, ...] = ()
    depths: tuple[int, ...] = DEPTHS
    bounces: int = 1024
    scale: int = 25
    reference_path: str = ""
    folder: str = REPORT_FOLDER


class ComparisonRun:
    """Reads the scene of `context`, which may change afterwards. reader: as of `read_scene`.

    Raises SceneError for what cannot be compared, and OSError where the folder cannot be created.
    """

    def __init__(
        self, context: "bpy.types.Context", settings: Settings, options: Options, reader: VolumeReader | None = None
    ) -> None:
        self.options, self.settings, self.scene = options, settings, context.scene
        self.folder = _folder(options.folder)
        self.given = _read_reference(options.reference_path) if options.reference_path else None
        register_baselines()
        layers = _layers(settings, options)
        with scaled(context.scene, options.scale):
            depsgraph = context.evaluated_depsgraph_get()
            # Of the region's size and without surfaces, as Cycles' image.
            read = read_scene(depsgraph, reader, go_to=goes_to(context.scene))
            self.description = replace(read, crop=True, opaque=[], views=[])
            require_volumes(self.description)
            process = CyclesProcess(
                context.scene,
                volumes_and_lights(depsgraph, self.description.left_out),
                options.bounces,
                context.scene.world if self.description.environment else None,
            )
        null = has_null_scattering(context.scene)
        self.request = Request(
            layers,
            options.samples,
            options.ladder if self.given is None else 0,
            ladders(options.denoised, null),
            usual_jobs(null) if options.usual and self.given is None else (),
            options.seconds,
            self.given is not None,
        )
        folder, version = self.folder / "passes", bpy.app.version_string
        self.job = ComparisonJob(
            self.request,
            self.description,
            settings,
            lambda: PassStore(folder / scene_key(self.description, options.bounces, version)),
            process,
        )

    def wait(self, progress: Callable[[float, str], None] | None = None) -> None:
        """Block until the comparison is done. progress: called with (fraction, message). Ctrl-C stops and keeps what is
        finished.
        """
        try:
            while not self.job.done:
                self.job.step()
                if progress:
                    progress(self.job.fraction, self.job.message)
                time.sleep(POLL_INTERVAL)
        except KeyboardInterrupt:
            pass
        finally:
            self.job.stop()

    def result(self) -> Comparison:
        """The figures of what is finished. Raises the exception that ended the job, and SceneError where too little is
        finished.
        """
        if self.job.error is not None and not self.job.cancelled:
            raise self.job.error
        if self.request.layers[0] not in self.job.passes:
            raise SceneError("the comparison was stopped before its first image was finished")
        marks = ["stopped before its end"] if self.job.cancelled else []
        return compare(
            self.job.passes,
            self.request,
            self.options.bounces,
            bpy.app.version_string,
            self.given,
            [*marks, *self.job.marks],
        )

    def write(self, comparison: Comparison) -> Path:
        """Write the report's files; returns the page's path."""
        *_, page = self.writing(comparison)
        return page

    def writing(self, comparison: Comparison) -> Iterator[Path]:
        """As `write`, in short steps: see `report.writing`."""
        return comparison_report.writing(self, comparison)

    def layer_image(self) -> np.ndarray:
        """float32 (H, W, 4), rows from the top."""
        return self.job.passes[self.request.layers[0]].image

    def reference_image(self) -> np.ndarray:
        """float32 (H, W, 4), rows from the top: the mean of both halves."""
        return self.given if self.given is not None else np.mean(halves(self.job.passes), axis=0).astype(np.float32)


def _layers(settings: Settings, options: Options) -> tuple[Job, ...]:
    """The judged image first, then its ladder, other networks, and the baselines."""

    def job(model: str, depths: int) -> Job:
        return Job(model, depths, settings.seed)

    own = settings.depth_samples
    layers = [job(settings.model, depths) for depths in (own, *(d for d in options.depths if d != own))]
    others = dict.fromkeys([*(available_models() if options.all_models else ()), *options.models])
    layers += [job(model, own) for model in others if model != settings.model]
    return tuple(layers + [job(OCTAVES, own), job(SINGLE, 1)])


@contextmanager
def scaled(scene: "bpy.types.Scene", percentage: int) -> Iterator[None]:
    """The scene at a percentage of its resolution, restored afterwards."""
    before = scene.render.resolution_percentage
    scene.render.resolution_percentage = max(1, before * percentage // 100)
    try:
        yield
    finally:
        scene.render.resolution_percentage = before


def _folder(path: str) -> Path:
    if path.startswith("//") and not bpy.data.filepath:
        return Path(bpy.app.tempdir or os.path.curdir).absolute() / path[2:]
    return Path(bpy.path.abspath(path)).absolute()


def _read_reference(path: str) -> np.ndarray | None:
    file = Path(bpy.path.abspath(path))
    if not file.is_file():
        raise SceneError(f"the reference {file} does not exist; choose an .exr file")
    try:
        image = read_image(file)
    except RuntimeError as error:
        raise SceneError(f"the reference {file} cannot be read: {str(error).strip()}") from None
    if image.size == 0 or not np.isfinite(image).all():
        raise SceneError(
            f"the reference {file} is empty or has NaN or infinite values; render it again as OpenEXR with RGBA"
        )
    return image
