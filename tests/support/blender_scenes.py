# SPDX-License-Identifier: GPL-3.0-or-later
"""Small scenes made with bpy, and small volumes written with its OpenVDB."""

import itertools

import bpy
import numpy as np

_numbers = itertools.count()


def openvdb():
    """Blender's own OpenVDB module, found without the extension."""
    if hasattr(bpy.utils, "expose_bundled_modules"):  # 4.4 and later
        bpy.utils.expose_bundled_modules()
    try:
        import openvdb as module
    except ImportError:
        import pyopenvdb as module
    return module


def write_vdb(folder, density, transform=None, low=(0, 0, 0), name="density", background=0.0):
    """Write `density` as a fog volume under a new name (Blender caches files by path); gives the path.

    transform: (4, 4) acting on columns, index to object; the identity by default.
    low: index of the array's first voxel.
    """
    vdb = openvdb()
    grid = vdb.FloatGrid(background)
    grid.copyFromArray(np.array(density, dtype=np.float32), ijk=low)
    grid.name = name
    grid.gridClass = "fog volume"
    matrix = np.eye(4) if transform is None else np.asarray(transform, dtype=float)
    # OpenVDB's matrices act on rows.
    grid.transform = vdb.createLinearTransform(matrix.T.tolist())
    path = str(folder / f"volume{next(_numbers)}.vdb")
    vdb.write(path, grids=[grid])
    return path


def with_velocity(folder, path, values, transform, parts=False):
    """A copy of a file of `write_vdb` that also holds velocities (3, nx, ny, nz); gives its path.

    transform: as of `write_vdb`. parts: whether they are three grids of numbers instead of one of vectors.
    """
    vdb = openvdb()
    moved = np.moveaxis(values, 0, -1)
    grids = [vdb.FloatGrid() for _ in range(3)] if parts else [vdb.Vec3SGrid()]
    for axis, grid in enumerate(grids):
        grid.copyFromArray(np.ascontiguousarray(moved[..., axis] if parts else moved, np.float32))
        grid.name = "velocity" + (".x", ".y", ".z")[axis] if parts else "velocity"
        grid.transform = vdb.createLinearTransform(np.asarray(transform, dtype=float).T.tolist())
    copy = str(folder / f"volume{next(_numbers)}.vdb")
    vdb.write(copy, grids=[vdb.read(path, "density"), *grids])
    return copy


def blob(cells=16, seed=3):
    """A random smooth density that fades to 0 at its bounds, float32 (cells,) * 3."""
    axis = (np.arange(cells) + 0.5) / cells * 2.0 - 1.0
    radius = np.sqrt(axis[:, None, None] ** 2 + axis[None, :, None] ** 2 + axis[None, None, :] ** 2)
    noise = np.random.default_rng(seed).uniform(0.5, 1.0, (cells,) * 3)
    return (np.clip(1.0 - radius, 0.0, None) * noise).astype(np.float32)


def centred(cells, size):
    """Transform of `cells` voxels per axis that fill a cube of edge `size` around the origin."""
    matrix = np.eye(4)
    matrix[:3, :3] *= size / cells
    matrix[:3, 3] = (0.5 - cells / 2.0) * size / cells
    return matrix


def empty_scene():
    """Remove everything from the current file; a scene with a black World and 64 x 64 pixels."""
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    scene.render.resolution_x = scene.render.resolution_y = 64
    scene.render.resolution_percentage = 100
    return scene


def add_object(scene, name, data):
    """Link a new object to the scene."""
    added = bpy.data.objects.new(name, data)
    scene.collection.objects.link(added)
    return added


def add_volume(scene, path, name="Cloud", shader="ShaderNodeVolumePrincipled", **inputs):
    """A Volume object that loads `path`, with one volume shader; gives (object, shader node).

    inputs: values of the shader's sockets, spaces in their names as underscores.
    """
    data = bpy.data.volumes.new(name)
    data.filepath = str(path)
    added = add_object(scene, name, data)
    return added, add_fog(data, name, shader, **inputs)


