"""Runs in a Blender process of its own, without the extension: what a World looks like from its middle, by Cycles.

Arguments, the last four: a .blend file that holds the World; a frame and its fraction; and the .npz file that answers,
with `sky`, float32 (ROWS, 2 ROWS, 3), an equirectangular picture with rows from the bottom and without sun discs, and
`suns`, float64 (n, 7), of each disc direction, irradiance and angle across in radians.
"""

import math
import os
import sys

import bpy
import numpy as np
from mathutils import Vector

ROWS, SAMPLES = 128, 16
# A disc is looked for at no smaller size, in radians, and then seen at its own through a lens so many times as wide.
LOCATED, AROUND = math.radians(3.0), 4.0
DISC_PIXELS, DISC_SAMPLES = 96, 32
LUMA = np.array([0.2126, 0.7152, 0.0722])
# Kinds of sky that have no disc.
WITHOUT_DISC = {'PREETHAM', 'HOSEK_WILKIE'}


def main(blend, frame, fraction, target):
    with bpy.data.libraries.load(blend) as (found, wanted):
        wanted.worlds = found.worlds[:1]
    scene = bpy.data.scenes.new("World")
    bpy.context.window.scene = scene
    scene.world = wanted.worlds[0]
    trees = [scene.world.node_tree, *bpy.data.node_groups]
    discs = [node for tree in trees for node in tree.nodes if node.bl_idname == 'ShaderNodeTexSky'
             and node.sky_type not in WITHOUT_DISC and node.sun_disc]
    for tree in trees:
        _as_volumes_see(tree)
    _set_up(scene)
    scene.frame_set(int(frame), subframe=float(fraction))
    for node in discs:
        node.sun_disc = False
    sky = _rendered(scene, _panorama(scene), 2 * ROWS, ROWS, SAMPLES, target)
    suns = [sun for node in discs for sun in _disc(scene, node, sky, target)]
    with open(target + ".part", "wb") as file:
        np.savez(file, sky=sky, suns=np.array(suns).reshape(-1, 7))
    os.replace(target + ".part", target)


def _as_volumes_see(tree):
    """Take out the World's fog, and what light paths tell apart: light here is what volumes scatter."""
    for link in list(tree.links):
        node, socket = link.from_node, link.to_socket
        if link.to_node.bl_idname == 'ShaderNodeOutputWorld' and socket.identifier == 'Volume':
            tree.links.remove(link)
        elif node.bl_idname == 'ShaderNodeLightPath' and hasattr(socket, 'default_value'):
            value = float(link.from_socket.identifier == 'Is Volume Scatter Ray')
            tree.links.remove(link)
            try:
                socket.default_value = value
            except (TypeError, ValueError):
                socket.default_value = [value] * len(socket.default_value)


def _set_up(scene):
    scene.render.engine = 'CYCLES'
    scene.render.film_transparent = False
    scene.render.use_compositing = scene.render.use_sequencer = False
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = 'OPEN_EXR', '32'
    scene.render.image_settings.color_mode = 'RGB'
    scene.render.resolution_percentage = 100
    settings = {"device": 'CPU', "use_adaptive_sampling": False, "use_denoising": False, "film_exposure": 1.0, "seed": 0,
                "sample_clamp_direct": 0.0, "sample_clamp_indirect": 0.0, "pixel_filter_type": 'BOX'}
    for name, value in settings.items():
        setattr(scene.cycles, name, value)
    scene.world.cycles_visibility.camera = True


def _panorama(scene):
    """A camera whose picture has +X in its middle and +Z above."""
    camera = _camera(scene)
    camera.rotation_euler = math.pi / 2.0, 0.0, -math.pi / 2.0
    camera.data.type = 'PANO'
    # The property moved in 5.0.
    lens = camera.data if hasattr(camera.data, 'panorama_type') else camera.data.cycles
    lens.panorama_type = 'EQUIRECTANGULAR'
    return camera


def _camera(scene):
    camera = bpy.data.objects.new("World", bpy.data.cameras.new("World"))
    scene.collection.objects.link(camera)
    return camera


def _rendered(scene, camera, width, height, samples, target):
    """Radiance (height, width, 3), rows from the bottom."""
    scene.camera, scene.cycles.samples = camera, samples
    scene.render.resolution_x, scene.render.resolution_y = width, height
    scene.render.filepath = target + ".exr"
    bpy.ops.render.render(scene=scene.name, write_still=True)
    image = bpy.data.images.load(scene.render.filepath)
    image.colorspace_settings.is_data = True
    pixels = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(pixels)
    pixels = pixels.reshape(height, width, image.channels)[..., :3].copy()
    bpy.data.images.remove(image)
    os.unlink(scene.render.filepath)
    return np.nan_to_num(pixels)


def _disc(scene, node, sky, target):
    """The disc of one Sky Texture: direction, irradiance and angle; none where it does not show."""
    size = node.sun_size
    node.sun_disc, node.sun_size = True, max(size, LOCATED)
    found = _rendered(scene, _panorama(scene), 2 * ROWS, ROWS, SAMPLES, target) - sky
    latitude = (np.arange(ROWS) + 0.5) / ROWS * math.pi - math.pi / 2.0
    longitude = (0.5 - (np.arange(2 * ROWS) + 0.5) / (2 * ROWS)) * 2.0 * math.pi
    directions = _directions(np.cos(latitude)[:, None] * np.cos(longitude), np.cos(latitude)[:, None] * np.sin(longitude),
                             np.sin(latitude)[:, None] * np.ones(2 * ROWS))
    light = np.maximum(found, 0.0) @ LUMA * np.cos(latitude)[:, None]
    if not light.max() > 0.0:
        node.sun_disc = False
        return []
    middle = np.einsum("ij,ijk->k", np.where(light > 0.2 * light.max(), light, 0.0), directions)
    node.sun_size = size
    camera = _camera(scene)
    camera.rotation_euler = Vector(-middle).to_track_quat('Z', 'Y').to_euler()
    extent = min(max(AROUND * size, AROUND * LOCATED / 2.0), 2.0)
    camera.data.angle = extent
    scene.view_layers[0].update()
    bright = _rendered(scene, camera, DISC_PIXELS, DISC_PIXELS, DISC_SAMPLES, target)
    node.sun_disc = False
    light = bright - _rendered(scene, camera, DISC_PIXELS, DISC_PIXELS, DISC_SAMPLES, target)
    place = ((np.arange(DISC_PIXELS) + 0.5) / DISC_PIXELS - 0.5) * 2.0 * math.tan(extent / 2.0)
    x, y = np.meshgrid(place, place)
    light *= ((place[1] - place[0]) ** 2 / (1.0 + x * x + y * y) ** 1.5)[..., None]
    irradiance, power = light.sum(axis=(0, 1)), light @ LUMA
    if not power.sum() > 0.0:
        return []
    seen = _directions(x, y, -np.ones_like(x)) @ np.array(camera.matrix_world.to_3x3()).T
    middle = np.einsum("ij,ijk->k", power, seen)
    middle /= np.linalg.norm(middle)
    # The mean square distance from the middle of a disc is half its radius squared.
    spread = (power * (1.0 - (seen @ middle) ** 2)).sum() / power.sum()
    return [[*middle, *np.maximum(irradiance, 0.0), 2.0 * math.asin(min(math.sqrt(2.0 * max(spread, 0.0)), 1.0))]]


def _directions(x, y, z):
    directions = np.stack([x, y, z], axis=-1)
    return directions / np.linalg.norm(directions, axis=-1, keepdims=True)


if __name__ == "__main__":
    main(*sys.argv[-4:])
