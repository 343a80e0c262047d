# SPDX-License-Identifier: GPL-3.0-or-later
"""What the gallery's scenes are made of in Blender: volumes, lights, a World, a camera, surfaces."""

from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

SIZE = 960, 540


def new_scene(engine: str = "MRPNN"):
    """A scene with an empty World and nothing else, in AgX. engine: CYCLES where baked light suits the scene."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.view_settings.view_transform = "AgX"
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.render.engine = engine
    scene.mrpnn.depth_samples = 8
    return scene


def add(name: str, data, location=(0.0, 0.0, 0.0)):
    """A new object in the scene."""
    added = bpy.data.objects.new(name, data)
    added.location = location
    bpy.context.scene.collection.objects.link(added)
    return added


def aim(item, target) -> None:
    """Turn a lamp or camera towards a point."""
    item.rotation_euler = (Vector(item.location) - Vector(target)).to_track_quat("Z", "Y").to_euler()


def camera(location, target, degrees: float = 40.0):
    """The scene's camera; degrees: across the picture's width."""
    lens = bpy.data.cameras.new("Camera")
    lens.angle = np.radians(degrees)
    bpy.context.scene.camera = add("Camera", lens, location)
    aim(bpy.context.scene.camera, target)
    return bpy.context.scene.camera


def sun(towards, strength: float, colour=(1.0, 1.0, 1.0), angle: float = 0.00918):
    """A sun; towards: vector from the scene to it."""
    lamp = bpy.data.lights.new("Sun", "SUN")
    lamp.energy, lamp.color, lamp.angle = strength, colour, angle
    added = add("Sun", lamp, towards)
    aim(added, (0.0, 0.0, 0.0))
    return added


def lamp(kind: str, location, power: float, colour=(1.0, 1.0, 1.0), **settings):
    """A POINT, SPOT or AREA lamp."""
    data = bpy.data.lights.new(kind.title(), kind)
    data.energy, data.color = power, colour
    for name, value in settings.items():
        setattr(data, name, value)
    return add(kind.title(), data, location)


def sky(*stops, strength: float = 1.0) -> None:
    """A World of colours by height; stops: (z of the direction from 0 to 1, linear colour (3,))."""
    tree = bpy.context.scene.world.node_tree
    place, split, colours = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "SeparateXYZ", "ValToRGB"))
    elements = colours.color_ramp.elements
    while len(elements) < len(stops):
        elements.new(0.5)
    for element, (z, colour) in zip(elements, stops):
        element.position, element.color = z, (*colour, 1.0)
    tree.links.new(place.outputs["Generated"], split.inputs[0])
    tree.links.new(split.outputs["Z"], colours.inputs[0])
    tree.links.new(colours.outputs[0], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = strength


def even_world(colour, strength: float = 1.0) -> None:
    """A World of one colour."""
    inputs = bpy.context.scene.world.node_tree.nodes["Background"].inputs
    inputs["Color"].default_value, inputs["Strength"].default_value = (*colour, 1.0), strength


def backdrop(colour, strength: float = 1.0) -> None:
    """A World of one colour that the camera sees and that lights nothing."""
    even_world(colour, strength)
    tree = bpy.context.scene.world.node_tree
    rays, factor = tree.nodes.new("ShaderNodeLightPath"), tree.nodes.new("ShaderNodeMath")
    factor.operation, factor.inputs[1].default_value = "MULTIPLY", strength
    tree.links.new(rays.outputs["Is Camera Ray"], factor.inputs[0])
    tree.links.new(factor.outputs[0], tree.nodes["Background"].inputs["Strength"])


def material(data, kind: str, socket: str = "Surface", **inputs):
    """A material of one shader; inputs: of its sockets, spaces as underscores. Gives the shader's node."""
    made = bpy.data.materials.new(data.name)
    made.use_nodes = True
    tree = made.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new(f"ShaderNode{kind}")
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs[socket])
    for name, value in inputs.items():
        value = (*value, 1.0) if isinstance(value, tuple) and len(value) == 3 else value
        shader.inputs[name.replace("_", " ")].default_value = value
    data.materials.append(made)
    return shader