def add_fog(data, name, shader, **inputs):
    """A material of one volume shader on a volume's or mesh's data; gives the shader node."""
    material = bpy.data.materials.new(f"{name} fog")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    node = tree.nodes.new(shader)
    for socket, value in inputs.items():
        node.inputs[socket.replace("_", " ")].default_value = value
    tree.links.new(node.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
    data.materials.append(material)
    return node


def add_sun(scene, name="Sun", strength=1.0, colour=(1.0, 1.0, 1.0), rotation=(0.6, 0.3, 0.2)):
    """A sun lamp."""
    lamp = bpy.data.lights.new(name, "SUN")
    lamp.energy, lamp.color = strength, colour
    added = add_object(scene, name, lamp)
    added.rotation_euler = rotation
    return added


def add_camera(scene, location=(0.0, 0.0, 6.0), rotation=(0.0, 0.0, 0.0), ortho_scale=None):
    """The active camera; orthographic where a scale is given."""
    lens = bpy.data.cameras.new("Camera")
    if ortho_scale:
        lens.type, lens.ortho_scale = "ORTHO", ortho_scale
    scene.camera = add_object(scene, "Camera", lens)
    scene.camera.location, scene.camera.rotation_euler = location, rotation
    return scene.camera


def cloud_scene(scene, folder, density=4.0):
    """A small cloud of edge 2 at the origin, one sun, a camera above; gives the Volume object."""
    cloud, _ = add_volume(
        scene, write_vdb(folder, blob(), centred(16, 2.0)), Density=density, Color=(0.9, 0.9, 0.9, 1.0), Anisotropy=0.5
    )
    add_sun(scene)
    add_camera(scene)
    return cloud


def depsgraph():
    """The evaluated scene."""
    return bpy.context.evaluated_depsgraph_get()


def render_cycles(scene, folder, samples=64, bounces=0):
    """Cycles' render of the scene's own view: float32 (H, W, 4), rows from the top.

    A thin-medium reference for shading tests: transparent film, no clamping, no denoising.
    """
    set_up_cycles(scene, samples, bounces)
    return rendered(scene, folder)


def set_up_cycles(scene, samples, bounces=0):
    """Unbiased Cycles settings: no clamping, no denoising, a one-pixel box filter."""
    scene.render.engine = "CYCLES"
    settings = scene.cycles
    settings.device, settings.samples = "CPU", samples
    settings.use_denoising = settings.use_adaptive_sampling = False
    settings.sample_clamp_indirect = 0.0
    settings.max_bounces, settings.volume_bounces = max(bounces, 1), bounces
    settings.pixel_filter_type = "BOX"
    settings.volume_step_rate = 0.2


def rendered(scene, folder, transparent=True):
    """The scene rendered by its engine: float32 (H, W, 4), rows from the top."""
    scene.render.film_transparent = transparent
    if hasattr(scene.render.image_settings, "media_type"):  # 5.0 and later
        scene.render.image_settings.media_type = "IMAGE"
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_depth = "32"
    scene.render.image_settings.color_mode = "RGBA"
    path = str(folder / f"cycles{next(_numbers)}.exr")
    scene.render.filepath = path
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(path)
    # As they are in the file: scene linear.
    image.colorspace_settings.is_data = True
    pixels = np.empty(image.size[0] * image.size[1] * 4, np.float32)
    image.pixels.foreach_get(pixels)
    return pixels.reshape(image.size[1], image.size[0], 4)[::-1]


def write_multilayer(scene):
    """Have the scene's renders written as multi-layer EXR, 32-bit."""
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):  # 5.0 and later
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"


def compositor(scene):
    """An empty compositor tree of the scene; gives it and the input socket of its result."""
    if bpy.app.version < (5, 0, 0):
        scene.use_nodes = True
        scene.node_tree.nodes.clear()
        return scene.node_tree, scene.node_tree.nodes.new("CompositorNodeComposite").inputs["Image"]
    tree = bpy.data.node_groups.new("Compositor", "CompositorNodeTree")
    tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    scene.compositing_node_group = tree
    return tree, tree.nodes.new("NodeGroupOutput").inputs["Image"]
