# SPDX-License-Identifier: GPL-3.0-or-later
"""Temporary scenes in which Cycles renders references.

The user's scene is not changed: a temporary scene links the objects to compare, has its own settings, camera copy and
black World, and is always removed.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from ...inference.scene import SceneError
from ..objects.camera import film_exposure
from ..vdb.openvdb_module import load_openvdb
from ..vdb.worker import utf8_link

# Deviations from Cycles' defaults, which stop after 0 volume bounces, clamp indirect light at 10, denoise, roulette dim
# lights, and filter over neighbouring pixels, where the layer's rays pass through pixel centres (Cycles' box filter
# ignores its width).
UNBIASED = {
    "device": "CPU",
    "feature_set": "SUPPORTED",
    "use_adaptive_sampling": False,
    "use_denoising": False,
    "use_guiding": False,
    "use_fast_gi": False,
    "use_animated_seed": False,
    "time_limit": 0.0,
    "light_sampling_threshold": 0.0,
    "sample_clamp_direct": 0.0,
    "sample_clamp_indirect": 0.0,
    "pixel_filter_type": "BLACKMAN_HARRIS",
    "filter_width": 0.01,
    "transparent_max_bounces": 1024,
    "volume_step_rate": 1.0,
    "volume_max_steps": 65536,
    # Blender 5.0 and later only: null-scattering instead of ray marching.
    "volume_biased": False,
}

CHECK_DEPTH = 1.5


@dataclass(frozen=True)
class PathTracing:
    """How Cycles renders a reference.

    samples: per pixel. bounces: most scattering events along a path, at most 1024. step_rate: of ray marching; below 1
    for textures inside meshes, whose steps are coarse by default. box_filter: whether a pixel is the mean over its
    area, as a layer's is at the edges of surfaces, instead of the value at its centre.
    """

    samples: int = 64
    bounces: int = 1024
    step_rate: float = 1.0
    box_filter: bool = False


@contextmanager
def view_scene(
    scene: "bpy.types.Scene",
    objects: "Sequence[bpy.types.Object]",
    tracing: PathTracing,
    world: "bpy.types.World" = None,
) -> "Iterator[bpy.types.Scene]":
    """A scene that shows `objects` (volumes and suns) from `scene`'s camera, unbiased, on a black World or in `world`.

    scene: gives frame, camera, resolution, render region and thread count; it is not changed.

    Raises SceneError where the scene has no camera or Cycles is disabled.
    """
    if scene.camera is None:
        raise SceneError(f"scene '{scene.name}' has no active camera: set one in the scene properties")
    with _reference_scene(tracing.samples, tracing.bounces) as (reference, keep):
        _copy_view(scene, reference, keep)
        if world is not None:
            reference.world = world
        reference.cycles.volume_step_rate = tracing.step_rate
        _copy_motion_blur(scene, reference)
        # A blurred layer's pixels are means, too.
        if tracing.box_filter or _is_blurred(scene):
            reference.cycles.pixel_filter_type = "BOX"
        for shown in objects:
            reference.collection.objects.link(shown)
        yield reference


def _is_blurred(scene: "bpy.types.Scene") -> bool:
    """Whether a scene's camera has a lens, or its pictures motion blur."""
    lens: Any = scene.camera.data
    return isinstance(lens, bpy.types.Camera) and lens.dof.use_dof or scene.render.use_motion_blur


def _copy_motion_blur(source: "bpy.types.Scene", reference: "bpy.types.Scene") -> None:
    """Copy *Motion Blur*; not *Rolling Shutter*, which the layer has not."""
    for name in ("use_motion_blur", "motion_blur_shutter", "motion_blur_position", "fps", "fps_base"):
        for settings, own in ((reference.render, source.render), (reference.cycles, source.cycles)):
            if hasattr(own, name):
                setattr(settings, name, getattr(own, name))
    mapping: Any = reference.render.motion_blur_shutter_curve
    own_mapping: Any = source.render.motion_blur_shutter_curve
    points, given = (one.curves[0].points for one in (mapping, own_mapping))
    for _ in range(len(points), len(given)):
        points.new(0.5, 0.5)
    while len(points) > len(given):
        points.remove(points[-1])
    for point, other in zip(points, given):
        point.location, point.handle_type = other.location, other.handle_type
    mapping.update()


