# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes that emit light."""

import bpy

from .stage import fog, smooth_cube


def black(shader):
    """Fog that only absorbs, so that no emitted light is scattered."""
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


MEASURED = {
    "Even emission, in smoke that absorbs": glowing,
    "Blackbody of a temperature grid, in smoke that absorbs": burning,
    "Emission through Map Range, in smoke that scatters it": flaming,
    "Emission in a mesh, fog that absorbs": lamp_mesh,
}
