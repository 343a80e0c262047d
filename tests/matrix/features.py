# SPDX-License-Identifier: GPL-3.0-or-later
"""Dimensions of scenes and their values: each value builds into a scene, in Blender 4.2 to 5.2.

A later feature is a function here and its entry in a dimension. Everything stands within two units of the origin.
"""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np
from mathutils import Vector

from tests.support import blender_scenes

from .covering import Row

SIZE = 16, 12


@dataclass
class Stage:
    """A scene in the making. volumes, lamps, surfaces: objects of each kind. frame: at which it is rendered."""

    scene: "bpy.types.Scene"
    folder: Path
    row: Row
    volumes: list["bpy.types.Object"] = field(default_factory=list)
    lamps: list["bpy.types.Object"] = field(default_factory=list)
    surfaces: list["bpy.types.Object"] = field(default_factory=list)
    frame: int = 1

    def add(self, name: str, data: "bpy.types.ID | None") -> "bpy.types.Object":
        return blender_scenes.add_object(self.scene, name, data)

    def add_volume(self, name: str, data: "bpy.types.ID") -> "bpy.types.Object":
        data.materials.append(fog(self.row["medium"]))
        self.volumes.append(self.add(name, data))
        return self.volumes[-1]


# Media: what the volumes are made of.

MEDIA: dict[str, dict[str, object]] = {
    "grey": dict(Density=3.0, Color=(0.8, 0.8, 0.8, 1.0), Anisotropy=0.4),
    "coloured": dict(Density=3.0, Color=(0.9, 0.6, 0.3, 1.0)),
    "emission": dict(Density=2.0, Emission_Strength=0.5, Emission_Color=(1.0, 0.6, 0.2, 1.0)),
}


def fog(medium: str) -> "bpy.types.Material":
    material = bpy.data.materials.new(medium)
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeVolumePrincipled")
    for name, value in MEDIA[medium].items():
        shader.inputs[name.replace("_", " ")].default_value = value
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
    return material


# Volumes.


def cloud_path(stage: Stage) -> str:
    return blender_scenes.write_vdb(stage.folder, blender_scenes.blob(12), blender_scenes.centred(12, 2.0))


def from_file(stage: Stage) -> None:
    data = bpy.data.volumes.new("Cloud")
    data.filepath = cloud_path(stage)
    stage.add_volume("Cloud", data)


def sequence_with_a_gap(stage: Stage) -> None:
    """Its first file is there, its second is not."""
    from_file(stage)
    data = stage.volumes[-1].data
    path = data.filepath.replace(".vdb", "_0001.vdb")
    shutil.move(data.filepath, path)
    shutil.copy(path, path.replace("_0001", "_0003"))
    data.filepath, data.is_sequence, data.frame_duration = path, True, 3


def fluid_domain(stage: Stage) -> None:
    """Smoke after three frames."""
    mesh = bpy.data.meshes.new("Domain")
    mesh.from_pydata(*box(1.0))
    domain = stage.add_volume("Domain", mesh)
    modifier = domain.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "DOMAIN"
    settings = modifier.domain_settings
    settings.domain_type, settings.resolution_max = "GAS", 12
    settings.cache_type, settings.cache_directory = "REPLAY", tempfile.mkdtemp(dir=stage.folder)
    settings.cache_frame_start, settings.cache_frame_end = 1, 8
    mesh = bpy.data.meshes.new("Source")
    mesh.from_pydata(*box(0.5))
    source = stage.add("Source", mesh)
    # A viewport would show it inside the smoke.
    source.hide_render = True
    source.hide_set(True)
    modifier = source.modifiers.new("Fluid", "FLUID")
    modifier.fluid_type = "FLOW"
    modifier.flow_settings.flow_type, modifier.flow_settings.flow_behavior = "SMOKE", "INFLOW"
    stage.frame = 3
    for frame in (1, 2, 3):
        stage.scene.frame_set(frame)


