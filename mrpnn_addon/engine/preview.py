# SPDX-License-Identifier: GPL-3.0-or-later
"""Progressive pictures of a viewport, rendered on a thread; calls no bpy."""

import threading
import traceback
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ... import inference
from ...inference import RenderCache
from ...inference.plan.lights import brightest_light
from ...inference.scene import Camera, Cancelled, Light, SceneError, Settings
from ..output.layer_frame import rgba
from ..runtime.background import start_thread
from ..scene.reader import SceneDescription

# Pixels of the pictures before the last, which has the region's resolution.
ROUGH_PIXELS, FINER_PIXELS = 4_000, 16_000
# Regions up to which the last picture follows so soon upon the first that one in between would only delay it.
SMALL_REGION = 150_000


@dataclass
class Prepared:
    """State shared by one viewport's pictures.

    shadows, fields: the SceneDescription for all of whose suns `cache` holds them.
    """

    cache: RenderCache
    shadows: SceneDescription | None = None
    fields: SceneDescription | None = None


@dataclass
class Step:
    """One picture of a preview: its resolution, lights and settings."""

    size: tuple[int, int]
    lights: Sequence[Light]
    settings: Settings


def steps(description: SceneDescription, camera: Camera, settings: Settings, prepared: Prepared) -> list[Step]:
    """Pictures from coarse to fine. What the first one needs is cached or quick to compute."""
    coarse = replace(settings, depth_samples=1, light_paths=False, detail_width=camera.resolution[0])
    rough, finer = (_size(camera.resolution, pixels) for pixels in (ROUGH_PIXELS, FINER_PIXELS))
    every = description.lights
    last = [Step(finer, every, coarse), Step(camera.resolution, every, settings)]
    if prepared.fields is description:
        small = np.prod(camera.resolution) <= SMALL_REGION
        return [Step(rough, every, coarse), *(last[1:] if small else last)]
    single = replace(coarse, multiple=False)
    if prepared.shadows is description:
        return [Step(rough, every, single), *last]
    brightest = brightest_light(every, description.volumes) or every
    return [Step(rough, brightest, single), Step(finer, every, single), *last]


def _size(resolution: tuple[int, int], pixels: int) -> tuple:
    """The resolution divided by an integer so that at most so many pixels remain."""
    width, height = resolution
    divisor = int(np.ceil(max(width * height / pixels, 1.0) ** 0.5))
    return max(width // divisor, 1), max(height // divisor, 1)


class Preview:
    """Renders one view on a thread of its own, coarse to fine.

    picture: the latest, float32 (H, W, 4) with rows from the bottom, or None. number: of pictures so far. message: the
    error, or "". done: whether the last picture is finished.
    """

    def __init__(self, description: SceneDescription, camera: Camera, settings: Settings, prepared: Prepared) -> None:
        self.picture: np.ndarray | None = None
        self.number, self.message, self.done = 0, "", False
        self._stop = threading.Event()
        start_thread(
            lambda: self._run(description, camera, settings, prepared), "mrpnn preview", self.stop, awaited=False
        )

    def stop(self) -> None:
        """Ask the thread to stop; no picture follows."""
        self._stop.set()

    @property
    def stopped(self) -> bool:
        return self._stop.is_set()

    def _run(self, description: SceneDescription, camera: Camera, settings: Settings, prepared: Prepared) -> None:
        if not description.volumes:
            self.done = True
            return
        try:
            for step in steps(description, camera, settings, prepared):
                layer = inference.render(
                    description.volumes,
                    step.lights,
                    replace(camera, resolution=step.size),
                    step.settings,
                    cancelled=self._stop.is_set,
                    cache=prepared.cache,
                    surfaces=description.surfaces,
                )
                if self.stopped:
                    return
                _remember(prepared, description, step)
                self.picture, self.number = np.ascontiguousarray(rgba(layer)[::-1]), self.number + 1
            self.done = True
        except Cancelled:
            pass
        except SceneError as error:
            self.message, self.done = str(error), True
        except Exception as error:
            traceback.print_exc()
            self.message, self.done = f"MRPNN failed, which is a bug: {type(error).__name__}: {error}", True


def _remember(prepared: Prepared, description: SceneDescription, step: Step) -> None:
    if len(step.lights) == len(description.lights):
        prepared.shadows = description
        # Fields of several suns or colours replace each other in the cache.
        one = len(step.lights) == 1 and all(len(set(medium.sigma_t)) == 1 for _, medium in description.volumes)
        if one and step.settings.multiple:
            prepared.fields = description