def write_grids(path: Path, grids: dict[str, np.ndarray], low, voxel: float) -> None:
    """Grids float32 (nx, ny, nz) as one .vdb file of half floats; low: lower corner of the first voxel."""
    from mrpnn.mrpnn_addon.vdb.openvdb_module import load_openvdb

    vdb, written = load_openvdb(), []
    for name, values in grids.items():
        grid = vdb.FloatGrid()
        grid.copyFromArray(np.where(values > 1e-3, values, 0.0).astype(np.float32))
        grid.name, grid.gridClass, grid.saveFloatAsHalf = name, "fog volume", True
        matrix = np.diag([voxel] * 3 + [1.0])
        matrix[3, :3] = np.asarray(low) + 0.5 * voxel
        grid.transform = vdb.createLinearTransform(matrix.tolist())
        grid.prune()
        written.append(grid)
    path.parent.mkdir(parents=True, exist_ok=True)
    vdb.write(str(path), grids=written)


def volume(path: Path, location=(0.0, 0.0, 0.0), **inputs):
    """A Volume object of a file, with a Principled Volume. Gives object and shader."""
    data = bpy.data.volumes.new(path.stem.title())
    data.filepath = str(path)
    return add(path.stem.title(), data, location), material(data, "VolumePrincipled", "Volume", **inputs)


def mesh(name: str, vertices, faces, location=(0.0, 0.0, 0.0)):
    """A mesh object."""
    data = bpy.data.meshes.new(name)
    data.from_pydata([tuple(map(float, vertex)) for vertex in vertices], [], [tuple(face) for face in faces])
    return add(name, data, location)


def box(name: str, low, high):
    """A closed box between two corners."""
    corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    faces = ((0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3))
    return mesh(name, corners, faces)


def pillar(name: str, foot, radius: float, height: float, sides: int = 16):
    """A round pillar that stands on a point."""
    turns = 2 * np.pi * np.arange(sides) / sides
    rings = [[(radius * np.cos(a), radius * np.sin(a), z) for a in turns] for z in (0.0, height)]
    around = [(i, (i + 1) % sides, sides + (i + 1) % sides, sides + i) for i in range(sides)]
    caps = [range(sides)[::-1], range(sides, 2 * sides)]
    made = mesh(name, rings[0] + rings[1], [*around, *caps], foot)
    made.data.polygons.foreach_set("use_smooth", [True] * sides + [False] * 2)
    return made


def ball(name: str, middle, half, rings: int = 12):
    """An ellipsoid; half: its half axes (3,)."""
    around = 2 * rings
    heights, turns = np.pi * np.arange(1, rings) / rings, 2 * np.pi * np.arange(around) / around
    points = [(np.sin(h) * np.cos(t), np.sin(h) * np.sin(t), np.cos(h)) for h in heights for t in turns]
    last = len(points) - around
    faces = [
        (row + i, row + around + i, row + around + (i + 1) % around, row + (i + 1) % around)
        for row in range(0, last, around)
        for i in range(around)
    ]
    faces += [range(around), range(last + around - 1, last - 1, -1)]
    made = mesh(name, np.array(points) * np.asarray(half), faces, middle)
    made.data.polygons.foreach_set("use_smooth", [True] * len(faces))
    return made


def plane(name: str, half: float, z: float = 0.0):
    """A square on the ground."""
    return mesh(name, [(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)], [range(4)])


def ripples(shader, scale: float, height: float) -> None:
    """Bumps of noise on a surface's shader."""
    tree = shader.id_data
    place, waves, bump = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "TexNoise", "Bump"))
    waves.inputs["Scale"].default_value, waves.inputs["Detail"].default_value = scale, 4.0
    bump.inputs["Strength"].default_value, bump.inputs["Distance"].default_value = 0.4, height
    tree.links.new(place.outputs["Object"], waves.inputs["Vector"])
    tree.links.new(waves.outputs[0], bump.inputs["Height"])
    tree.links.new(bump.outputs[0], shader.inputs["Normal"])


def stars() -> None:
    """A World of small stars on black."""
    tree = bpy.context.scene.world.node_tree
    place, cells, ramp = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "TexVoronoi", "MapRange"))
    cells.inputs["Scale"].default_value = 70.0
    for name, value in (("From Min", 0.0), ("From Max", 0.07), ("To Min", 1.2), ("To Max", 0.0)):
        ramp.inputs[name].default_value = value
    tree.links.new(place.outputs["Generated"], cells.inputs["Vector"])
    tree.links.new(cells.outputs["Distance"], ramp.inputs["Value"])
    tree.links.new(ramp.outputs[0], tree.nodes["Background"].inputs["Strength"])
    tree.links.new(cells.outputs["Color"], tree.nodes["Background"].inputs["Color"])
