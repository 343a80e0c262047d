# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo's scene in Blender: one volume, one sun, a camera that frames it."""

import itertools
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from ..support.shaders import add_shader

EDGE = 2.0
MARGIN = 0.97
LENS_DEGREES = 32.0
VIEW_FROM = Vector((0.35, -1.0, 0.12))
SUN_FROM = Vector((-0.85, -0.2, 0.6))
# Seed of the generated cloud; no training uses it.
CLOUD_SEED = 1_000_011
CLOUD_CELLS = 192


def write_cloud(path: Path, openvdb) -> None:
    """Write the generator's cumulus as `write_grid` does."""
    from training.procedural.volumes import make_volume

    write_grid(path, make_volume(CLOUD_SEED, CLOUD_CELLS).density, openvdb)


def write_grid(path: Path, density: np.ndarray, openvdb) -> None:
    """Write a density (n, n, n) as a .vdb file with the grid "density", edge EDGE around the origin."""
    cells = len(density)
    grid = openvdb.FloatGrid()
    grid.copyFromArray(np.ascontiguousarray(density, np.float32))
    grid.name, grid.gridClass = "density", "fog volume"
    index_to_world = np.diag([EDGE / cells] * 3 + [1.0])
    index_to_world[3, :3] = EDGE * (0.5 / cells - 0.5)
    grid.transform = openvdb.createLinearTransform(index_to_world.tolist())
    openvdb.write(str(path), grids=[grid])


def make_scene(path: Path, size, grid_name: str, y_up: bool):
    """An otherwise empty scene with the volume file, lit by a sun; gives (scene, volume object, shader).

    size: (width, height) in pixels.
    """
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.view_settings.view_transform = "AgX"

    data = bpy.data.volumes.new(path.stem)
    data.filepath = str(path)
    volume = link(scene, path.stem, data)
    if y_up:
        volume.rotation_euler.x = np.pi / 2
    shader = _fog(data, grid_name)

    lamp = bpy.data.lights.new("Sun", "SUN")
    lamp.energy, lamp.color, lamp.angle = 14.0, (1.0, 0.95, 0.88), 0.0
    link(scene, "Sun", lamp).rotation_euler = SUN_FROM.to_track_quat("Z", "Y").to_euler()

    lens = bpy.data.cameras.new("Camera")
    lens.angle = np.radians(LENS_DEGREES)
    scene.camera = link(scene, "Camera", lens)
    return scene, volume, shader


def fit(scene, volume, shader, read_scene, optical_depth: float) -> None:
    """Scale the volume to edge EDGE around the origin, set its density, and frame it.

    read_scene: the extension's reader, so that the demo reads the file as the render does.
    optical_depth: of EDGE at the grid's densest (99.9th percentile of the voxels above 0).
    """
    grid, _ = read_scene(bpy.context.evaluated_depsgraph_get()).volumes[0]
    corners = corners_of(grid)
    extent = corners.max(axis=0) - corners.min(axis=0)
    scale = EDGE / extent.max()
    centre = Vector((corners.max(axis=0) + corners.min(axis=0)) / 2)
    volume.scale = (scale,) * 3
    volume.location = -scale * centre
    # The material's density is per world unit, whatever the object's scale.
    volume.data.render.space = "WORLD"
    values = getattr(grid.density, "values", grid.density)
    densest = np.percentile(values[values > 0], 99.9)
    shader.inputs["Density"].default_value = optical_depth / (EDGE * densest)
    frame(scene, (corners - np.array(centre)) * scale)


def frame(scene, corners) -> None:
    """Move the camera back along VIEW_FROM until every corner (8, 3) is in view."""
    camera = scene.camera
    rotation = VIEW_FROM.to_track_quat("Z", "Y")
    seen = corners @ np.array(rotation.to_matrix())
    half = np.tan(np.radians(LENS_DEGREES) / 2) * MARGIN
    width, height = scene.render.resolution_x, scene.render.resolution_y
    # The lens's angle spans the longer side.
    spans = np.array([width, height]) / max(width, height) * half
    distance = (np.abs(seen[:, :2]) / spans).max(axis=1) + seen[:, 2]
    camera.rotation_euler = rotation.to_euler()
    camera.location = VIEW_FROM.normalized() * float(distance.max())


def corners_of(grid) -> np.ndarray:
    """World corners (8, 3) of the box around a Volume's voxels."""
    ends = [(-0.5, n - 0.5) for n in grid.density.shape]
    index = np.array([(*corner, 1.0) for corner in itertools.product(*ends)])
    return (index @ grid.world_from_index.T)[:, :3]


def _fog(data, grid_name: str):
    shader = add_shader(data, "fog", "VolumePrincipled")
    shader.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    shader.inputs["Anisotropy"].default_value = 0.6
    shader.inputs["Density Attribute"].default_value = grid_name
    return shader


def link(scene, name, data):
    item = bpy.data.objects.new(name, data)
    scene.collection.objects.link(item)
    return item
