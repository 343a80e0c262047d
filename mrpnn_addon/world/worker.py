# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders pictures of a World with Cycles; runs in a separate Blender process without the extension.

Arguments, the last three: a .blend file with the World, a frame and its fraction. Each line of standard input is a job
as JSON, answered by the .npz file that its `target` names:

A job without `view` requests the World as volumes see it, from the origin: `sky`, float32 (ROWS, 2 ROWS, 3), an
equirectangular picture with rows from the bottom and without sun discs, and `suns`, float64 (n, 7), direction,
irradiance and angular diameter in radians of each disc.

`view` requests the World as a camera sees it: `pixels`, float32 (h, w, 3), rows from the bottom. It holds the fields of
`inference.Camera`, `samples`, and the pixel `filter` with its width.

The process ends with its input, or after IDLE seconds without a job.
"""

import json
import math
import os
import sys
import threading
from collections.abc import Iterator, Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

IDLE = 30.0
ROWS, SAMPLES = 128, 16
# Discs are located at this minimum size, in radians, and then rendered at their own size through a lens so many times
# as wide.
LOCATING_SIZE, LENS_WIDTHS = math.radians(3.0), 4.0
DISC_PIXELS, DISC_SAMPLES = 96, 32
LUMA = np.array([0.2126, 0.7152, 0.0722])
# Samples of a view whose neighbouring pixels differ by at most a share VARIATION. Other pixels form bands so many rows
# apart, with a rim of the pixel filter's width, at most MAX_BANDS: each band is a render of its own.
FEW_SAMPLES, VARIATION, BAND_GAP, BAND_RIM, MAX_BANDS = 4, 0.02, 32, 2, 4
# Sky types without a sun disc.
DISCLESS_SKIES = {"PREETHAM", "HOSEK_WILKIE"}
# Range of focal length over sensor width: 1 mm over 100 mm, 5000 mm over 1 mm.
WIDEST, LONGEST = 0.01, 5000.0


def main(blend: str, frame: int, fraction: float) -> None:
    shown = {}
    for line in _jobs():
        job = json.loads(line)
        light = "view" not in job
        if light not in shown:
            shown[light] = _loaded(blend, frame, fraction)
        scene, trees = shown[light]
        bpy.context.window.scene = scene
        target = job["target"]
        answer = _light(scene, trees, target) if light else {"pixels": _view(scene, job["view"], target)}
        with open(target + ".part", "wb") as file:
            np.savez(file, **answer)
        os.replace(target + ".part", target)


def _jobs() -> Iterator[str]:
    """Lines of standard input, until none arrives for too long."""
    while True:
        idle = threading.Timer(IDLE, os._exit, [0])
        idle.daemon = True
        idle.start()
        line = sys.stdin.readline()
        idle.cancel()
        if not line:
            return
        yield line


def _loaded(blend: str, frame: int, fraction: float) -> "tuple[bpy.types.Scene, list]":
    """A scene with the World, and the World's node trees."""
    groups = set(bpy.data.node_groups)
    libraries: Any = bpy.data.libraries
    with libraries.load(blend) as (found, wanted):
        wanted.worlds = found.worlds[:1]
    scene = bpy.data.scenes.new("World")
    bpy.context.window.scene = scene
    scene.world = wanted.worlds[0]
    trees = [scene.world.node_tree, *(set(bpy.data.node_groups) - groups)]
    for tree in trees:
        _without_fog(tree)
    _set_up(scene)
    scene.frame_set(frame, subframe=fraction)
    return scene, trees


def _without_fog(tree: Any) -> None:
    for link in list(tree.links):
        if link.to_node.bl_idname == "ShaderNodeOutputWorld" and link.to_socket.identifier == "Volume":
            tree.links.remove(link)


def _light(scene: "bpy.types.Scene", trees: list, target: str) -> dict[str, np.ndarray]:
    discs = [
        node
        for tree in trees
        for node in tree.nodes
        if node.bl_idname == "ShaderNodeTexSky" and node.sky_type not in DISCLESS_SKIES and node.sun_disc
    ]
    for tree in trees:
        _as_volumes_see(tree)
    scene.world.cycles_visibility.camera = True
    for node in discs:
        node.sun_disc = False
    sky = _rendered(scene, _panorama(scene), (2 * ROWS, ROWS), SAMPLES, target)
    suns = [sun for node in discs for sun in _disc(scene, node, sky, target)]
    return {"sky": sky, "suns": np.array(suns).reshape(-1, 7)}


# Outputs of Light Path that are not 0 for light that volumes scatter once and that comes from infinity.
LIGHT_PATH = {"Is Volume Scatter Ray": 1.0, "Ray Length": 3.0e38, "Ray Depth": 1.0}


def _as_volumes_see(tree: Any) -> None:
    """Replace light path queries by their values for light that volumes scatter."""
    for link in list(tree.links):
        node, socket = link.from_node, link.to_socket
        if node.bl_idname == "ShaderNodeLightPath" and hasattr(socket, "default_value"):
            value = LIGHT_PATH.get(link.from_socket.identifier, 0.0)
            tree.links.remove(link)
            try:
                socket.default_value = value
            except (TypeError, ValueError):
                socket.default_value = [value] * len(socket.default_value)


