# SPDX-License-Identifier: GPL-3.0-or-later
"""Operators that composite the volumes by MRPNN over the rest of the scene by Cycles."""

from typing import Any

import bpy
from bpy.props import BoolProperty, StringProperty

from ..mrpnn_addon.nodes.material import shows_volume
from ..mrpnn_addon.objects.animation import with_instanced
from ..mrpnn_addon.output.composite import composite, composite_state, remove_composite
from ..mrpnn_addon.runtime.text import report
from ..mrpnn_addon.scene.reader import NO_VOLUME
from ..mrpnn_addon.world.lighting import fog_warnings


class MRPNN_OT_composite(bpy.types.Operator):
    """Render this scene in Cycles, its volumes in a second scene with MRPNN, and put them together in the compositor.
    Surfaces hide the volumes behind them"""

    bl_idname = "mrpnn.composite"
    bl_label = "Composite over Cycles"
    bl_options = {"REGISTER", "UNDO"}

    shadows: BoolProperty(
        name="Shadows on Surfaces",
        default=True,
        description="Keep the volumes in Cycles, invisible to the camera, so that they cast shadows on surfaces",
    )

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return hasattr(context.scene, "cycles")

    def execute(self, context: "bpy.types.Context") -> set[str]:
        scene = context.scene
        surfaces = composite_state(scene).surfaces
        if surfaces is not None:
            report(self, "ERROR", f'this scene renders the volumes of scene "{surfaces.name}"; composite there')
            return {"CANCELLED"}
        if not any(shows_volume(shown) for shown in with_instanced(scene.collection.all_objects)):
            report(self, "ERROR", "; ".join([NO_VOLUME, *fog_warnings(scene.world)]))
            return {"CANCELLED"}
        try:
            composite(scene, self.shadows)
        except ValueError as error:
            report(self, "ERROR", error)
            return {"CANCELLED"}
        volumes = composite_state(scene).volumes
        report(self, "INFO", f'F12 renders the volumes of scene "{volumes.name}" over this one')
        return {"FINISHED"}


class MRPNN_OT_composite_remove(bpy.types.Operator):
    """Remove the compositor nodes and the scene of the volumes; the scene is rendered as before"""

    bl_idname = "mrpnn.composite_remove"
    bl_label = "Remove Composite"
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return _composited(context.scene) is not None

    def execute(self, context: "bpy.types.Context") -> set[str]:
        scene = _composited(context.scene)
        if context.window is not None:
            context.window.scene = scene
        remove_composite(scene)
        return {"FINISHED"}


class MRPNN_OT_show_scene(bpy.types.Operator):
    """Show the other scene of the composite in this window"""

    bl_idname = "mrpnn.show_scene"
    bl_label = "Go to Scene"
    bl_options = {"REGISTER", "UNDO"}

    scene: StringProperty(name="Scene")

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        return context.window is not None

    def execute(self, context: "bpy.types.Context") -> set[str]:
        found: Any = bpy.data.scenes.get(self.scene)
        if found is None:
            report(self, "ERROR", f'there is no scene "{self.scene}"')
            return {"CANCELLED"}
        context.window.scene = found
        return {"FINISHED"}


def _composited(scene: "bpy.types.Scene") -> "bpy.types.Scene | None":
    """The composited scene: this one, or the one whose volumes it renders; else None."""
    return scene if composite_state(scene).active else composite_state(scene).surfaces


classes = (MRPNN_OT_composite, MRPNN_OT_composite_remove, MRPNN_OT_show_scene)
