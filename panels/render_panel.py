# SPDX-License-Identifier: GPL-3.0-or-later
"""Panels in the render properties, for every engine."""

from typing import Any

import bpy

from ..mrpnn_addon.comparison.results import rounded
from ..mrpnn_addon.engine.engine import MRPNNRenderEngine
from ..mrpnn_addon.output.composite import composite_state
from ..mrpnn_addon.runtime.text import duration, label
from ..mrpnn_addon.scene.changes import scene_state
from ..mrpnn_addon.scene.unrendered import Unrendered, in_composite, unrendered
from ..mrpnn_addon.settings.preferences import machine
from ..mrpnn_addon.settings.properties import scene_settings
from ..mrpnn_addon.status.forecast import Forecast, forecast
from ..mrpnn_addon.status.last_comparison import last_comparison
from ..mrpnn_addon.status.last_render import LastRender, last_render
from ..mrpnn_addon.status.scene_check import last_check
from ..operators.check import MRPNN_OT_check
from ..operators.compare import MRPNN_OT_compare
from ..operators.composite import MRPNN_OT_composite
from ..operators.documentation import MRPNN_OT_documentation
from ..operators.render import MRPNN_OT_render
from .text import draw_text

# Column titles by a comparison's clock.
TIMES = {"seconds": "Time", "cpu_seconds": "CPU"}
#: Share of the table's width for the names of methods.
METHODS = 0.6


class _RenderPanel:
    bl_space_type: Any = "PROPERTIES"
    bl_region_type: Any = "WINDOW"
    bl_context = "render"


def _split(layout: "bpy.types.UILayout") -> "bpy.types.UILayout":
    column = layout.column()
    column.use_property_split = True
    column.use_property_decorate = False
    return column


class MRPNN_PT_render(_RenderPanel, bpy.types.Panel):
    bl_label = "MRPNN Volumes"

    def draw(self, context: "bpy.types.Context") -> None:
        layout, settings = self.layout, scene_settings(context.scene)
        layout.operator(MRPNN_OT_render.bl_idname, icon="RENDER_STILL")
        layout.row().prop(settings, "preset", expand=True)
        # The name inside the field: beside it, the default width would truncate it.
        layout.prop(settings, "depth_samples")
        _draw_last(context, layout, last_render())


def _draw_last(context: "bpy.types.Context", layout: "bpy.types.UILayout", last: LastRender) -> None:
    """Time and warnings of the last render, or its error, without what Before Rendering shows."""
    if last is None:
        return
    if last.error:
        draw_text(context, layout.box(), last.error, "ERROR")
        return
    draw_text(context, layout, f"Last render: {last.seconds:.1f} s", "TIME")
    if last.expected_error:
        draw_text(context, layout, f"Expected error: {last.expected_error}", "DOT")
    _, missing = _expected(context)
    for warning in last.warnings:
        if not missing.names(warning):
            draw_text(context, layout, warning, "INFO")


class MRPNN_PT_forecast(_RenderPanel, bpy.types.Panel):
    bl_label = "Before Rendering"
    bl_parent_id = "MRPNN_PT_render"

    def draw(self, context: "bpy.types.Context") -> None:
        layout, scene = self.layout, context.scene
        expected, missing = _expected(context)
        if expected.problem:
            draw_text(context, layout, expected.problem, "ERROR")
        elif not expected.volumes + expected.empty:
            draw_text(context, layout, "The scene shows no volume; add one with Add > Volume", "ERROR")
        else:
            lights = [_number(expected.lamps, "light")] * (expected.lamps > 0) + ["World"] * expected.world
            draw_text(
                context,
                layout,
                f"{_number(expected.volumes, 'volume')}, {' + '.join(lights) or 'no light'}",
                "OUTLINER_DATA_VOLUME",
            )
            if not lights:
                draw_text(context, layout, "Only emission is visible; add a light with Add > Light", "INFO")
            else:
                about = "Roughly" if expected.rough else "About"
                draw_text(context, layout, f"{about} {duration(expected.seconds)}", "TIME")
        check = last_check()
        if missing.surfaces and not in_composite(scene):
            # Check Scene tells more about them.
            if check is None or check.outdated(scene) or not any(map(missing.names, check.warnings)):
                for sentence in filter(None, (missing.sentence, missing.fog)):
                    draw_text(context, layout, sentence, "INFO")
            layout.operator(MRPNN_OT_composite.bl_idname)
        row = layout.row(align=True)
        row.operator(MRPNN_OT_check.bl_idname, icon="VIEWZOOM")
        row.operator(MRPNN_OT_documentation.bl_idname, icon="HELP", text="")
        if check is None:
            for warning in expected.warnings:
                draw_text(context, layout, warning, "INFO")
            return
        column = layout.column()
        column.active = not check.outdated(scene)
        if check.outdated(scene):
            draw_text(context, column, "The scene has changed since:", "FILE_REFRESH")
        if check.error:
            draw_text(context, column, check.error, "ERROR")
            return
        for text in check.warnings:
            draw_text(context, column, text, "INFO")
        if not check.warnings:
            draw_text(context, column, "Everything in the scene is rendered", "CHECKMARK")