def _set_up(scene: "bpy.types.Scene") -> None:
    render: Any = scene.render
    render.engine = "CYCLES"
    render.film_transparent = False
    render.use_compositing = render.use_sequencer = False
    render.image_settings.file_format, render.image_settings.color_depth = "OPEN_EXR", "32"
    render.image_settings.color_mode, render.image_settings.exr_codec = "RGB", "NONE"
    render.resolution_percentage = 100
    settings = {
        "device": "CPU",
        "use_adaptive_sampling": False,
        "use_denoising": False,
        "film_exposure": 1.0,
        "seed": 0,
        "sample_clamp_direct": 0.0,
        "sample_clamp_indirect": 0.0,
        "pixel_filter_type": "BOX",
    }
    for name, value in settings.items():
        setattr(scene.cycles, name, value)
    # Cameras do not need the World's importance map, which takes long to build.
    scene.world.cycles.sampling_method = "NONE"


def _view(scene: "bpy.types.Scene", view: dict, target: str) -> np.ndarray:
    """Radiance (h, w, 3) in a camera's window, rows from the bottom."""
    width, height = view["resolution"]
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = view["filter"]
    camera = _aimed(scene, view)
    x0, y0, x1, y1 = view["region"] or (0, 0, width, height)
    pixels = _rendered(scene, camera, (width, height), min(view["samples"], FEW_SAMPLES), target, (x0, y0, x1, y1))
    if view["samples"] > FEW_SAMPLES:
        # Few samples suffice for most of a sky.
        for low, high, left, right in _uneven(pixels):
            part = x0 + left, y1 - high, x0 + right, y1 - low
            pixels[low:high, left:right] = _rendered(scene, camera, (width, height), view["samples"], target, part)
    return pixels


def _uneven(pixels: np.ndarray) -> list:
    """Bands of an image (h, w, 3) whose pixels differ from their neighbours: ends of rows, then of columns."""
    level = np.maximum(np.abs(pixels).max(axis=2), 1e-3 * np.abs(pixels).mean())
    uneven = np.zeros(level.shape, bool)
    for one, other in ((np.s_[:-1], np.s_[1:]), (np.s_[:, :-1], np.s_[:, 1:])):
        steps = np.abs(pixels[one] - pixels[other]).max(axis=2) > VARIATION * np.minimum(level[one], level[other])
        uneven[one] |= steps
        uneven[other] |= steps
    rows = np.flatnonzero(uneven.any(axis=1))
    if not len(rows):
        return []
    height, width = level.shape
    bands = []
    for band in np.split(rows, np.flatnonzero(np.diff(rows) > BAND_GAP) + 1):
        columns = np.flatnonzero(uneven[band].any(axis=0))
        bands.append(
            (
                max(band[0] - BAND_RIM, 0),
                min(band[-1] + 1 + BAND_RIM, height),
                max(columns[0] - BAND_RIM, 0),
                min(columns[-1] + 1 + BAND_RIM, width),
            )
        )
    return np.array(bands if len(bands) <= MAX_BANDS else [(0, height, 0, width)]).tolist()


def _aimed(scene: "bpy.types.Scene", view: dict) -> "bpy.types.Object":
    """The scene's camera with the fields of an `inference.Camera`."""
    camera = _camera(scene)
    lens: Any = camera.data
    camera.matrix_world = Matrix(view["matrix"])
    lens.type = {"perspective": "PERSP", "orthographic": "ORTHO", "equirectangular": "PANO"}[view["projection"]]
    lens.sensor_fit = "HORIZONTAL"
    focal = min(max(0.5 / math.tan(0.5 * view["fov"]), WIDEST), LONGEST)
    lens.sensor_width = min(max(50.0 / focal, 1.0), 100.0)
    lens.lens = focal * lens.sensor_width
    lens.ortho_scale = view["ortho_scale"]
    lens.shift_x, lens.shift_y = view["shift"]
    # Neither may be below 1.
    aspect = view.get("pixel_aspect", 1.0)
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = max(1.0 / aspect, 1.0), max(aspect, 1.0)
    if lens.type == "PANO":
        # Properties of Cycles before 5.0.
        panorama = lens if hasattr(lens, "panorama_type") else lens.cycles
        panorama.panorama_type = "EQUIRECTANGULAR"
        for name in ("longitude", "latitude"):
            for end, value in zip(("min", "max"), view[name]):
                setattr(panorama, f"{name}_{end}", value)
    scene.view_layers[0].update()
    return camera


def _panorama(scene: "bpy.types.Scene") -> "bpy.types.Object":
    """The scene's camera as a panorama, +X at its centre and +Z up."""
    turn = Matrix.Rotation(-math.pi / 2.0, 4, "Z") @ Matrix.Rotation(math.pi / 2.0, 4, "X")
    return _aimed(
        scene,
        {
            "matrix": turn,
            "projection": "equirectangular",
            "fov": 1.0,
            "ortho_scale": 1.0,
            "shift": (0.0, 0.0),
            "longitude": (-math.pi, math.pi),
            "latitude": (-math.pi / 2.0, math.pi / 2.0),
        },
    )