@contextmanager
def box_scene(folder: str) -> "Iterator[bpy.types.Scene]":
    """A scene of known alpha: a homogeneous box of optical thickness CHECK_DEPTH, its file in `folder`.

    Some versions of Blender lose most of a volume in circumstances that users cannot see (5.0 and later without a
    World, for one); their references would be worthless.
    """
    with _reference_scene(samples=64, bounces=1024) as (reference, keep):
        # A new path each time: Blender caches volume files by path.
        path = Path(folder) / "box.vdb"
        _write_unit_box(path)
        volume = keep(bpy.data.volumes.new("mrpnn check"))
        volume.filepath = str(path)
        volume.materials.append(keep(_white_medium(CHECK_DEPTH)))
        lens = keep(bpy.data.cameras.new("mrpnn check"))
        lens.type, lens.ortho_scale = "ORTHO", 0.5
        box = keep(bpy.data.objects.new("mrpnn check", volume))
        reference.camera = keep(bpy.data.objects.new("mrpnn check", lens))
        reference.camera.location = (0.0, 0.0, 3.0)
        for shown in (box, reference.camera):
            reference.collection.objects.link(shown)
        reference.render.resolution_x = reference.render.resolution_y = 8
        yield reference


@contextmanager
def _reference_scene(samples: int, bounces: int) -> "Iterator[tuple[bpy.types.Scene, Callable[[Any], Any]]]":
    """A new scene set up for an unbiased Cycles render on a black World.

    Yields (scene, keep); keep(data_block) returns the block and has it removed with the scene.
    """
    kept = []

    def keep(block: Any) -> Any:
        kept.append(block)
        return block

    try:
        scene = keep(bpy.data.scenes.new("mrpnn reference"))
        scene.world = keep(_black_world())
        try:
            scene.render.engine = "CYCLES"
        except TypeError:
            raise SceneError("Cycles is disabled: enable it in Preferences, Add-ons") from None
        settings = UNBIASED | {"samples": samples, "max_bounces": bounces, "volume_bounces": bounces}
        for name, value in settings.items():
            if hasattr(scene.cycles, name):
                setattr(scene.cycles, name, value)
        scene.render.film_transparent = True
        scene.render.use_compositing = scene.render.use_sequencer = False
        scene.render.image_settings.file_format = "OPEN_EXR"
        scene.render.image_settings.color_mode = "RGBA"
        scene.render.image_settings.color_depth = "32"
        yield scene, keep
    finally:
        # Without a window, as in commands, bpy.data.scenes.remove crashes Blender 4.3.
        bpy.data.batch_remove(kept)


def _black_world() -> "bpy.types.World":
    world = bpy.data.worlds.new("mrpnn black")
    world.color = (0.0, 0.0, 0.0)
    # From 5.0 on Worlds always have nodes, and setting this is deprecated.
    if world.node_tree is None:
        world.use_nodes = True
    for node in world.node_tree.nodes:
        if node.type == "BACKGROUND":
            strength: Any = node.inputs["Strength"]
            strength.default_value = 0.0
    return world


def _copy_view(source: "bpy.types.Scene", reference: "bpy.types.Scene", keep: Callable[[Any], Any]) -> None:
    """Copy frame, resolution, region, threads, exposure and camera of `source`."""
    for name in (
        "resolution_x",
        "resolution_y",
        "resolution_percentage",
        "pixel_aspect_x",
        "pixel_aspect_y",
        "use_border",
        "border_min_x",
        "border_min_y",
        "border_max_x",
        "border_max_y",
        "threads_mode",
        "threads",
    ):
        setattr(reference.render, name, getattr(source.render, name))
    reference.cycles.film_exposure = film_exposure(source)
    # The layer has the region's size.
    reference.render.use_crop_to_border = True
    reference.camera = keep(source.camera.copy())
    reference.collection.objects.link(reference.camera)
    reference.frame_set(source.frame_current, subframe=source.frame_subframe)


def _white_medium(density: float) -> "bpy.types.Material":
    """A material of albedo 1 and extinction `density` per unit of grid value."""
    material = bpy.data.materials.new("mrpnn check")
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader: Any = tree.nodes.new("ShaderNodeVolumePrincipled")
    shader.inputs["Density"].default_value = density
    shader.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(shader.outputs["Volume"], output.inputs["Volume"])
    return material


def _write_unit_box(path: Path, cells: int = 64) -> None:
    """A cube of density 1 and edge 1 around the origin."""
    openvdb = load_openvdb()
    grid = openvdb.FloatGrid()
    grid.copyFromArray(np.ones((cells,) * 3, np.float32))
    grid.name = "density"
    grid.gridClass = "fog volume"
    centred = np.eye(4)
    centred[:3, :3] /= cells
    # OpenVDB's matrices act on row vectors; the first voxel's centre is half a cell inside.
    centred[3, :3] = -0.5 + 0.5 / cells
    grid.transform = openvdb.createLinearTransform(centred.tolist())
    with utf8_link(str(path.parent)) as folder:
        openvdb.write(os.path.join(folder, path.name), grids=[grid])
