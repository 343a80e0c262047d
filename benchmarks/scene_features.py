"""Small scenes, one a feature, for `benchmarks.scenes`.

A builder takes a `Stage` and changes it. MEASURED are compared with Cycles; NAMED must give a message.
"""

import math
from dataclasses import dataclass, field
from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix, Vector

SEED = 1_000_003
CELLS = 64
# Of the cloud, edge 2, at its densest.
DENSITY = 12.0


@dataclass
class Stage:
    """The scene that every feature starts from: a cloud of edge 2 around the origin, a sun, a camera.

    scene, cloud, shader, sun, camera: bpy blocks. folder: for files. step_rate: for Cycles' reference.
    surfaces: objects that it holds out.
    """

    scene: object
    cloud: object
    shader: object
    sun: object
    camera: object
    folder: Path
    step_rate: float = 1.0
    surfaces: list = field(default_factory=list)

    def link(self, name, data):
        added = bpy.data.objects.new(name, data)
        self.scene.collection.objects.link(added)
        return added

    def hide_cloud(self):
        bpy.data.objects.remove(self.cloud)

    def node(self, kind, **settings):
        added = self.shader.id_data.nodes.new(f"ShaderNode{kind}")
        for name, value in settings.items():
            setattr(added, name, value)
        return added

    def connect(self, output, socket):
        self.shader.id_data.links.new(output, socket)

    def grid(self):
        return self.node("VolumeInfo").outputs["Density"]

    def replace_shader(self, shader):
        self.connect(shader.outputs[0], self.shader.id_data.get_output_node('CYCLES').inputs["Volume"])


