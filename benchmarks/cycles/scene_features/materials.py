# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume shaders and nodes."""

from .stage import DENSITY


def scatter(stage):
    shader, product = stage.node("VolumeScatter"), stage.node("Math", operation="MULTIPLY")
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
        product = stage.node("Math", operation="MULTIPLY")
        product.inputs[1].default_value = DENSITY
        stage.connect(stage.grid(), product.inputs[0])
        stage.connect(product.outputs[0], shader.inputs["Density"])
        stage.connect(shader.outputs[0], join.inputs[number + 1])
    shaders[1].inputs["Color"].default_value = (0.3, 0.6, 0.8, 1.0)
    stage.replace_shader(join)


def remapped(stage):
    ramp = stage.node("MapRange", interpolation_type="SMOOTHSTEP")
    for socket, value in zip(ramp.inputs[1:5], (0.1, 0.6, 0.0, 10.0)):
        socket.default_value = value
    stage.connect(stage.grid(), ramp.inputs[0])
    stage.connect(ramp.outputs[0], stage.shader.inputs["Density"])
    stage.shader.inputs["Density Attribute"].default_value = ""


def ramped(stage):
    ramp, product = stage.node("ValToRGB"), stage.node("Math", operation="MULTIPLY")
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
    product = stage.node("VectorMath", operation="MULTIPLY")
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
    shader.phase, shader.inputs["Alpha"].default_value = "DRAINE", 1.0


MEASURED = {
    "Volume Scatter through Math": scatter,
    "Volume Scatter mixed with Absorption": scatter_and_absorption,
    "Density through Map Range": remapped,
    "Density through Color Ramp": ramped,
    "Density times noise": carved,
    "Chromatic albedo": coloured,
    "Chromatic extinction (Volume Coefficients)": chromatic,
    "Draine's phase function": draine,
}