class MRPNN_PT_plan(_RenderPanel, bpy.types.Panel):
    bl_label = "Details"
    bl_parent_id = "MRPNN_PT_forecast"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        check = last_check()
        return check is not None and not check.error

    def draw(self, context: "bpy.types.Context") -> None:
        check, column = last_check(), self.layout.column()
        column.active = not check.outdated(context.scene)
        draw_text(context, column, f"{check.memory / 2**30:.1f} GiB of memory", "MEMORY")
        for text in check.planned:
            draw_text(context, column, text, "DOT")
        if check.left_out:
            column.label(text="Not needed for this picture:")
        for text in check.left_out:
            draw_text(context, column, text, "DOT")


# Cache of the last forecast and unrendered objects: panels are redrawn whenever the pointer moves.
_forecasts: dict[str, Any] = {}


def _expected(context: "bpy.types.Context") -> tuple[Forecast, Unrendered]:
    key = (context.view_layer.name, last_render(), last_check(), *scene_state(context.scene))
    if _forecasts.get("key") != key:
        depsgraph = context.evaluated_depsgraph_get()
        value = forecast(depsgraph), unrendered(depsgraph)
        # Evaluating the scene counts as a change.
        _forecasts.update(key=(*key[:3], *scene_state(context.scene)), value=value)
    return _forecasts["value"]


def _number(count: int, noun: str) -> str:
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


class MRPNN_PT_film(_RenderPanel, bpy.types.Panel):
    bl_label = "Film"
    bl_parent_id = "MRPNN_PT_render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: "bpy.types.Context") -> None:
        column = _split(self.layout)
        if hasattr(context.scene, "cycles"):
            column.prop(context.scene.cycles, "film_exposure", text="Exposure")
        column = column.column()
        # Render Volumes shows the layer alone, without what is behind it.
        column.active = context.engine == MRPNNRenderEngine.bl_idname
        column.prop(context.scene.render, "film_transparent", text="Transparent")


class MRPNN_PT_blur(_RenderPanel, bpy.types.Panel):
    bl_label = "Blur"
    bl_parent_id = "MRPNN_PT_render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: "bpy.types.Context") -> None:
        settings, column = scene_settings(context.scene), _split(self.layout)
        column.prop(settings, "blur_rays")
        column.prop(settings, "viewport_blur")


class MRPNN_PT_motion_blur(_RenderPanel, bpy.types.Panel):
    bl_label = "Motion Blur"
    bl_parent_id = "MRPNN_PT_render"
    bl_options = {"DEFAULT_CLOSED"}

    @classmethod
    def poll(cls, context: "bpy.types.Context") -> bool:
        """Other engines have a panel of their own for it."""
        return context.engine == MRPNNRenderEngine.bl_idname

    def draw_header(self, context: "bpy.types.Context") -> None:
        self.layout.prop(context.scene.render, "use_motion_blur", text="")

    def draw(self, context: "bpy.types.Context") -> None:
        render, column = context.scene.render, _split(self.layout)
        column.active = render.use_motion_blur
        owner = render if hasattr(render, "motion_blur_position") else context.scene.cycles
        # The names of this and of others below are too long for the default width.
        column.prop(owner, "motion_blur_position", text="Position")
        column.prop(render, "motion_blur_shutter")
        self.layout.template_curve_mapping(render, "motion_blur_shutter_curve")


