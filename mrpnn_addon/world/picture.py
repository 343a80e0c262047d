"""Worlds as Cycles shows them: what volumes see of them, and what a camera does."""

from dataclasses import dataclass
from typing import List, Tuple

import bpy
import numpy as np

from ...inference.scene import Camera
from ..nodes.environment_image import sampler
from .content_key import trees, world_key
from .process import SECONDS, PictureFailed, WorldProcess

# Worlds whose light is remembered: an animated sky is another one in each frame.
MOST = 16
# Worlds whose process and views are kept, and views of each.
MOST_SOURCES, MOST_VIEWS = 2, 2
# Samples of a view that any machine takes in a second.
SLOWEST = 500_000
# Coordinates that depend on the view and not on the direction alone.
OF_THE_VIEW = {'Window', 'Camera'}


@dataclass
class WorldPicture:
    """sky: float32 (rows, columns, 3), equirectangular, rows from the bottom, without sun discs.

    suns: float64 (n, 7), of each disc direction, irradiance and angle across in radians.
    """

    sky: np.ndarray
    suns: np.ndarray

    def radiance(self, directions) -> np.ndarray:
        """(n, 3) from directions (n, 3), without the discs."""
        return sampler(self.sky)(directions)


class WorldSource:
    """A World as it was found in a scene, for a Blender of its own to show: read on any thread, as a `VolumeSource`.

    key: equal where the World looks the same. depends_on_view: whether directions alone do not tell what it shows.
    panorama: what a camera sees all around, kept for `backdrop` once that has asked for it.
    Made where bpy may be asked, by `world_source`.
    """

    message, panorama = "rendering the sky", None

    def __init__(self, key, world, scene):
        """world: evaluated; scene: whose frame it is."""
        self.key, self._views, self._unsaved = key, {}, _unsaved_image(world)
        links = [link for tree in trees(world) for link in tree.links]
        self.depends_on_view = any(link.from_node.bl_idname == 'ShaderNodeTexCoord'
                                   and link.from_socket.name in OF_THE_VIEW for link in links)
        self._process = WorldProcess(world, scene)

    def read(self, started=lambda process: None, check=lambda: None):
        """The WorldPicture, or a PictureFailed that says why there is none; `world_picture` knows it from then on.

        check: called often; what it raises ends the work.
        """
        try:
            found = WorldPicture(**self._ask({}, check))
        except PictureFailed as failure:
            found = failure
        while len(_known) >= MOST:
            del _known[next(iter(_known))]
        _known[self.key] = found
        return found

    def view(self, camera: Camera, samples: int, pixel_filter: Tuple[str, float], check=lambda: None) -> np.ndarray:
        """float32 (h, w, 3): what the camera sees in its window, rows from the top. Raises PictureFailed.

        pixel_filter: of Cycles, with its width in pixels. check: as of `read`.
        """
        numbers = {name: np.array(getattr(camera, name)).tolist()
                   for name in ("resolution", "fov", "ortho_scale", "shift", "longitude", "latitude")}
        job = {"matrix": camera.world_matrix.tolist(), "projection": camera.projection, "region": camera.region,
               "samples": samples, "filter": pixel_filter, **numbers}
        key = repr(job)
        if key not in self._views:
            x0, y0, x1, y1 = camera.window
            seconds = SECONDS + (x1 - x0) * (y1 - y0) * samples / SLOWEST
            found = np.ascontiguousarray(self._ask({"view": job}, check, seconds)["pixels"][::-1])
            while len(self._views) >= MOST_VIEWS:
                del self._views[next(iter(self._views))]
            self._views[key] = found
        return self._views[key]

    def _ask(self, job, check, seconds=SECONDS):
        if self._unsaved:
            raise PictureFailed(f"the changes of image \"{self._unsaved}\" are not saved; save or pack it")
        return self._process.ask(job, check, seconds)

    def stop(self) -> None:
        """End its process."""
        self._process.stop()


_known, _sources = {}, {}


def world_source(world, scene) -> WorldSource:
    """The source of an evaluated World in its scene's frame: the same while the World looks the same."""
    key = _key(world, scene)
    source = _sources.pop(key, None) or WorldSource(key, world, scene)
    while len(_sources) >= MOST_SOURCES:
        del _sources[next(iter(_sources))]
    # The last one used is dropped last.
    _sources[key] = source
    return source


def is_known(world, scene) -> bool:
    """Whether `world_picture` has nothing to render."""
    return _key(world, scene) in _known


def world_picture(world, scene, check=lambda: None) -> WorldPicture:
    """What volumes see of an evaluated World in its scene's frame; rendered where it has not been yet, which takes some
    seconds.

    check: as of `WorldSource.read`. Raises PictureFailed.
    """
    found = _known.get(_key(world, scene)) or world_source(world, scene).read(check=check)
    if isinstance(found, PictureFailed):
        raise found
    return found


def forget() -> None:
    """End all processes and drop all pictures."""
    for source in _sources.values():
        source.stop()
    _sources.clear()
    _known.clear()


def _key(world, scene) -> tuple:
    moves = any(image.source in ('SEQUENCE', 'MOVIE') for image in _images(world))
    return "world", world_key(world), scene.frame_current if moves else None


def _images(world) -> List[bpy.types.Image]:
    nodes = (node for tree in trees(world) for node in tree.nodes)
    return [node.image for node in nodes if isinstance(getattr(node, "image", None), bpy.types.Image)]


def _unsaved_image(world) -> str:
    """The name of an image that its file does not hold as it is, or ""."""
    return next((image.name for image in _images(world) if image.is_dirty), "")