def make_stage(folder: Path, cloud_file: Path, size: int) -> Stage:
    """A fresh file with the cloud of `cloud_file`, `size` pixels square, on a black World."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("World")
    scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.0
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.view_settings.view_transform = 'AgX'
    data = bpy.data.volumes.new("Cloud")
    data.filepath = str(cloud_file)
    data.render.space = 'WORLD'
    shader = fog(data, "Cloud")
    cloud = bpy.data.objects.new("Cloud", data)
    lamp = bpy.data.lights.new("Sun", 'SUN')
    lamp.energy, lamp.angle = 8.0, 0.0
    sun = bpy.data.objects.new("Sun", lamp)
    sun.rotation_euler = Vector((-0.8, -0.3, 0.6)).to_track_quat('Z', 'Y').to_euler()
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.angle = math.radians(34.0)
    for item in (cloud, sun, camera):
        scene.collection.objects.link(item)
    scene.camera = camera
    aim(camera, Vector((1.6, -4.2, 1.0)))
    return Stage(scene, cloud, shader, sun, camera, folder)


def aim(camera, location, at=Vector((0.0, 0.0, 0.0))):
    """Put a camera somewhere, looking at a point."""
    camera.location = location
    camera.rotation_euler = (location - at).to_track_quat('Z', 'Y').to_euler()


def fog(data, name, density=DENSITY):
    """Principled Volume on new data; gives the node."""
    material = bpy.data.materials.new(f"{name} fog")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    shader = tree.nodes.new("ShaderNodeVolumePrincipled")
    shader.inputs["Density"].default_value = density
    shader.inputs["Color"].default_value = (0.9, 0.9, 0.9, 1.0)
    shader.inputs["Anisotropy"].default_value = 0.4
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
    data.materials.append(material)
    return shader


def cube_mesh(size=1.0):
    mesh = bpy.data.meshes.new("Cube")
    corners = [(size * x, size * y, size * z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    mesh.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    return mesh


def smooth_cube(stage, name):
    """A rounded cube object."""
    shown = stage.link(name, cube_mesh())
    shown.modifiers.new("Round", 'SUBSURF').render_levels = 3
    shown.modifiers["Round"].levels = 3
    return shown


# Volumes


def plain(stage):
    pass


def mesh_to_volume(stage):
    stage.hide_cloud()
    source = smooth_cube(stage, "Shape")
    source.hide_render = True
    made = stage.link("Made", bpy.data.volumes.new("Made"))
    modifier = made.modifiers.new("Fill", 'MESH_TO_VOLUME')
    modifier.object, modifier.resolution_mode, modifier.voxel_size = source, 'VOXEL_SIZE', 0.06
    fog(made.data, "Made", 4.0)


def displaced(stage):
    texture = bpy.data.textures.new("Bumps", 'CLOUDS')
    texture.noise_scale = 0.5
    modifier = stage.cloud.modifiers.new("Bumps", 'VOLUME_DISPLACE')
    modifier.texture, modifier.strength = texture, 0.4


def volume_cube(stage):
    stage.hide_cloud()
    group = bpy.data.node_groups.new("Make", 'GeometryNodeTree')
    group.interface.new_socket("Geometry", in_out='OUTPUT', socket_type='NodeSocketGeometry')
    cube, material = group.nodes.new("GeometryNodeVolumeCube"), group.nodes.new("GeometryNodeSetMaterial")
    for axis in ("X", "Y", "Z"):
        cube.inputs[f"Resolution {axis}"].default_value = 48
    noise = group.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 1.5, 2.0
    group.links.new(noise.outputs[0], cube.inputs["Density"])
    holder = bpy.data.volumes.new("Holder")
    fog(holder, "Made", 4.0)
    material.inputs["Material"].default_value = holder.materials[0]
    group.links.new(cube.outputs[0], material.inputs["Geometry"])
    group.links.new(material.outputs[0], group.nodes.new("NodeGroupOutput").inputs[0])
    stage.link("Made", holder).modifiers.new("Make", 'NODES').node_group = group


def mesh_fog(stage):
    stage.hide_cloud()
    fog(smooth_cube(stage, "Ball").data, "Ball", 4.0)


def mesh_noise(stage):
    stage.hide_cloud()
    shown = stage.link("Box", cube_mesh(0.9))
    stage.shader = fog(shown.data, "Box")
    noise, ramp = stage.node("TexNoise"), stage.node("MapRange")
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = 2.0, 1.0
    for socket, value in zip(ramp.inputs[1:5], (0.45, 0.75, 0.0, 20.0)):
        socket.default_value = value
    stage.connect(noise.outputs[0], ramp.inputs[0])
    stage.connect(ramp.outputs[0], stage.shader.inputs["Density"])
    stage.step_rate = 0.1


def copied(stage, location):
    other = stage.cloud.copy()
    stage.scene.collection.objects.link(other)
    other.location = location
    return other


def apart(stage):
    stage.cloud.scale = (0.6,) * 3
    stage.cloud.location = (-0.7, 0.0, 0.0)
    copied(stage, (0.7, 0.5, 0.2))


def overlapping(stage):
    stage.cloud.scale = (0.8,) * 3
    stage.cloud.location = (-0.3, 0.0, 0.0)
    copied(stage, (0.3, 0.3, 0.1)).rotation_euler = (1.0, 0.5, 2.0)


def instances(stage):
    stage.cloud.scale = (0.55,) * 3
    stage.scene.collection.objects.unlink(stage.cloud)
    group = bpy.data.collections.new("Group")
    group.objects.link(stage.cloud)
    for number, place in enumerate(((-0.7, 0.0, -0.5), (0.7, 0.0, -0.4), (0.0, 0.3, 0.7))):
        empty = stage.link(f"At {number}", None)
        empty.instance_type, empty.instance_collection, empty.location = 'COLLECTION', group, place
        empty.rotation_euler.z = 2.0 * number


def sheared(stage):
    parent = stage.link("Parent", None)
    parent.scale, parent.rotation_euler = (1.4, 0.7, -1.0), (0.3, 0.2, 0.5)
    stage.cloud.parent = parent
    stage.cloud.rotation_euler = (0.4, 0.8, 0.3)
    stage.cloud.scale = (-0.8, 0.8, 0.9)


def object_space(stage):
    stage.cloud.data.render.space = 'OBJECT'
    stage.cloud.scale = (1.2, 0.6, 0.9)
    stage.cloud.rotation_euler = (0.4, 0.8, 0.3)


def inside(stage):
    aim(stage.camera, Vector((0.0, -0.35, 0.0)), Vector((0.1, 0.6, 0.1)))
    stage.camera.data.angle = math.radians(80.0)
    stage.camera.data.clip_start = 0.001
    stage.shader.inputs["Density"].default_value = 4.0


def far_away(stage):
    for item in (stage.cloud, stage.camera):
        item.location += Vector((5000.0, -3000.0, 800.0))


def tiny(stage):
    scale = Matrix.Scale(0.001, 4)
    stage.cloud.matrix_world = scale
    stage.camera.location *= 0.001
    stage.camera.data.clip_start = 1e-4
    stage.shader.inputs["Density"].default_value = DENSITY * 1000.0


# Materials


def scatter(stage):
    shader, product = stage.node("VolumeScatter"), stage.node("Math", operation='MULTIPLY')
    shader.inputs["Color"].default_value, shader.inputs["Anisotropy"].default_value = (0.9, 0.9, 0.9, 1.0), 0.4
    product.inputs[1].default_value = DENSITY
    stage.connect(stage.grid(), product.inputs[0])
    stage.connect(product.outputs[0], shader.inputs["Density"])
    stage.replace_shader(shader)


def scatter_and_absorption(stage):
    shaders = stage.node("VolumeScatter"), stage.node("VolumeAbsorption")
    join = stage.node("MixShader")
    join.inputs["Fac"].default_value = 0.25
    for number, shader in enumerate(shaders):
        product = stage.node("Math", operation='MULTIPLY')
        product.inputs[1].default_value = DENSITY
        stage.connect(stage.grid(), product.inputs[0])
        stage.connect(product.outputs[0], shader.inputs["Density"])
        stage.connect(shader.outputs[0], join.inputs[number + 1])
    shaders[1].inputs["Color"].default_value = (0.3, 0.6, 0.8, 1.0)
    stage.replace_shader(join)


def remapped(stage):
    ramp = stage.node("MapRange", interpolation_type='SMOOTHSTEP')
    for socket, value in zip(ramp.inputs[1:5], (0.1, 0.6, 0.0, 10.0)):
        socket.default_value = value
    stage.connect(stage.grid(), ramp.inputs[0])
    stage.connect(ramp.outputs[0], stage.shader.inputs["Density"])
    stage.shader.inputs["Density Attribute"].default_value = ""


def ramped(stage):
    ramp, product = stage.node("ValToRGB"), stage.node("Math", operation='MULTIPLY')
    ramp.color_ramp.elements[0].position = 0.05
    ramp.color_ramp.elements[1].position = 0.5
    product.inputs[1].default_value = 10.0
    stage.connect(stage.grid(), ramp.inputs[0])
    stage.connect(ramp.outputs[0], product.inputs[0])
    stage.connect(product.outputs[0], stage.shader.inputs["Density"])
    stage.shader.inputs["Density Attribute"].default_value = ""


def carved(stage):
    """Noise in object space eats into the grid."""
    noise, ramp = stage.node("TexNoise"), stage.node("MapRange")
    noise.inputs["Scale"].default_value = 2.0
    for socket, value in zip(ramp.inputs[1:5], (0.4, 0.65, 0.0, DENSITY)):
        socket.default_value = value
    stage.connect(stage.node("TexCoord").outputs["Object"], noise.inputs["Vector"])
    stage.connect(noise.outputs[0], ramp.inputs[0])
    stage.connect(ramp.outputs[0], stage.shader.inputs["Density"])


def coloured(stage):
    stage.shader.inputs["Color"].default_value = (0.95, 0.8, 0.5, 1.0)
    stage.shader.inputs["Absorption Color"].default_value = (0.5, 0.2, 0.0, 1.0)


def chromatic(stage):
    product = stage.node("VectorMath", operation='MULTIPLY')
    product.inputs[1].default_value = (4.0, 7.0, 12.0)
    shader = stage.node("VolumeCoefficients")
    shader.inputs["Anisotropy"].default_value = 0.4
    stage.connect(stage.grid(), product.inputs[0])
    shader.inputs["Absorption Coefficients"].default_value = (0.0, 0.0, 0.0)
    stage.connect(product.outputs[0], shader.inputs["Scatter Coefficients"])
    stage.replace_shader(shader)


def draine(stage):
    scatter(stage)
    shader = stage.shader.id_data.nodes["Volume Scatter"]
    shader.phase, shader.inputs["Alpha"].default_value = 'DRAINE', 1.0


# Surfaces


def black_ball(stage, location):
    """A rounded cube that is held out of Cycles' image and reflects nothing."""
    shown = smooth_cube(stage, "Ball")
    shown.scale, shown.location = (0.5, 0.5, 0.5), location
    material = bpy.data.materials.new("Black")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    black = tree.nodes.new("ShaderNodeBsdfDiffuse")
    black.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    tree.links.new(black.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    shown.data.materials.append(material)
    shown.is_holdout = True
    stage.surfaces.append(shown)
    return shown


def ball_before(stage):
    black_ball(stage, (0.7, -1.6, 0.5)).visible_shadow = False


def ball_inside(stage):
    black_ball(stage, (0.15, -0.25, 0.1)).visible_shadow = False


def ball_above(stage):
    """Its shadow alone falls on the cloud."""
    shown = black_ball(stage, Vector((-0.8, -0.3, 0.6)) * 2.2)
    shown.scale = (0.35, 0.35, 0.35)


# Light of their own


def black(shader):
    """Fog that only absorbs: of light that is emitted and scattered nothing is predicted."""
    shader.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)


