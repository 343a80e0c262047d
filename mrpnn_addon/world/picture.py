# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of Worlds, rendered by Cycles: as volumes and as cameras see them."""

import subprocess
from collections.abc import Callable
from dataclasses import dataclass

import bpy
import numpy as np

from ...inference.scene import Camera
from ..nodes.environment_image import sampler
from .content_key import trees, world_key
from .process import SECONDS, PictureFailed, WorldProcess

# Number of Worlds whose light is cached: an animated sky is another World in each frame.
MAX_LIGHTS = 16
# Numbers of Worlds whose process and views are cached, and of views of each.
MAX_SOURCES, MAX_VIEWS = 2, 2
# Samples per second that any machine renders.
SAMPLES_PER_SECOND = 500_000
# Coordinates that depend on the view, not only on the direction.
VIEW_COORDINATES = {"Window", "Camera"}


@dataclass
class WorldPicture:
    """sky: float32 (rows, columns, 3), equirectangular, rows from the bottom, without sun discs.

    suns: float64 (n, 7), direction, irradiance and angular diameter in radians of each disc.
    """

    sky: np.ndarray
    suns: np.ndarray

    def radiance(self, directions: np.ndarray) -> np.ndarray:
        """(n, 3) from directions (n, 3), without the discs."""
        return sampler(self.sky)(directions)


class WorldSource:
    """A World of a scene, to be rendered by another Blender; any thread may read it, as a `VolumeSource`.

    key: equal where the World looks the same. depends_on_view: whether its radiance depends on more than the direction.
    panorama: its cached 360-degree view, set by `engine.backdrop`. Made by `world_source` on Blender's main thread.
    """

    message = "rendering the sky"
    panorama: np.ndarray | None = None

    def __init__(self, key: tuple, world: "bpy.types.World", scene: "bpy.types.Scene") -> None:
        """world: evaluated. scene: gives the frame."""
        self.key, self._unsaved = key, _unsaved_image(world)
        self._views: dict[str, np.ndarray] = {}
        self.depends_on_view = bool(view_coordinates(world))
        self._process = WorldProcess(world, scene)

    def read(
        self,
        started: Callable[[subprocess.Popen], None] = lambda process: None,
        check: Callable[[], None] = lambda: None,
    ) -> "WorldPicture | PictureFailed":
        """The WorldPicture, or a PictureFailed with the reason; cached for `world_picture`.

        check: called often; an exception that it raises stops the work.
        """
        found: WorldPicture | PictureFailed
        try:
            found = WorldPicture(**self._ask({}, check))
        except PictureFailed as failure:
            found = failure
        while len(_known) >= MAX_LIGHTS:
            del _known[next(iter(_known))]
        _known[self.key] = found
        return found

    def view(
        self, camera: Camera, samples: int, pixel_filter: tuple[str, float], check: Callable[[], None] = lambda: None
    ) -> np.ndarray:
        """float32 (h, w, 3): the World in the camera's window at its exposure, rows from the top. Raises PictureFailed.

        pixel_filter: Cycles' filter type and its width in pixels. check: as of `read`.
        """
        job = _view_job(camera, samples, pixel_filter)
        key = repr(job)
        if key not in self._views:
            x0, y0, x1, y1 = camera.window
            seconds = SECONDS + (x1 - x0) * (y1 - y0) * samples / SAMPLES_PER_SECOND
            found = np.ascontiguousarray(self._ask({"view": job}, check, seconds)["pixels"][::-1])
            while len(self._views) >= MAX_VIEWS:
                del self._views[next(iter(self._views))]
            self._views[key] = found
        found = self._views[key]
        return found if camera.exposure == 1.0 else found * np.float32(camera.exposure)

    def _ask(self, job: dict, check: Callable[[], None], seconds: float = SECONDS) -> dict:
        if self._unsaved:
            raise PictureFailed(f'image "{self._unsaved}" has unsaved changes; save or pack it')
        return self._process.ask(job, check, seconds)

    def has_view(self, camera: Camera, samples: int, pixel_filter: tuple[str, float]) -> bool:
        """Whether `view` of the same arguments is cached."""
        return repr(_view_job(camera, samples, pixel_filter)) in self._views

    def stop(self) -> None:
        """End its process."""
        self._process.stop()


