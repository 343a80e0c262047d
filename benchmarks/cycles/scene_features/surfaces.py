# SPDX-License-Identifier: GPL-3.0-or-later
"""Opaque meshes that cover volumes and cast shadows on them."""

import math

import bpy
from mathutils import Vector

from ...support.shaders import add_shader
from .lights import PLACES, isotropic_and_forward
from .stage import aim, smooth_cube


def black_ball(stage, location):
    """A rounded cube, held out and black."""
    shown = smooth_cube(stage, "Ball")
    shown.scale, shown.location = (0.5, 0.5, 0.5), location
    paint(stage, shown)
    return shown


def paint(stage, shown, grey=0.0):
    """Hold an object out of Cycles' image; it reflects a share of its light."""
    matt = add_shader(shown.data, "Paint", "BsdfDiffuse", "Surface")
    matt.inputs["Color"].default_value = (grey, grey, grey, 1.0)
    shown.is_holdout = True
    stage.surfaces.append(shown)


def ball_before(stage):
    black_ball(stage, (0.7, -1.6, 0.5)).visible_shadow = False


def ball_inside(stage):
    black_ball(stage, (0.15, -0.25, 0.1)).visible_shadow = False


def ball_inside_with_shadow(stage):
    black_ball(stage, (0.15, -0.25, 0.1))


def ground(stage, grey=0.0, height=-0.3):
    """A plane through the cloud's lower part, or below it."""
    stage.link("Ground", bpy.data.meshes.new("Ground"))
    shown = bpy.data.objects["Ground"]
    shown.data.from_pydata([(x, y, height) for x, y in ((-4, -4), (4, -4), (4, 4), (-4, 4))], [], [(0, 1, 2, 3)])
    paint(stage, shown, grey)


def ground_under_world(stage, grey=0.0, height=-0.3):
    ground(stage, grey, height)
    bpy.data.objects.remove(stage.sun)
    stage.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1.0


def glow(stage, shown, power, area):
    """Hold an object out of Cycles' image; it emits a power on both sides."""
    shader = add_shader(shown.data, "Glow", "Emission", "Surface")
    shader.inputs["Strength"].default_value = power / (math.pi * area)
    shown.is_holdout = True
    stage.surfaces.append(shown)


def glowing_plane(place):
    """A small square that faces the cloud's middle, alone."""
    location, share = PLACES[place]

    def alone(stage):
        bpy.data.objects.remove(stage.sun)
        shown, half = stage.link("Panel", bpy.data.meshes.new("Panel")), 0.2
        corners = [(x, y, 0.0) for x, y in ((-half, -half), (half, -half), (half, half), (-half, half))]
        shown.data.from_pydata(corners, [], [(0, 1, 2, 3)])
        aim(shown, Vector(location))
        glow(stage, shown, 60.0 * share, (2.0 * half) ** 2)

    return alone


def glowing_ball(stage):
    """A rounded cube."""
    bpy.data.objects.remove(stage.sun)
    shown = smooth_cube(stage, "Bulb")
    shown.scale, shown.location = (0.2, 0.2, 0.2), PLACES["outside"][0]
    glow(stage, shown, 150.0, 4.0 * math.pi * 0.15**2)


def ball_above(stage):
    """Its shadow alone falls on the cloud."""
    shown = black_ball(stage, Vector((-0.8, -0.3, 0.6)) * 2.2)
    shown.scale = (0.35, 0.35, 0.35)


MEASURED = {
    "Opaque mesh before a volume, without its shadow": ball_before,
    "Opaque mesh inside a volume, without its shadow": ball_inside,
    "Opaque mesh inside a volume": ball_inside_with_shadow,
    "Opaque ground through a volume": ground,
    "Bright ground through a volume": lambda stage: ground(stage, 0.8),
    "Bright ground below a volume": lambda stage: ground(stage, 0.8, -1.05),
    "Even World over opaque ground": ground_under_world,
    "Even World over grey ground through a volume": lambda stage: ground_under_world(stage, 0.5),
    "Even World over grey ground below a volume": lambda stage: ground_under_world(stage, 0.5, -1.05),
    "Shadow of an opaque mesh": ball_above,
    **isotropic_and_forward(
        {f"Glowing plane {place}": glowing_plane(place) for place in PLACES} | {"Glowing ball": glowing_ball}
    ),
}