def mesh(stage: Stage) -> None:
    data = bpy.data.meshes.new("Box")
    data.from_pydata(*box(0.8))
    stage.add_volume("Box", data).rotation_euler = 0.3, 0.0, 0.5


def text(stage: Stage) -> None:
    data = bpy.data.curves.new("Text", "FONT")
    data.body, data.size, data.extrude, data.align_x, data.align_y = "O", 2.5, 0.4, "CENTER", "CENTER"
    stage.add_volume("Text", data).rotation_euler = 1.3, 0.0, 0.0


def metaball(stage: Stage) -> None:
    data = bpy.data.metaballs.new("Ball")
    data.resolution = data.render_resolution = 0.3
    for x in (-0.4, 0.5):
        element = data.elements.new()
        element.co, element.radius = (x, 0.0, 0.0), 1.2
    stage.add_volume("Ball", data)


def geometry_nodes(stage: Stage) -> None:
    tree = bpy.data.node_groups.new("Fog", "GeometryNodeTree")
    tree.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    tree.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    cube, material = tree.nodes.new("GeometryNodeVolumeCube"), tree.nodes.new("GeometryNodeSetMaterial")
    for name in ("Resolution X", "Resolution Y", "Resolution Z"):
        cube.inputs[name].default_value = 10
    data = bpy.data.meshes.new("Host")
    host = stage.add_volume("Host", data)
    material.inputs["Material"].default_value = data.materials[0]
    tree.links.new(cube.outputs["Volume"], material.inputs["Geometry"])
    tree.links.new(material.outputs["Geometry"], tree.nodes.new("NodeGroupOutput").inputs[0])
    host.modifiers.new("Nodes", "NODES").node_group = tree


def instanced(stage: Stage) -> None:
    """By a collection that the scene shows, too: metaballs outside the scene have no surface."""
    group = bpy.data.collections.new("Group")
    stage.scene.collection.children.link(group)
    for volume in stage.volumes:
        stage.scene.collection.objects.unlink(volume)
        group.objects.link(volume)
        volume.location, volume.scale = (0.9, 0.3, 0.0), (0.6, 0.6, 0.6)
    empty = stage.add("Instance", None)
    empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", group, (-1.8, -0.6, 0.0)
    stage.volumes.append(empty)


