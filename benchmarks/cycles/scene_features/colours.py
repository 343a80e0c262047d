# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour and absorption that vary in space."""

import functools

from .stage import DENSITY

FORWARD = 0.857


def _ramp(stage, *colours):
    """A Color Ramp; colours: (position, red, green, blue)."""
    ramp = stage.node("ValToRGB")
    elements = ramp.color_ramp.elements
    while len(elements) < len(colours):
        elements.new(0.5)
    for element, (position, *colour) in zip(elements, colours):
        element.position, element.color = position, (*colour, 1.0)
    return ramp


def _noise(stage, scale):
    noise = stage.node("TexNoise")
    noise.inputs["Scale"].default_value, noise.inputs["Detail"].default_value = scale, 1.0
    stage.connect(stage.node("TexCoord").outputs["Object"], noise.inputs["Vector"])
    return noise.outputs[0]


def smoke(stage, anisotropy):
    """Three colours, by noise in object space."""
    ramp = _ramp(stage, (0.35, 0.95, 0.35, 0.25), (0.5, 0.9, 0.9, 0.9), (0.65, 0.2, 0.45, 0.95))
    stage.connect(_noise(stage, 1.5), ramp.inputs[0])
    stage.connect(ramp.outputs[0], stage.shader.inputs["Color"])
    stage.shader.inputs["Anisotropy"].default_value = anisotropy


def dyes(stage, anisotropy):
    """Orange on the left, blue on the right."""
    ramp, part = _ramp(stage, (0.45, 0.97, 0.7, 0.25), (0.55, 0.2, 0.6, 0.97)), stage.node("SeparateXYZ")
    range_ = stage.node("MapRange")
    for socket, value in zip(range_.inputs[1:5], (-1.0, 1.0, 0.0, 1.0)):
        socket.default_value = value
    stage.connect(stage.node("TexCoord").outputs["Object"], part.inputs[0])
    stage.connect(part.outputs[0], range_.inputs[0])
    stage.connect(range_.outputs[0], ramp.inputs[0])
    stage.connect(ramp.outputs[0], stage.shader.inputs["Color"])
    stage.shader.inputs["Anisotropy"].default_value = anisotropy


def soot(stage, anisotropy):
    """Steam that hardly absorbs, and soot where noise puts it, of as much extinction."""
    steam, black, join = stage.node("VolumeScatter"), stage.node("VolumeAbsorption"), stage.node("MixShader")
    steam.inputs["Color"].default_value, steam.inputs["Anisotropy"].default_value = (1.0, 1.0, 1.0, 1.0), anisotropy
    black.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    product, mask = stage.node("Math", operation="MULTIPLY"), stage.node("MapRange")
    product.inputs[1].default_value = DENSITY
    for socket, value in zip(mask.inputs[1:5], (0.45, 0.65, 0.01, 0.9)):
        socket.default_value = value
    stage.connect(_noise(stage, 1.5), mask.inputs[0])
    stage.connect(stage.grid(), product.inputs[0])
    stage.connect(mask.outputs[0], join.inputs["Fac"])
    for number, shader in enumerate((steam, black)):
        stage.connect(product.outputs[0], shader.inputs["Density"])
        stage.connect(shader.outputs[0], join.inputs[number + 1])
    stage.replace_shader(join)


def fire(stage, anisotropy):
    """Colour and emission by Color Ramps of the density."""
    colour = _ramp(stage, (0.0, 0.9, 0.9, 0.9), (0.5, 0.7, 0.35, 0.15), (1.0, 0.1, 0.1, 0.1))
    glow = _ramp(stage, (0.3, 0.0, 0.0, 0.0), (0.6, 1.0, 0.25, 0.02), (1.0, 1.0, 0.8, 0.3))
    for ramp, name in ((colour, "Color"), (glow, "Emission Color")):
        stage.connect(stage.grid(), ramp.inputs[0])
        stage.connect(ramp.outputs[0], stage.shader.inputs[name])
    stage.shader.inputs["Emission Strength"].default_value = 2.0
    stage.shader.inputs["Anisotropy"].default_value = anisotropy


def tinted(stage, anisotropy):
    """Volume Scatter with a Color that varies: its extinction is what it scatters."""
    ramp, shader = _ramp(stage, (0.2, 1.0, 0.35, 0.2), (0.7, 0.25, 0.5, 1.0)), stage.node("VolumeScatter")
    product = stage.node("Math", operation="MULTIPLY")
    product.inputs[1].default_value, shader.inputs["Anisotropy"].default_value = DENSITY, anisotropy
    stage.connect(stage.grid(), ramp.inputs[0])
    stage.connect(stage.grid(), product.inputs[0])
    stage.connect(ramp.outputs[0], shader.inputs["Color"])
    stage.connect(product.outputs[0], shader.inputs["Density"])
    stage.replace_shader(shader)


def voronoi(stage, anisotropy):
    """Colour and density by cells, in the coordinates that an unlinked texture has."""
    texture, product = stage.node("TexVoronoi", normalize=True), stage.node("Math", operation="MULTIPLY")
    texture.inputs["Scale"].default_value, product.inputs[1].default_value = 2.0, 2.0 * DENSITY
    stage.connect(texture.outputs["Distance"], product.inputs[0])
    stage.connect(texture.outputs["Color"], stage.shader.inputs["Color"])
    stage.connect(product.outputs[0], stage.shader.inputs["Density"])
    stage.shader.inputs["Anisotropy"].default_value = anisotropy


MEASURED = {
    f"{name}, {kind}": functools.partial(builder, anisotropy=anisotropy)
    for name, builder in (
        ("Coloured smoke", smoke),
        ("Two dyes that meet", dyes),
        ("Soot in white steam", soot),
        ("Fire's colour ramp", fire),
        ("Extinction whose colour varies", tinted),
        ("Voronoi Texture in density and colour", voronoi),
    )
    for kind, anisotropy in (("isotropic", 0.0), (f"G {FORWARD:g}", FORWARD))
}
