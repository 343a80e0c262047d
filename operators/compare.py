"""Operator `mrpnn.compare`: the layer against Cycles on the same view."""

import os
from contextlib import contextmanager
from dataclasses import replace
from typing import Tuple

import bpy
import numpy as np
from bpy.props import IntProperty, StringProperty

from ..inference.layer import Layer
from ..inference.scene import SceneError
from ..mrpnn_addon.comparison import Comparison, compare
from ..mrpnn_addon.cycles_reference import render_reference, volumes_and_suns
from ..mrpnn_addon.layer_image import IMAGE_NAME, show_in_image
from ..mrpnn_addon.render_job import render_scene
from ..mrpnn_addon.scene import read_scene

REFERENCE_IMAGE = f"{IMAGE_NAME} Cycles"
ERROR_IMAGE = f"{IMAGE_NAME} error"
TEXT_NAME = f"{IMAGE_NAME} comparison"


class MRPNN_OT_compare(bpy.types.Operator):
    """Render the view twice in Cycles with every bounce, and measure the layer against it.
    Blender does not respond meanwhile"""

    bl_idname = "mrpnn.compare"
    bl_label = "Compare with Cycles"

    samples: IntProperty(
        name="Cycles Samples", default=32, min=1, max=65536,
        description="Samples a pixel in each of the two Cycles renders")
    bounces: IntProperty(
        name="Bounces", default=1024, min=1, max=1024,
        description="Most scattering events along a path in Cycles")
    scale: IntProperty(
        name="Size", default=25, min=1, max=100, subtype='PERCENTAGE',
        description="Size of the comparison, of the render resolution; Cycles' time goes with its square")
    json_path: StringProperty(
        name="JSON File", subtype='FILE_PATH', options={'SKIP_SAVE'},
        description="File for all figures; none by default")

    def invoke(self, context, event):
        if bpy.app.background:
            return self.execute(context)
        return context.window_manager.invoke_props_dialog(self)

    def execute(self, context):
        manager = context.window_manager
        manager.progress_begin(0, 100)
        try:
            with scaled(context.scene, self.scale):
                comparison, layer, cycles = measure(
                    context, context.scene.mrpnn.settings(), self.samples, self.bounces,
                    lambda done, text: manager.progress_update(int(100 * done)))
            _show(layer, cycles)
            if self.json_path:
                comparison.write_json(_absolute(self.json_path))
        except (SceneError, OSError) as error:
            self.report({'ERROR'}, str(error))
            return {'CANCELLED'}
        finally:
            manager.progress_end()
        _keep_as_text(comparison.table())
        for warning in comparison.warnings:
            self.report({'WARNING'}, warning)
        self.report({'INFO'}, comparison.table())
        return {'FINISHED'}


def measure(context, settings, samples: int, bounces: int, progress) -> Tuple[Comparison, Layer, np.ndarray]:
    """The comparison at the scene's resolution; the layer; Cycles' image, float32 (H, W, 4), rows from the top.

    progress: called with (fraction, message).
    """
    depsgraph = context.evaluated_depsgraph_get()
    # The layer and Cycles' image both have the region's size.
    description = replace(read_scene(depsgraph), crop=True)
    objects = volumes_and_suns(depsgraph)
    finished = render_scene(description, settings)
    progress(0.1, "rendering the reference")
    reference = render_reference(context.scene, objects, samples, bounces,
                                 progress=lambda done, text: progress(0.1 + 0.9 * done, text),
                                 world=context.scene.world if description.environment else None)
    comparison = compare(finished.layer, finished.seconds, reference, finished.warnings)
    return comparison, finished.layer, (reference.a + reference.b) / 2


def _show(layer: Layer, cycles: np.ndarray) -> None:
    """Leave the layer, Cycles' image and their difference as images."""
    show_in_image(layer)
    show_in_image(replace(layer, rgb=cycles[..., :3], alpha=cycles[..., 3]), REFERENCE_IMAGE)
    show_in_image(replace(layer, rgb=layer.rgb - cycles[..., :3]), ERROR_IMAGE)


@contextmanager
def scaled(scene, percentage: int):
    """The scene at a part of its resolution; as it was afterwards."""
    before = scene.render.resolution_percentage
    scene.render.resolution_percentage = max(1, before * percentage // 100)
    try:
        yield
    finally:
        scene.render.resolution_percentage = before


def _absolute(path: str) -> str:
    path = bpy.path.abspath(path)
    if not os.path.isabs(path):
        raise SceneError(f"the JSON file {path} lies beside the .blend file, which is not saved yet; "
                         "save it, or enter a full path")
    return path


def _keep_as_text(table: str) -> None:
    """Put the table into the Text data-block that shows it in Blender's text editor."""
    text = bpy.data.texts.get(TEXT_NAME) or bpy.data.texts.new(TEXT_NAME)
    text.clear()
    text.write(table + "\n")


classes = (MRPNN_OT_compare,)
