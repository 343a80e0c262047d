# SPDX-License-Identifier: GPL-3.0-or-later
"""Suns, lamps and Worlds."""

import math

import bpy
import numpy as np


def two_suns(stage):
    lamp = stage.sun.data.copy()
    lamp.color, lamp.energy = (0.2, 0.4, 1.0), 5.0
    stage.link("Second", lamp).rotation_euler = (0.3, 1.3, 0.0)


def warm_sun(stage):
    lamp = stage.sun.data
    lamp.use_temperature, lamp.temperature, lamp.exposure = True, 3200.0, 0.5


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


def sky(stage, strength=0.05):
    bpy.data.objects.remove(stage.sun)
    tree = stage.scene.world.node_tree
    texture = tree.nodes.new("ShaderNodeTexSky")
    texture.sun_elevation, texture.sun_rotation = math.radians(35.0), math.radians(-120.0)
    tree.links.new(texture.outputs[0], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = strength
    return texture


def low_sky_without_disc(stage):
    texture = sky(stage, 0.3)
    texture.sun_elevation, texture.sun_disc = math.radians(5.0), False


def voronoi_world(stage):
    """Coloured cells, without a node that is evaluated here."""
    bpy.data.objects.remove(stage.sun)
    tree = stage.scene.world.node_tree
    cells = tree.nodes.new("ShaderNodeTexVoronoi")
    cells.inputs["Scale"].default_value = 2.0
    tree.links.new(cells.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = 1.0


# Where lamps stand, and shares of their power there.
PLACES = {
    "outside": ((1.5, -1.3, 0.9), 1.0),
    "at the edge": ((0.75, -0.35, 0.45), 0.2),
    "inside": ((0.15, -0.1, 0.1), 0.15),
}
OUTSIDE = PLACES["outside"][0]
CONE = {"spot_size": 0.7, "spot_blend": 0.3, "shadow_soft_size": 0.1}
# Power and properties, of lamps of which every place is measured.
LAMPS = {
    "Point light": ("POINT", 150.0, {"shadow_soft_size": 0.1}),
    "Spot light": ("SPOT", 150.0, CONE),
    "Area light": ("AREA", 60.0, {"size": 0.4}),
}
SHAPES = {
    "Rectangular area light": ("AREA", 150.0, {"shape": "RECTANGLE", "size": 1.5, "size_y": 0.3}),
    "Disk area light": ("AREA", 150.0, {"shape": "DISK", "size": 1.0}),
    "Elliptic area light": ("AREA", 150.0, {"shape": "ELLIPSE", "size": 1.5, "size_y": 0.5}),
    "Area light of a spread of 60 degrees": ("AREA", 150.0, {"size": 1.0, "spread": math.radians(60.0)}),
}


def add_lamp(stage, kind, location, power=150.0, **values):
    """A lamp that looks at the cloud."""
    lamp = bpy.data.lights.new(kind.title(), kind)
    lamp.energy = power
    for name, value in values.items():
        setattr(lamp, name, value)
    shown = stage.link(kind.title(), lamp)
    shown.location = location
    shown.rotation_euler = shown.location.to_track_quat("Z", "Y").to_euler()


def lamp_alone(kind, power, values, place="outside"):
    location, share = PLACES[place]

    def alone(stage):
        bpy.data.objects.remove(stage.sun)
        add_lamp(stage, kind, location, share * power, **values)

    return alone


def three_lamps(stage):
    bpy.data.objects.remove(stage.sun)
    add_lamp(stage, "POINT", OUTSIDE, shadow_soft_size=0.1, color=(1.0, 0.6, 0.3))
    add_lamp(stage, "SPOT", (-1.6, -0.8, 0.6), 200.0, spot_size=0.7, spot_blend=0.3, color=(0.3, 0.5, 1.0))
    add_lamp(stage, "AREA", (0.0, 0.4, 2.0), 60.0, size=1.0)


def scattering(builder, anisotropy):
    """The same in a medium of that mean cosine."""

    def built(stage):
        builder(stage)
        stage.shader.inputs["Anisotropy"].default_value = anisotropy

    return built


def default_scene(stage):
    """The lamp, the camera and the World of Blender's default scene."""
    bpy.data.objects.remove(stage.sun)
    add_lamp(stage, "POINT", (4.07625, 1.00545, 5.90386), 1000.0, shadow_soft_size=0.1)
    stage.camera.location, stage.camera.rotation_euler = (7.35889, -6.92579, 4.95831), (1.10932, 0.0, 0.81493)
    stage.camera.data.angle = math.radians(39.6)
    node = stage.scene.world.node_tree.nodes["Background"]
    node.inputs["Strength"].default_value, node.inputs["Color"].default_value = 1.0, (0.05088, 0.05088, 0.05088, 1.0)


def isotropic_and_forward(cases):
    """Cases by name, at both ends of the anisotropy."""
    kinds = {"isotropic": 0.0, "G 0.857": 0.857}
    return {f"{name}, {kind}": scattering(builder, kinds[kind]) for name, builder in cases.items() for kind in kinds}


def lamps():
    """Cases of lamps, by name: each in every place."""
    cases = {f"{name} {place}": lamp_alone(*lamp, place) for name, lamp in LAMPS.items() for place in PLACES}
    cases |= {name: lamp_alone(*lamp) for name, lamp in SHAPES.items()} | {"Point, spot and area light": three_lamps}
    return isotropic_and_forward(cases)


MEASURED = {
    "Lamp and World of the default scene": default_scene,
    **lamps(),
    "Two suns": two_suns,
    "Sun of a temperature and an exposure": warm_sun,
    "Sun of 10 degrees": sun_of(10.0),
    "Sun of 40 degrees": sun_of(40.0),
    "Sun and a grey-blue World": grey_world,
    "Even World alone": even_world,
    "Even World alone, G 0.857": scattering(even_world, 0.857),
    "Environment image alone": environment_image,
    "Environment image alone, G 0.857": scattering(environment_image, 0.857),
    "Sky Texture": sky,
    "Sky Texture at dusk, without its disc": low_sky_without_disc,
    "Voronoi Texture in the World": voronoi_world,
}
