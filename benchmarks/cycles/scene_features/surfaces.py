# SPDX-License-Identifier: GPL-3.0-or-later
"""Opaque meshes that cover volumes and cast shadows on them."""

import bpy
from mathutils import Vector

from ...support.shaders import add_shader
from .stage import smooth_cube


def black_ball(stage, location):
    """A rounded cube, held out and black."""
    shown = smooth_cube(stage, "Ball")
    shown.scale, shown.location = (0.5, 0.5, 0.5), location
    paint_black(stage, shown)
    return shown


def paint_black(stage, shown):
    """Hold an object out of Cycles' image; it reflects nothing."""
    black = add_shader(shown.data, "Black", "BsdfDiffuse", "Surface")
    black.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    shown.is_holdout = True
    stage.surfaces.append(shown)


def ball_before(stage):
    black_ball(stage, (0.7, -1.6, 0.5)).visible_shadow = False


def ball_inside(stage):
    black_ball(stage, (0.15, -0.25, 0.1)).visible_shadow = False


def ball_inside_with_shadow(stage):
    black_ball(stage, (0.15, -0.25, 0.1))


def ground(stage):
    """A plane through the cloud's lower part."""
    stage.link("Ground", bpy.data.meshes.new("Ground"))
    shown = bpy.data.objects["Ground"]
    shown.data.from_pydata([(-4, -4, -0.3), (4, -4, -0.3), (4, 4, -0.3), (-4, 4, -0.3)], [], [(0, 1, 2, 3)])
    paint_black(stage, shown)


def ground_under_world(stage):
    ground(stage)
    bpy.data.objects.remove(stage.sun)
    stage.scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1.0


def ball_above(stage):
    """Its shadow alone falls on the cloud."""
    shown = black_ball(stage, Vector((-0.8, -0.3, 0.6)) * 2.2)
    shown.scale = (0.35, 0.35, 0.35)


MEASURED = {
    "Opaque mesh before a volume, without its shadow": ball_before,
    "Opaque mesh inside a volume, without its shadow": ball_inside,
    "Opaque mesh inside a volume": ball_inside_with_shadow,
    "Opaque ground through a volume": ground,
    "Even World over opaque ground": ground_under_world,
    "Shadow of an opaque mesh": ball_above,
}