def glowing(stage):
    """Shines in all of Cycles' boxes."""
    black(stage.shader)
    stage.shader.inputs["Emission Strength"].default_value = 0.3
    stage.shader.inputs["Emission Color"].default_value = (1.0, 0.4, 0.1, 1.0)


def burning(stage):
    """A blackbody whose temperature a grid drives, without a sun."""
    bpy.data.objects.remove(stage.sun)
    black(stage.shader)
    stage.shader.inputs["Blackbody Intensity"].default_value = 1.0
    stage.shader.inputs["Temperature"].default_value = 2500.0
    stage.shader.inputs["Temperature Attribute"].default_value = "density"
    stage.step_rate = 0.1


def flaming(stage):
    """Emission strength through nodes, in smoke that scatters it and sunlight."""
    ramp = stage.node("MapRange")
    for socket, value in zip(ramp.inputs[1:5], (0.2, 0.8, 0.0, 4.0)):
        socket.default_value = value
    stage.connect(stage.grid(), ramp.inputs[0])
    stage.connect(ramp.outputs[0], stage.shader.inputs["Emission Strength"])
    stage.shader.inputs["Emission Color"].default_value = (1.0, 0.4, 0.1, 1.0)


def lamp_mesh(stage):
    stage.hide_cloud()
    shader = fog(smooth_cube(stage, "Ball").data, "Ball", 0.5)
    black(shader)
    shader.inputs["Emission Strength"].default_value = 1.0


