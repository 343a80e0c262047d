# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of a scene: by the extension, in the way that suits it, and by Cycles in the same processor time."""

import time
from pathlib import Path

import bpy
import numpy as np
from PIL import Image

from evaluation.error import error_text, relative_rmse

#: Cycles' samples for surfaces, and where it shows baked light.
SURFACE_SAMPLES, BAKED_SAMPLES = 32, 16
BOUNCES = 1024


def way(scene) -> str:
    """What suits the scene: "layer", "composite" or "bake"."""
    if scene.render.engine == "CYCLES":
        return "bake"
    materials = [item.data.materials for item in scene.objects if item.type == "MESH" and item.data.materials]
    surfaces = any(link.to_socket.name == "Surface" for slots in materials for link in slots[0].node_tree.links)
    return "composite" if surfaces else "layer"


def prepare(scene, folder: Path) -> None:
    """Bake the scene's light into a folder, or set up its composite, where that is its way."""
    if way(scene) == "bake":
        bpy.ops.mrpnn.bake_light(folder=str(folder))
        bpy.ops.mrpnn.bake_light_fast()
        scene.cycles.samples = BAKED_SAMPLES
    elif way(scene) == "composite":
        scene.cycles.samples, scene.cycles.use_denoising = SURFACE_SAMPLES, True
        bpy.ops.mrpnn.composite()


def written(scene, path: Path) -> tuple[Image.Image, float]:
    """The scene's picture, written as PNG, and its processor seconds."""
    scene.render.filepath, scene.render.image_settings.file_format = str(path), "PNG"
    start = time.process_time()
    bpy.ops.render.render(write_still=True)
    seconds = time.process_time() - start
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth = "OPEN_EXR", "32"
    bpy.data.images["Render Result"].save_render(str(path.with_suffix(".exr")), scene=scene)
    with Image.open(path) as image:
        return image.convert("RGB"), seconds


def radiance(path: Path) -> np.ndarray:
    """Scene-linear values (H, W, 3) of the picture that `written` wrote to this path."""
    image = bpy.data.images.load(str(path.with_suffix(".exr")))
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    bpy.data.images.remove(image)
    return values.reshape(height, width, -1)[..., :3]


def ours(scene, path: Path, light: Path) -> tuple[Image.Image, float]:
    """The picture by the extension; seconds with the bake. light: folder for baked light."""
    start = time.process_time()
    prepare(scene, light)
    before = time.process_time() - start
    image, seconds = written(scene, path)
    return image, before + seconds


def set_cycles(scene):
    """Let Cycles scatter as often as light does; gives its settings."""
    scene.render.engine, settings = "CYCLES", scene.cycles
    settings.use_denoising = settings.use_adaptive_sampling = False
    settings.max_bounces = settings.volume_bounces = BOUNCES
    return settings


def cycles(scene, path: Path, seconds: float) -> tuple[Image.Image, float, int]:
    """The picture by Cycles, denoised, in about so many processor seconds; with its own, and samples per pixel."""
    settings = set_cycles(scene)
    settings.use_denoising, settings.samples = True, 1
    image, one = written(scene, path)
    if one >= seconds:
        return image, one, 1
    settings.samples = 3
    image, three = written(scene, path)
    samples = round(1 + 2 * (seconds - one) / max(three - one, 1e-3))
    if samples > 3:
        settings.samples = samples
        image, three = written(scene, path)
    return image, three, settings.samples


def errors(scene, candidates: list[Path], folder: Path, samples: int) -> list[str]:
    """Relative RMSE of pictures that `written` wrote, against two halves of so many samples by Cycles, not denoised."""
    settings, halves = set_cycles(scene), []
    settings.samples, settings.sample_clamp_indirect = samples, 0.0
    for seed in (1, 2):
        settings.seed = seed
        written(scene, folder / f"half-{seed}.png")
        halves.append(radiance(folder / f"half-{seed}.png"))
    everywhere = np.ones(halves[0].shape[:2], bool)
    found = [relative_rmse(radiance(path), *halves, everywhere) for path in candidates]
    return [error_text(one.value, one.low, one.high) for one in found]
