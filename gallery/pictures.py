# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of a scene: by the extension, in the way that suits it, and by Cycles in the same processor time."""

import time
from pathlib import Path

import bpy
from PIL import Image

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
    with Image.open(path) as image:
        return image.convert("RGB"), seconds


def ours(scene, path: Path, light: Path) -> tuple[Image.Image, float]:
    """The picture by the extension; seconds with the bake. light: folder for baked light."""
    start = time.process_time()
    prepare(scene, light)
    before = time.process_time() - start
    image, seconds = written(scene, path)
    return image, before + seconds


def cycles(scene, path: Path, seconds: float) -> tuple[Image.Image, float, int]:
    """The picture by Cycles, denoised, in about so many processor seconds; with its own, and samples per pixel."""
    scene.render.engine, settings = "CYCLES", scene.cycles
    settings.use_denoising, settings.use_adaptive_sampling = True, False
    settings.max_bounces = settings.volume_bounces = BOUNCES
    settings.caustics_reflective = settings.caustics_refractive = False
    settings.samples = 1
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