# Lights


def two_suns(stage):
    lamp = stage.sun.data.copy()
    lamp.color, lamp.energy = (0.2, 0.4, 1.0), 5.0
    stage.link("Second", lamp).rotation_euler = (0.3, 1.3, 0.0)


def sun_of(degrees):
    def soft(stage):
        stage.sun.data.angle = math.radians(degrees)
    return soft


def even_world(stage):
    bpy.data.objects.remove(stage.sun)
    stage.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1.0


def grey_world(stage):
    node = stage.scene.world.node_tree.nodes["Background"]
    node.inputs["Strength"].default_value, node.inputs["Color"].default_value = 0.3, (0.3, 0.5, 1.0, 1.0)


def environment_image(stage):
    bpy.data.objects.remove(stage.sun)
    image = bpy.data.images.new("Around", 256, 128, float_buffer=True)
    u, v = np.meshgrid((np.arange(256) + 0.5) / 256, (np.arange(128) + 0.5) / 128)
    glow = 60.0 * np.exp(-((u - 0.3) ** 2 * 4 + (v - 0.7) ** 2) / 0.003)
    sky = np.where(v > 0.5, 0.3 + 0.5 * v, 0.15)
    pixels = np.stack([sky * 0.6 + glow, sky * 0.8 + 0.9 * glow, sky * 1.2 + 0.7 * glow, np.ones_like(u)], axis=2)
    image.pixels.foreach_set(pixels.astype(np.float32).ravel())
    image.pack()
    tree = stage.scene.world.node_tree
    texture = tree.nodes.new("ShaderNodeTexEnvironment")
    texture.image = image
    tree.links.new(texture.outputs[0], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = 1.0


# Cameras


def orthographic(stage):
    stage.camera.data.type, stage.camera.data.ortho_scale = 'ORTHO', 2.4


def shifted(stage):
    stage.camera.data.shift_x, stage.camera.data.shift_y = 0.15, -0.1
    stage.camera.data.sensor_fit = 'VERTICAL'
    stage.scene.render.resolution_y = int(stage.scene.render.resolution_x * 0.75)


def clipped(stage):
    distance = stage.camera.location.length
    stage.camera.data.clip_start, stage.camera.data.clip_end = distance - 0.1, distance + 0.5


MEASURED = {
    "Volume object, .vdb file, one sun": plain,
    "Mesh to Volume": mesh_to_volume,
    "Volume Displace": displaced,
    "Geometry nodes: Volume Cube with noise": volume_cube,
    "Principled Volume in a mesh": mesh_fog,
    "Noise Texture in a mesh": mesh_noise,
    "Two volumes apart": apart,
    "Two volumes that overlap": overlapping,
    "Collection instances": instances,
    "Parent, shear, negative scale": sheared,
    "Object-space density, non-uniform scale": object_space,
    "Camera inside the volume": inside,
    "5 km from the origin": far_away,
    "2 mm large": tiny,
    "Volume Scatter through Math": scatter,
    "Volume Scatter mixed with Absorption": scatter_and_absorption,
    "Density through Map Range": remapped,
    "Density through Color Ramp": ramped,
    "Density times noise": carved,
    "Chromatic albedo": coloured,
    "Chromatic extinction (Volume Coefficients)": chromatic,
    "Draine's phase function": draine,
    "Opaque mesh before a volume, without its shadow": ball_before,
    "Opaque mesh inside a volume, without its shadow": ball_inside,
    "Shadow of an opaque mesh": ball_above,
    "Even emission, in smoke that absorbs": glowing,
    "Blackbody of a temperature grid, in smoke that absorbs": burning,
    "Emission through Map Range, in smoke that scatters it": flaming,
    "Emission in a mesh, fog that absorbs": lamp_mesh,
    "Two suns": two_suns,
    "Sun of 10 degrees": sun_of(10.0),
    "Sun of 40 degrees": sun_of(40.0),
    "Sun and a grey-blue World": grey_world,
    "Even World alone": even_world,
    "Environment image alone": environment_image,
    "Orthographic": orthographic,
    "Lens shift, vertical sensor fit": shifted,
    "Clip range through the volume": clipped,
}


# What is named instead


def lamp_of(kind):
    def lamp(stage):
        stage.link(kind.title(), bpy.data.lights.new(kind.title(), kind))
    return lamp


def sky(stage):
    tree = stage.scene.world.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeTexSky").outputs[0], tree.nodes["Background"].inputs["Color"])


def world_fog(stage):
    tree = stage.scene.world.node_tree
    tree.links.new(tree.nodes.new("ShaderNodeVolumeScatter").outputs[0], tree.get_output_node('CYCLES').inputs["Volume"])


def linked_sun(stage):
    stage.sun.light_linking.receiver_collection = bpy.data.collections.new("Some")


def surface(stage):
    stage.link("Ground", cube_mesh())


def blur(stage):
    stage.camera.data.dof.use_dof = True
    stage.scene.render.use_motion_blur = True


def panorama(stage):
    stage.camera.data.type = 'PANO'


def voronoi(stage):
    stage.connect(stage.node("TexVoronoi").outputs[0], stage.shader.inputs["Density"])


def varying_colour(stage):
    ramp = stage.node("ValToRGB")
    stage.connect(stage.grid(), ramp.inputs[0])
    stage.connect(ramp.outputs[0], stage.shader.inputs["Color"])


def missing_frame(stage):
    data = stage.cloud.data
    data.filepath, data.is_sequence, data.frame_duration = str(stage.folder / "gone_0001.vdb"), True, 3


NAMED = {
    "Point light": lamp_of('POINT'), "Spot light": lamp_of('SPOT'),
    "Area light": lamp_of('AREA'), "Sky Texture": sky, "World volume": world_fog, "Light linking": linked_sun,
    "Opaque mesh": surface, "Depth of field, motion blur": blur, "Panoramic camera": panorama,
    "Voronoi Texture in the density": voronoi, "Colour that varies with the density": varying_colour,
    "Missing frame of a sequence": missing_frame,
}