def _camera(scene: "bpy.types.Scene") -> "bpy.types.Object":
    if scene.camera is None:
        scene.camera = bpy.data.objects.new("World", bpy.data.cameras.new("World"))
        scene.collection.objects.link(scene.camera)
    return scene.camera


def _rendered(
    scene: "bpy.types.Scene",
    camera: "bpy.types.Object",
    size: tuple[int, int],
    samples: int,
    target: str,
    region: Sequence[int] | None = None,
) -> np.ndarray:
    """Radiance (h, w, 3), rows from the bottom.

    region: (x0, y0, x1, y1) in pixels from the upper left, as `inference.Camera.region`; None for the whole image.
    """
    scene.camera, scene.cycles.samples = camera, samples
    render, (width, height) = scene.render, size
    render.resolution_x, render.resolution_y = width, height
    render.use_border = render.use_crop_to_border = region is not None
    if region is not None:
        x0, y0, x1, y1 = region
        # Blender truncates to whole pixels; a quarter avoids rounding errors.
        render.border_min_x, render.border_max_x = (x0 + 0.25) / width, (x1 + 0.25) / width
        render.border_min_y, render.border_max_y = (height - y1 + 0.25) / height, (height - y0 + 0.25) / height
        width, height = x1 - x0, y1 - y0
    render.filepath = target + ".exr"
    bpy.ops.render.render(scene=scene.name, write_still=True)
    image = bpy.data.images.load(render.filepath)
    image.colorspace_settings.is_data = True
    pixels = np.empty(width * height * image.channels, np.float32)
    values: Any = image.pixels
    values.foreach_get(pixels)
    pixels = pixels.reshape(height, width, image.channels)[..., :3].copy()
    bpy.data.images.remove(image)
    os.unlink(render.filepath)
    return np.nan_to_num(pixels)


def _disc(scene: "bpy.types.Scene", node: Any, sky: np.ndarray, target: str) -> list:
    """The disc of one Sky Texture: direction, irradiance and angular diameter; none where it is not visible."""
    size = node.sun_size
    node.sun_disc, node.sun_size = True, max(size, LOCATING_SIZE)
    found = _rendered(scene, _panorama(scene), (2 * ROWS, ROWS), SAMPLES, target) - sky
    latitude = (np.arange(ROWS) + 0.5) / ROWS * math.pi - math.pi / 2.0
    longitude = (0.5 - (np.arange(2 * ROWS) + 0.5) / (2 * ROWS)) * 2.0 * math.pi
    flat = np.cos(latitude)[:, None]
    directions = _directions(
        flat * np.cos(longitude), flat * np.sin(longitude), np.sin(latitude)[:, None] * np.ones(2 * ROWS)
    )
    light = np.maximum(found, 0.0) @ LUMA * np.cos(latitude)[:, None]
    if not light.max() > 0.0:
        node.sun_disc = False
        return []
    middle = np.einsum("ij,ijk->k", np.where(light > 0.2 * light.max(), light, 0.0), directions)
    node.sun_size = size
    extent = min(max(LENS_WIDTHS * size, LENS_WIDTHS * LOCATING_SIZE / 2.0), 2.0)
    turn = Vector(-middle).to_track_quat("Z", "Y").to_matrix()
    camera = _aimed(
        scene,
        {"matrix": turn.to_4x4(), "projection": "perspective", "fov": extent, "ortho_scale": 1.0, "shift": (0.0, 0.0)},
    )
    bright = _rendered(scene, camera, (DISC_PIXELS, DISC_PIXELS), DISC_SAMPLES, target)
    node.sun_disc = False
    light = bright - _rendered(scene, camera, (DISC_PIXELS, DISC_PIXELS), DISC_SAMPLES, target)
    place = ((np.arange(DISC_PIXELS) + 0.5) / DISC_PIXELS - 0.5) * 2.0 * math.tan(extent / 2.0)
    x, y = np.meshgrid(place, place)
    light *= ((place[1] - place[0]) ** 2 / (1.0 + x * x + y * y) ** 1.5)[..., None]
    irradiance, power = light.sum(axis=(0, 1)), light @ LUMA
    if not power.sum() > 0.0:
        return []
    seen = _directions(x, y, -np.ones_like(x)) @ np.array(turn).T
    middle = np.einsum("ij,ijk->k", power, seen)
    middle /= np.linalg.norm(middle)
    # The mean squared distance from a disc's centre is half its squared radius.
    spread = (power * (1.0 - (seen @ middle) ** 2)).sum() / power.sum()
    return [[*middle, *np.maximum(irradiance, 0.0), 2.0 * math.asin(min(math.sqrt(2.0 * max(spread, 0.0)), 1.0))]]


def _directions(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    directions = np.stack([x, y, z], axis=-1)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


if __name__ == "__main__":
    main(sys.argv[-3], int(sys.argv[-2]), float(sys.argv[-1]))
