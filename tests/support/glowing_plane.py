# SPDX-License-Identifier: GPL-3.0-or-later
"""A glowing plane that shows what nodes evaluate to, here and in Cycles."""

import importlib

import bpy
import numpy as np

from . import blender_scenes

PIXELS = 24
EDGE = 3.0


class Plane:
    """Object coordinates at the pixels of a plane of edge EDGE seen from above, rows from the top."""

    fills_its_bounds = True

    def coordinates(self, kind, node):
        assert kind == "object"
        axis = ((np.arange(PIXELS) + 0.5) / PIXELS - 0.5) * EDGE
        x, y = np.meshgrid(axis, -axis)
        return np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.0)], axis=1)


def make(scene):
    """(node tree, emission node, socket of Object coordinates) of a plane under an orthographic camera."""
    mesh = bpy.data.meshes.new("Plane")
    half = EDGE
    mesh.from_pydata([(-half, -half, 0), (half, -half, 0), (half, half, 0), (-half, half, 0)], [], [(0, 1, 2, 3)])
    blender_scenes.add_object(scene, "Plane", mesh)
    material = bpy.data.materials.new("Emission")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    emission = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(emission.outputs[0], output.inputs["Surface"])
    mesh.materials.append(material)
    blender_scenes.add_camera(scene, ortho_scale=EDGE)
    scene.render.resolution_x = scene.render.resolution_y = PIXELS
    return tree, emission, tree.nodes.new("ShaderNodeTexCoord").outputs["Object"]


def rendered(scene, folder):
    """Cycles' colours at the pixels' centres, (n, 3)."""
    blender_scenes.set_up_cycles(scene, samples=1)
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    return blender_scenes.rendered(scene, folder)[..., :3].reshape(-1, 3)


def evaluated(emission):
    """The value of Blender's nodes, and of their copies, which threads evaluate."""
    values = importlib.import_module("mrpnn.mrpnn_addon.nodes.evaluation").NodeEvaluator(Plane())
    copied = importlib.import_module("mrpnn.mrpnn_addon.nodes.snapshot").snapshot(emission.id_data, emission)
    found = values.colour(emission, "Color")
    np.testing.assert_array_equal(values.colour(copied, "Color"), found)
    return np.broadcast_to(found, (PIXELS * PIXELS, 3))


def assert_equal_to_cycles(scene, folder, emission):
    expected, found = rendered(scene, folder), evaluated(emission)
    assert expected.std() > 0.0, "Cycles shows the same everywhere"
    # Where a step lies on a pixel's centre, rounding decides.
    wrong = np.abs(found - expected).max(axis=1) > 2e-4 * (1.0 + np.abs(expected).max(axis=1))
    first = wrong.argmax()
    assert wrong.mean() < 0.02, (wrong.mean(), found[first], expected[first])


def combined(tree, emission, outputs):
    """Link up to three numbers to the emission's colour, offset so that none is negative."""
    combine = tree.nodes.new("ShaderNodeCombineXYZ")
    lift = tree.nodes.new("ShaderNodeVectorMath")
    lift.inputs[1].default_value = (20.0,) * 3
    for output, socket in zip(outputs, combine.inputs):
        tree.links.new(output, socket)
    tree.links.new(combine.outputs[0], lift.inputs[0])
    tree.links.new(lift.outputs[0], emission.inputs["Color"])


def add(tree, kind, **settings):
    node = tree.nodes.new(f"ShaderNode{kind}")
    for name, value in settings.items():
        setattr(node, name, value)
    return node


def axes(tree, coordinates):
    separate = add(tree, "SeparateXYZ")
    tree.links.new(coordinates, separate.inputs[0])
    return separate.outputs