class MRPNN_PT_performance(_RenderPanel, bpy.types.Panel):
    bl_label = "Performance"
    bl_parent_id = "MRPNN_PT_render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: "bpy.types.Context") -> None:
        settings, preferred, column = scene_settings(context.scene), machine(), _split(self.layout)
        column.prop(settings, "threads")
        if not settings.threads:
            _draw_preferred(context, column, str(preferred.threads or "one per core"))
        column.prop(settings, "memory_limit", text="Memory (GiB)")
        if not settings.memory_limit:
            _draw_preferred(context, column, f"{preferred.memory_limit} GiB")
        column.prop(context.scene.render, "preview_pixel_size", text="Pixel Size")


def _draw_preferred(context: "bpy.types.Context", layout: "bpy.types.UILayout", value: str) -> None:
    """The value that 0 in the setting above stands for."""
    draw_text(context, layout, f"Preferences: {value}")


class MRPNN_PT_advanced(_RenderPanel, bpy.types.Panel):
    bl_label = "Advanced"
    bl_parent_id = "MRPNN_PT_render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: "bpy.types.Context") -> None:
        column = _split(self.layout)
        column.prop(scene_settings(context.scene), "seed")
        column.prop(scene_settings(context.scene), "model")


class MRPNN_PT_optimizations(_RenderPanel, bpy.types.Panel):
    bl_label = "Optimizations"
    bl_parent_id = "MRPNN_PT_advanced"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: "bpy.types.Context") -> None:
        self.layout.column(align=True).prop(scene_settings(context.scene), "optimizations")


class MRPNN_PT_exr(_RenderPanel, bpy.types.Panel):
    bl_label = "Write EXR"
    bl_parent_id = "MRPNN_PT_render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw_header(self, context: "bpy.types.Context") -> None:
        self.layout.prop(scene_settings(context.scene), "use_exr", text="")

    def draw(self, context: "bpy.types.Context") -> None:
        column = _split(self.layout)
        column.active = scene_settings(context.scene).use_exr
        column.prop(scene_settings(context.scene), "exr_path", text="File")
        _split(self.layout).prop(scene_settings(context.scene), "use_deep")


class MRPNN_PT_cycles(_RenderPanel, bpy.types.Panel):
    bl_label = "With Cycles"
    bl_parent_id = "MRPNN_PT_render"
    bl_options = {"DEFAULT_CLOSED"}

    def draw(self, context: "bpy.types.Context") -> None:
        column = self.layout.column()
        # Cycles' properties exist while Cycles is enabled.
        column.enabled = hasattr(context.scene, "cycles")
        column.operator(MRPNN_OT_compare.bl_idname)
        # An existing composite has its own panel below.
        if not (composite_state(context.scene).active or composite_state(context.scene).surfaces):
            column.operator(MRPNN_OT_composite.bl_idname)
        _draw_comparison(context, self.layout, last_comparison())


def _seconds(value: float) -> str:
    """Short enough for its column."""
    return f"{rounded(value)} s" if value >= 0.1 else f"{value:.2f} s"


def _draw_comparison(context: "bpy.types.Context", layout: "bpy.types.UILayout", last: Any) -> None:
    """The last comparison's table."""
    if last is None:
        return
    comparison, page = last
    box = layout.box()
    table = box.column(align=True)
    rows = [
        (f"{rung.samples}, {rung.method}", _seconds(getattr(rung, comparison.clock)), f"{rung.error:.3f}")
        for rung in comparison.rungs
    ]
    for method, *figures in [("Samples", TIMES[comparison.clock], "Error"), *rows]:
        # Columns of one width would truncate the methods.
        row = table.split(factor=METHODS)
        label(row, method)
        for figure in figures:
            label(row, figure)
    for sentence in (*comparison.sentences(), *comparison.marks):
        draw_text(context, box, sentence, "INFO")
    if not comparison.verdict.good:
        draw_text(context, box, f"The reference is {comparison.verdict}", "ERROR")
    box.operator("wm.url_open", text="Open Report", icon="URL").url = page.as_uri()


classes = (
    MRPNN_PT_render,
    MRPNN_PT_forecast,
    MRPNN_PT_plan,
    MRPNN_PT_film,
    MRPNN_PT_blur,
    MRPNN_PT_motion_blur,
    MRPNN_PT_performance,
    MRPNN_PT_exr,
    MRPNN_PT_cycles,
    MRPNN_PT_advanced,
    MRPNN_PT_optimizations,
)