def _view_job(camera: Camera, samples: int, pixel_filter: tuple[str, float]) -> dict:
    """What the process is asked for a camera's view; its `repr` identifies the view."""
    numbers = {
        name: np.array(getattr(camera, name)).tolist()
        for name in ("resolution", "fov", "ortho_scale", "shift", "pixel_aspect", "longitude", "latitude")
    }
    return {
        "matrix": camera.world_matrix.tolist(),
        "projection": camera.projection,
        "region": camera.region,
        "samples": samples,
        "filter": pixel_filter,
        **numbers,
    }


_known: dict[tuple, WorldPicture | PictureFailed] = {}
_sources: dict[tuple, WorldSource] = {}


def world_source(world: "bpy.types.World", scene: "bpy.types.Scene") -> WorldSource:
    """The source of an evaluated World in its scene's frame; shared while the World looks the same."""
    key = _key(world, scene)
    source = _sources.pop(key, None) or WorldSource(key, world, scene)
    while len(_sources) >= MAX_SOURCES:
        del _sources[next(iter(_sources))]
    # Least recently used first.
    _sources[key] = source
    return source


def is_known(world: "bpy.types.World", scene: "bpy.types.Scene") -> bool:
    """Whether `world_picture` is cached."""
    return _key(world, scene) in _known


def cached_source(world: "bpy.types.World", scene: "bpy.types.Scene") -> WorldSource | None:
    """The source of an evaluated World, if it has one already."""
    return _sources.get(_key(world, scene))


def world_picture(
    world: "bpy.types.World", scene: "bpy.types.Scene", check: Callable[[], None] = lambda: None
) -> WorldPicture:
    """An evaluated World in its scene's frame as volumes see it; rendered on the first request, which takes seconds.

    check: as of `WorldSource.read`. Raises PictureFailed.
    """
    found = _known.get(_key(world, scene)) or world_source(world, scene).read(check=check)
    if isinstance(found, PictureFailed):
        raise found
    return found


def view_coordinates(world: "bpy.types.World") -> list[str]:
    """Which of VIEW_COORDINATES a World's nodes read."""
    return sorted(_outputs_read(world, "ShaderNodeTexCoord") & VIEW_COORDINATES)


def reads_depth(world: "bpy.types.World") -> bool:
    """Whether a World's nodes read how often light has scattered."""
    return "Ray Depth" in _outputs_read(world, "ShaderNodeLightPath")


def _outputs_read(world: "bpy.types.World", kind: str) -> set[str]:
    """Names of the outputs that are linked of nodes of a kind."""
    links = [link for tree in trees(world) for link in tree.links]
    return {link.from_socket.name for link in links if link.from_node.bl_idname == kind}


def forget() -> None:
    """End all processes and drop all pictures."""
    for source in _sources.values():
        source.stop()
    _sources.clear()
    _known.clear()


def _key(world: "bpy.types.World", scene: "bpy.types.Scene") -> tuple:
    moves = any(image.source in ("SEQUENCE", "MOVIE") for image in _images(world))
    space = getattr(getattr(bpy.data, "colorspace", None), "working_space", "")
    return "world", world_key(world), space, scene.frame_current if moves else None


def _images(world: "bpy.types.World") -> list[bpy.types.Image]:
    nodes = (node for tree in trees(world) for node in tree.nodes)
    return [node.image for node in nodes if isinstance(getattr(node, "image", None), bpy.types.Image)]


def _unsaved_image(world: "bpy.types.World") -> str:
    """Name of an image with unsaved changes, or ""."""
    return next((image.name for image in _images(world) if image.is_dirty), "")
