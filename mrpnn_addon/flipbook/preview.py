# SPDX-License-Identifier: GPL-3.0-or-later
"""A flipbook on a plane, relit by six sliders of a node group."""

import json
import os
from typing import Any

import bpy
import numpy as np

from ...inference.scene import SceneError
from ..objects.placement import placement_problem
from .atlas import LAYOUTS
from .light_maps import SIDES
from .texture_files import FORMATS

GROUP = "Six-Way Light"
# What shines at first.
STRENGTHS = {"top": 0.5, "right": 1.0, "front": 0.2}


def show_flipbook(scene: "bpy.types.Scene", base: str, file_format: str) -> "bpy.types.Object":
    """Add a plane that shows a flipbook frame by frame. Returns the plane.

    base, file_format: as of Flipbook. Raises SceneError where there is none.
    """
    try:
        with open(f"{base}.json", encoding="utf-8") as file:
            facts = json.load(file)
        paths = [f"{base}_{name}{FORMATS[file_format][0]}" for name in "AB"]
        images = [_image(path) for path in paths]
    except (OSError, ValueError, RuntimeError):
        raise SceneError(f"there is no flipbook {base} of this format; render it first") from None
    name = os.path.basename(base)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [], [(0, 1, 2, 3)])
    mesh.uv_layers.new(name="UVMap").data.foreach_set("uv", [0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 1.0])
    mesh.materials.append(_material(name, images, facts))
    plane: Any = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(plane)
    plane.location = scene.cursor.location
    camera = scene.camera
    if camera is not None and not placement_problem(np.array(camera.matrix_world)):
        # Facing the camera.
        plane.rotation_euler = camera.matrix_world.to_euler()
    return plane


def _image(path: str) -> Any:
    image: Any = bpy.data.images.load(path, check_existing=True)
    image.reload()
    image.colorspace_settings.name, image.alpha_mode = "Non-Color", "CHANNEL_PACKED"
    return image


def _material(name: str, images: list, facts: dict) -> Any:
    material: Any = bpy.data.materials.new(name)
    material.use_nodes = True
    material.surface_render_method = "BLENDED"
    tree = material.node_tree
    tree.nodes.clear()
    place, mapping = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    tree.links.new(place.outputs["UV"], mapping.inputs["Vector"])
    _play(mapping, facts)
    light: Any = tree.nodes.new("ShaderNodeGroup")
    light.node_tree = _group(facts)
    light.location, light.width = (500, 0), 200
    for number, (letter, image) in enumerate(zip("AB", images)):
        texture: Any = tree.nodes.new("ShaderNodeTexImage")
        texture.image, texture.extension, texture.location = image, "CLIP", (150, -300 * number)
        tree.links.new(mapping.outputs["Vector"], texture.inputs["Vector"])
        tree.links.new(texture.outputs["Color"], light.inputs[letter])
        tree.links.new(texture.outputs["Alpha"], light.inputs[("Alpha", "Emission Map")[number]])
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    output.location, place.location, mapping.location = (750, 0), (-300, 0), (-80, 0)
    tree.links.new(light.outputs["Shader"], output.inputs["Surface"])
    return material


def _play(mapping: Any, facts: dict) -> None:
    """Show the tile of the scene's frame."""
    columns, rows, frames = facts["columns"], facts["rows"], facts["frames"]
    mapping.inputs["Scale"].default_value = (1.0 / columns, 1.0 / rows, 1.0)
    step = (len(frames) - 1) / max(frames[-1] - frames[0], 1)
    # What Blender evaluates without Python, so that files need no permission for it.
    tile = f"floor(clamp((frame - {frames[0]}) * {step:.8f}, 0, {len(frames) - 1}) + 0.5)"
    column = f"fmod({tile}, {columns}) / {columns}"
    row = f"1 - (1 + floor({tile} / {columns})) / {rows}"
    for axis, expression in enumerate((column, row)):
        driver = mapping.inputs["Location"].driver_add("default_value", axis).driver
        driver.type, driver.expression = "SCRIPTED", expression


def _group(facts: dict) -> Any:
    """The node group of a layout: the sum of the light maps, each times its slider, as a shader with alpha."""
    tree: Any = bpy.data.node_groups.new(GROUP, "ShaderNodeTree")
    sockets = tree.interface
    sockets.new_socket("Shader", in_out="OUTPUT", socket_type="NodeSocketShader")
    for side in SIDES:
        slider = sockets.new_socket(side.title(), in_out="INPUT", socket_type="NodeSocketFloat")
        slider.default_value, slider.min_value, slider.max_value = STRENGTHS.get(side, 0.0), 0.0, 10.0
    tint = sockets.new_socket("Tint", in_out="INPUT", socket_type="NodeSocketColor")
    tint.default_value = (1.0, 1.0, 1.0, 1.0)
    glow = sockets.new_socket("Emission", in_out="INPUT", socket_type="NodeSocketFloat")
    glow.default_value, glow.min_value, glow.max_value = 1.0, 0.0, 100.0
    fire = sockets.new_socket("Emission Color", in_out="INPUT", socket_type="NodeSocketColor")
    fire.default_value = (1.0, 0.4, 0.1, 1.0)
    for name, kind in (("A", "Color"), ("B", "Color"), ("Alpha", "Float"), ("Emission Map", "Float")):
        sockets.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}").hide_value = True

    def add(kind: str, *inputs: Any, operation: str | None = None) -> Any:
        node = tree.nodes.new(kind)
        if operation:
            node.operation = operation
        for number, given in enumerate(inputs):
            if hasattr(given, "is_linked"):
                tree.links.new(given, node.inputs[number])
            elif given is not None:
                node.inputs[number].default_value = given
        return node

    given = add("NodeGroupInput").outputs
    total = None
    for letter, sides in zip("AB", LAYOUTS[facts["layout"]]):
        strengths = add("ShaderNodeCombineXYZ", *(given[side.title()] for side in sides)).outputs[0]
        part = add("ShaderNodeVectorMath", given[letter], strengths, operation="DOT_PRODUCT").outputs["Value"]
        total = part if total is None else add("ShaderNodeMath", total, part, operation="ADD").outputs[0]
    total = add("ShaderNodeMath", total, 1.0 / facts["light_scale"], operation="MULTIPLY").outputs[0]
    if facts["alpha"] == "straight":
        total = add("ShaderNodeMath", total, given["Alpha"], operation="MULTIPLY").outputs[0]
    glow = add("ShaderNodeMath", given["Emission Map"], given["Emission"], operation="MULTIPLY").outputs[0]
    glow = add("ShaderNodeMath", glow, facts["emission_scale"], operation="MULTIPLY").outputs[0]
    lit = add("ShaderNodeEmission", given["Tint"], total).outputs[0]
    burning = add("ShaderNodeEmission", given["Emission Color"], glow).outputs[0]
    left = add("ShaderNodeMath", 1.0, given["Alpha"], operation="SUBTRACT").outputs[0]
    behind = add("ShaderNodeBsdfTransparent", add("ShaderNodeCombineXYZ", left, left, left).outputs[0]).outputs[0]
    shader = add("ShaderNodeAddShader", add("ShaderNodeAddShader", lit, burning).outputs[0], behind).outputs[0]
    add("NodeGroupOutput", shader)
    return tree