def box(half: float) -> tuple[list, list, list]:
    corners = [(x, y, z) for x in (-half, half) for y in (-half, half) for z in (-half, half)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, [], faces


# Lamps.


def lamp(stage: Stage, kind: str, energy: float, **values: object) -> "bpy.types.Object":
    data = bpy.data.lights.new(kind.title(), kind)
    data.energy = energy
    for name, value in values.items():
        setattr(data, name, value)
    added = stage.add(kind.title(), data)
    added.location = 2.0, -2.5, 2.2
    added.rotation_euler = (-added.location).to_track_quat("-Z", "Y").to_euler()
    stage.lamps.append(added)
    return added


def area(stage: Stage) -> "bpy.types.Object":
    return lamp(stage, "AREA", 150.0, shape=stage.row["area shape"].upper(), size=0.8, size_y=0.5)


def nodes_of_lamps(stage: Stage) -> None:
    for light in stage.lamps:
        light.data.use_nodes = True
        tree = light.data.node_tree
        colour = tree.nodes.new("ShaderNodeBlackbody")
        colour.inputs["Temperature"].default_value = 4000.0
        tree.links.new(colour.outputs["Color"], tree.nodes["Emission"].inputs["Color"])
        tree.nodes["Emission"].inputs["Strength"].default_value = 2.0


def several_lamps(stage: Stage) -> None:
    lamp(stage, "SUN", 1.0)
    lamp(stage, "POINT", 100.0, color=(1.0, 0.4, 0.2)).location = -2.0, -1.0, 1.5
    area(stage).location = 0.3, 0.2, 2.5


# Worlds.


def world(stage: Stage, strength: float) -> tuple["bpy.types.NodeTree", "bpy.types.Node"]:
    tree = stage.scene.world.node_tree
    background = tree.nodes["Background"]
    background.inputs["Strength"].default_value = strength
    return tree, background


def even_world(stage: Stage) -> None:
    world(stage, 0.5)[1].inputs["Color"].default_value = 0.4, 0.6, 1.0, 1.0


def image_world(stage: Stage) -> None:
    tree, background = world(stage, 0.6)
    # One picture for all rows, as of one file: Cycles renders it once.
    path = Path(tempfile.gettempdir()) / f"matrix-world-{bpy.app.version_string[:3]}.exr"
    image = bpy.data.images.new("Surroundings", 16, 8, float_buffer=True)
    values = np.ones((8, 16, 4), np.float32)
    values[..., 0], values[..., 1] = np.linspace(0.0, 2.0, 16), np.linspace(0.2, 1.0, 8)[:, None]
    image.pixels.foreach_set(values.ravel())
    image.filepath_raw, image.file_format = str(path), "OPEN_EXR"
    image.save()
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = bpy.data.images.load(str(path))
    tree.links.new(node.outputs["Color"], background.inputs["Color"])


def sky_world(model: str) -> Callable[[Stage], None]:
    def build(stage: Stage) -> None:
        tree, background = world(stage, 0.1)
        node = tree.nodes.new("ShaderNodeTexSky")
        node.sky_type = model if model in SKIES else "NISHITA"
        tree.links.new(node.outputs["Color"], background.inputs["Color"])

    return build


SKIES = [item.identifier for item in bpy.types.ShaderNodeTexSky.bl_rna.properties["sky_type"].enum_items]
# Rows are the same in every version: before Blender 5 one sky stands for both kinds of scattering.
MODELS = "PREETHAM", "HOSEK_WILKIE", "SINGLE_SCATTERING", "MULTIPLE_SCATTERING"


# Surfaces.


def floor(stage: Stage, shader: str, **values: object) -> "bpy.types.Object":
    data = bpy.data.meshes.new("Floor")
    data.from_pydata([(-6, -6, -0.6), (6, -6, -0.6), (6, 6, -0.6), (-6, 6, -0.6)], [], [(0, 1, 2, 3)])
    data.materials.append(surface_material(shader, **values))
    stage.surfaces.append(stage.add("Floor", data))
    return stage.surfaces[-1]


def surface_material(shader: str, **values: object) -> "bpy.types.Material":
    material = bpy.data.materials.new(shader)
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    node = tree.nodes.new(shader)
    for name, value in values.items():
        node.inputs[name].default_value = value
    tree.links.new(node.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    return material


def glowing(stage: Stage) -> None:
    data = bpy.data.meshes.new("Glow")
    data.from_pydata([(-1.8, -1, 0.2), (-1.8, 1, 0.2), (-1.2, 1, 1.4), (-1.2, -1, 1.4)], [], [(0, 1, 2, 3)])
    data.materials.append(surface_material("ShaderNodeEmission", Strength=4.0, Color=(1.0, 0.5, 0.3, 1.0)))
    stage.surfaces.append(stage.add("Glow", data))


# Cameras.


def camera(stage: Stage, **values: object) -> "bpy.types.Object":
    lens = bpy.data.cameras.new("Camera")
    lens.angle, lens.clip_start = 0.6, 1e-3
    for name, value in values.items():
        setattr(lens, name, value)
    added = stage.scene.camera = stage.add("Camera", lens)
    added.location = 0.6, -4.5, 1.2
    added.rotation_euler = (Vector((0.0, 0.0, 0.0)) - added.location).to_track_quat("-Z", "Y").to_euler()
    return added


def lens(stage: Stage) -> None:
    """Depth of field, focused on an object in front of the volumes."""
    dof = camera(stage).data.dof
    dof.use_dof, dof.aperture_fstop, dof.aperture_blades = True, 0.5, 5
    dof.focus_object = stage.add("Focus", None)
    dof.focus_object.location = 0.3, -2.0, 0.5


def moving(stage: Stage) -> None:
    """Motion blur of a camera that passes by while it turns, of a volume that rises, and of velocities in a file."""
    render, passing = stage.scene.render, camera(stage)
    render.use_motion_blur, render.motion_blur_shutter = True, 1.0
    (x, *_), (*_, turn) = passing.location, passing.rotation_euler
    for step in (-1, 1):
        passing.location.x, passing.rotation_euler.z = x + 0.5 * step, turn + 0.1 * step
        for path in ("location", "rotation_euler"):
            passing.keyframe_insert(path, frame=stage.frame + step)
    rising = stage.volumes[0]
    data = rising.data
    if rising.type == "VOLUME" and data.filepath and not data.is_sequence:
        whirl = np.random.default_rng(6).normal(0.0, 0.1, (3, 6, 6, 6))
        frame = blender_scenes.centred(6, 2.0)
        data.filepath = blender_scenes.with_velocity(stage.folder, data.filepath, whirl, frame)
    # A domain that moves simulates anew.
    if all(modifier.type != "FLUID" for modifier in rising.modifiers):
        z = rising.location.z
        for step in (-1, 1):
            rising.location.z = z + 0.2 * step
            rising.keyframe_insert("location", frame=stage.frame + step)


def panorama(stage: Stage) -> None:
    lens = camera(stage, type="PANO").data
    settings = lens if hasattr(lens, "panorama_type") else lens.cycles
    settings.panorama_type = "EQUIRECTANGULAR"
    stage.scene.camera.location = 0.3, -1.9, 0.4


def shift(stage: Stage) -> None:
    """Shifted sideways and down, of pixels that are wider than tall."""
    camera(stage, shift_x=0.15, shift_y=-0.1)
    stage.scene.render.pixel_aspect_x = 1.6


def inside(stage: Stage) -> None:
    """In the first volume, wherever that stands."""
    camera(stage).location = stage.volumes[0].location + Vector((0.05, -0.25, 0.05))


def stereo(stage: Stage) -> None:
    lens = camera(stage).data
    lens.stereo.convergence_mode, lens.stereo.interocular_distance = "PARALLEL", 0.4
    stage.scene.render.use_multiview = True
    stage.scene.render.image_settings.views_format = "INDIVIDUAL"


def border(stage: Stage) -> None:
    camera(stage)
    render = stage.scene.render
    render.use_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.75, 0.25, 1.0


# Film, units, view layers, light groups and linking.


def film(transparent: bool, exposure: float) -> Callable[[Stage], None]:
    def build(stage: Stage) -> None:
        stage.scene.render.film_transparent = transparent
        stage.scene.cycles.film_exposure = exposure

    return build


def unit_scale(length: float) -> Callable[[Stage], None]:
    def build(stage: Stage) -> None:
        stage.scene.unit_settings.scale_length = length

    return build


def second_view_layer(stage: Stage) -> None:
    """It leaves out the volumes."""
    collection = bpy.data.collections.new("Volumes")
    stage.scene.collection.children.link(collection)
    for volume in stage.volumes:
        (parent,) = volume.users_collection
        parent.objects.unlink(volume)
        collection.objects.link(volume)
    stage.scene.view_layers.new("Second").layer_collection.children["Volumes"].exclude = True


def light_groups(stage: Stage) -> None:
    """Lamps are in one group, all that shines besides them in the other."""
    layer = stage.scene.view_layers[0]
    for name in ("lamps", "rest"):
        layer.lightgroups.add(name=name)
    for light in stage.lamps:
        light.lightgroup = "lamps"
    for shining in [*stage.volumes, *stage.surfaces, stage.scene.world]:
        shining.lightgroup = "rest"


def light_linking(stage: Stage) -> None:
    """The lamps light the volumes alone, and another lamp the surfaces alone."""
    receivers, others = bpy.data.collections.new("Receivers"), bpy.data.collections.new("Others")
    for receiver in stage.volumes:
        receivers.objects.link(receiver)
    for light in stage.lamps:
        light.light_linking.receiver_collection = receivers
    for receiver in stage.surfaces:
        others.objects.link(receiver)
    stray = lamp(stage, "POINT", 300.0)
    stage.lamps.remove(stray)
    stray.light_linking.receiver_collection = others


def nothing(stage: Stage) -> None:
    pass


Build = Callable[[Stage], object]
# The simulations of the bpy module and of Debian's 4.3 are broken: one makes no smoke, the other ends the process.
SIMULATES = bool(bpy.app.binary_path) and bpy.app.version >= (5, 0, 0)
# In the order in which a scene is built. The first values are the cheapest: rows take them where any would do.
DIMENSIONS: dict[str, dict[str, Build]] = {
    "volume": {
        "file": from_file,
        "mesh": mesh,
        "text": text,
        "metaball": metaball,
        "geometry nodes": geometry_nodes,
        "sequence with a gap": sequence_with_a_gap,
        **({"fluid domain": fluid_domain} if SIMULATES else {}),
    },
    "placement": {"alone": nothing, "instanced": instanced, "overlapping": mesh},
    "medium": dict.fromkeys(MEDIA, nothing),
    "lamp": {
        "sun": lambda stage: lamp(stage, "SUN", 2.0, angle=0.0),
        "none": nothing,
        "soft sun": lambda stage: lamp(stage, "SUN", 2.0, angle=0.2),
        "point": lambda stage: lamp(stage, "POINT", 300.0, shadow_soft_size=0.2),
        "spot": lambda stage: lamp(stage, "SPOT", 300.0, spot_size=0.9),
        "area": area,
        "several": several_lamps,
    },
    "area shape": dict.fromkeys(("square", "rectangle", "disk", "ellipse"), nothing),
    "lamp nodes": {"none": nothing, "blackbody": nodes_of_lamps},
    "world": {
        "black": nothing,
        "even": even_world,
        "image": image_world,
        **{f"sky {model.lower()}": sky_world(model) for model in MODELS},
    },
    "surface": {
        "none": nothing,
        "opaque": lambda stage: floor(stage, "ShaderNodeBsdfDiffuse"),
        "transparent": lambda stage: floor(stage, "ShaderNodeBsdfTransparent", Color=(0.5, 0.8, 0.8, 1.0)),
        "glowing": glowing,
    },
    "camera": {
        "perspective": camera,
        "orthographic": lambda stage: camera(stage, type="ORTHO", ortho_scale=3.0),
        "panorama": panorama,
        "inside": inside,
        "stereo": stereo,
        "border": border,
        "shift": shift,
        "lens": lens,
        "moving": moving,
    },
    "film": {
        "opaque": film(False, 1.0),
        "transparent": film(True, 1.0),
        "exposed": film(False, 2.0),
        "transparent exposed": film(True, 2.0),
    },
    "units": {"metres": unit_scale(1.0), "centimetres": unit_scale(0.01)},
    "view layers": {"one": nothing, "two": second_view_layer},
    "groups": {"none": nothing, "light groups": light_groups, "light linking": light_linking},
}


def is_dark(row: Row) -> bool:
    """Whether nothing shines in a row's scene, which is refused."""
    unlit = row["lamp"] == "none" and row["world"] == "black"
    return unlit and row["surface"] != "glowing" and row["medium"] != "emission"


def build(row: Row, folder: Path) -> Stage:
    """The scene of a row, in an otherwise empty file; its files are in `folder`."""
    scene = blender_scenes.empty_scene()
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.render.engine = "MRPNN"
    scene.mrpnn.depth_samples = 2
    stage = Stage(scene, folder, row)
    for name, values in DIMENSIONS.items():
        values[row[name]](stage)
    scene.frame_set(stage.frame)
    scene.frame_start, scene.frame_end = stage.frame, stage.frame + 1
    return stage
