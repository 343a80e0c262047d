# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes that must give a message."""

import bpy

from ...support.shaders import add_shader
from .stage import cube_mesh


def world_fog(stage):
    tree = stage.scene.world.node_tree
    scatter = tree.nodes.new("ShaderNodeVolumeScatter")
    tree.links.new(scatter.outputs[0], tree.get_output_node("CYCLES").inputs["Volume"])


def linked_sun(stage):
    stage.sun.light_linking.blocker_collection = bpy.data.collections.new("Some")


def surface(stage):
    stage.link("Ground", cube_mesh())


def glass(stage):
    """Between the camera and the cloud."""
    shown = stage.link("Pane", cube_mesh(0.3))
    shown.location = (0.5, -2.0, 0.3)
    add_shader(shown.data, "Glass", "BsdfGlass", "Surface")


def panorama(stage):
    stage.camera.data.type = "PANO"


def layer_weight(stage):
    stage.connect(stage.node("LayerWeight").outputs["Facing"], stage.shader.inputs["Density"])


def varying_phase(stage):
    stage.connect(stage.grid(), stage.shader.inputs["Anisotropy"])


def missing_frame(stage):
    data = stage.cloud.data
    data.filepath, data.is_sequence, data.frame_duration = str(stage.folder / "gone_0001.vdb"), True, 3


NAMED = {
    "World volume": world_fog,
    "Shadow linking": linked_sun,
    "Opaque mesh": surface,
    "Glass": glass,
    "Panoramic camera": panorama,
    "Anisotropy that varies with the density": varying_phase,
    "Layer Weight in the density": layer_weight,
    "Missing frame of a sequence": missing_frame,
}
