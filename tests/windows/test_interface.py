# SPDX-License-Identifier: GPL-3.0-or-later
"""With the engine chosen, Blender's window offers what an artist needs for volumes: once, in texts that fit."""

import time

import numpy as np
import pytest

from tests.support.window import NEEDS_WINDOW, RENDERING, THREADS

pytestmark = NEEDS_WINDOW

# The panels that a tab shows for an object: (label, label of the panel around it).
PANELS = """
def show(tab, name):
    bpy.context.view_layer.objects.active = bpy.data.objects[name]
    for item in bpy.context.view_layer.objects: item.select_set(item.name == name)
    area("PROPERTIES").spaces.active.context = tab
    area("PROPERTIES").tag_redraw()
def polled(panel):
    # Some of Cycles' fail where their panel is not the tab's, as where no light is shown.
    try: return not hasattr(panel, "poll") or panel.poll(bpy.context)
    except AttributeError: return False
def panels(tab, engine):
    # The other engine for a moment only: Blender hangs where Python changes the engine during one of Cycles' previews.
    scene.render.engine = engine
    try: return panels_of(tab)
    finally: scene.render.engine = "MRPNN"
def panels_of(tab):
    with over(area("PROPERTIES")):
        found = {}
        for panel in bpy.types.Panel.__subclasses__():
            place = getattr(panel, "bl_space_type", ""), getattr(panel, "bl_context", "")
            if place == ("PROPERTIES", tab.lower()) and polled(panel):
                found[getattr(panel, "bl_idname", panel.__name__)] = panel
    def label(name):
        return getattr(found[name], "bl_label", "") if name in found else None
    return [(label(name), label(around) if around else "") for name, panel in found.items()
            for around in [getattr(panel, "bl_parent_id", "")] if not around or around in found]
lamps = {kind: bpy.data.objects.new(kind, bpy.data.lights.new(kind, kind)) for kind in ("POINT", "SPOT", "AREA")}
for lamp in lamps.values(): scene.collection.objects.link(lamp)
cube = bpy.data.meshes.new("Cube"); cube.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
scene.collection.objects.link(bpy.data.objects.new("Cube", cube))
for name in ("Ball", "Cube"):
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0): material.use_nodes = True
    bpy.data.objects[name].data.materials.append(material)
"""
NO_PANELS = """
for name in ("POINT", "SPOT", "AREA", "Cube"):
    bpy.data.objects.remove(bpy.data.objects[name])
for material in list(bpy.data.materials): bpy.data.materials.remove(material)
"""
TABS = [
    ("RENDER", "Ball"),
    ("OUTPUT", "Ball"),
    ("VIEW_LAYER", "Ball"),
    ("SCENE", "Ball"),
    ("WORLD", "Ball"),
    *(("OBJECT", name) for name in ("Ball", "Cube", "Sun", "Camera")),
    *(("DATA", name) for name in ("Ball", "Cube", "Sun", "POINT", "SPOT", "AREA", "Camera")),
    ("MATERIAL", "Ball"),
    ("MATERIAL", "Cube"),
]
# What Cycles does and this engine does not, or has in its own panel.
CYCLES_ONLY = {
    "RENDER": {
        "Sampling",
        "Light Paths",
        "Volumes",
        "Curves",
        "Subdivision",
        "Motion Blur",
        "Film",
        "Performance",
        "Bake",
        "Freestyle",
        "Debug",
    },
    "VIEW_LAYER": {"Override"},
    "WORLD": {"Preview", "Volume", "Settings"},
    "OBJECT": {"Shading", "Motion Blur"},
    "DATA": {"Preview", "Settings", "Depth of Field"},
    "MATERIAL": {"Preview", "Displacement", "Settings"},
}


@pytest.fixture(scope="module")
def artist(window):
    window.do("scene = bpy.context.scene")
    window.do(PANELS)
    yield window
    window.do(NO_PANELS)


def panels(window, tab, name, engine="MRPNN"):
    """Panels of a tab, after the editor has been drawn: only then does it know its tabs."""
    for place in ("OBJECT", tab):
        window.do(f"show('{place}', '{name}')")
        time.sleep(0.3)
    return eval(window.do(f"print(panels('{tab}', '{engine}'))"))


def test_each_tab_has_the_volume_panels_of_cycles_once(artist):
    before = artist.console
    for tab, name in TABS:
        theirs, ours = panels(artist, tab, name, "CYCLES"), panels(artist, tab, name)
        assert len(set(ours)) == len(ours), (tab, name, ours)
        missing = {label for label, around in theirs if not around} - {label for label, _ in ours}
        assert missing <= CYCLES_ONLY.get(tab, set()), (tab, name, missing)
    assert artist.console == before


def test_shaders_and_lights_are_edited_in_one_panel_each(artist):
    lamps = [("DATA", lamp, "Light") for lamp in ("Sun", "POINT", "SPOT", "AREA")]
    shaders = [("WORLD", "Ball", "Surface"), ("MATERIAL", "Ball", "Surface"), ("MATERIAL", "Ball", "Volume")]
    for tab, name, wanted in shaders + lamps:
        labels = [label for label, _ in panels(artist, tab, name)]
        assert labels.count(wanted) == 1, (tab, name, labels)
    assert ("Beam Shape", "Light") in panels(artist, "DATA", "SPOT")
    assert ("Ray Visibility", "Visibility") in panels(artist, "OBJECT", "Ball")


def test_a_panorama_can_be_chosen(artist):
    artist.do("scene.camera.data.type = 'PANO'")
    try:
        assert ("Panorama", "Lens") in panels(artist, "DATA", "Camera")
        artist.shot("panel-panorama", artist.box("PROPERTIES"))
    finally:
        artist.do("scene.camera.data.type = 'PERSP'")


@pytest.mark.parametrize(
    "kind, tree", [("OBJECT", "bpy.data.materials['Ball'].node_tree"), ("WORLD", "world.node_tree")]
)
def test_the_shader_editor_shows_the_nodes(artist, kind, tree):
    artist.do("world = scene.world; show('OBJECT', 'Ball'); viewport = area('VIEW_3D')")
    try:
        artist.do("viewport.ui_type = 'ShaderNodeTree'")
        assert artist.do("print(viewport.ui_type)") == "ShaderNodeTree"
        artist.do(f"viewport.spaces.active.shader_type = '{kind}'; viewport.tag_redraw()")
        artist.until(f"viewport.spaces.active.edit_tree == {tree}")
        artist.do("with over(viewport): bpy.ops.node.view_all()")
        left, top, right, bottom = artist.box("NODE_EDITOR")
        shown = artist.shot(f"shader-editor-{kind.lower()}")[top + 60 : bottom - 20, left + 20 : right - 20]
        # Nodes, brighter than the grid.
        assert (shown.max(axis=2) > 200).sum() > 500
    finally:
        artist.do("viewport.ui_type = 'VIEW_3D'")


# Letters wrapped as sentences are: a line that is cut off ends in dots.
LETTERS = """
import sys
text = next(module for name, module in sys.modules.items() if name.endswith("mrpnn.panels.text"))
class MRPNN_PT_letters(bpy.types.Panel):
    bl_label, bl_space_type, bl_region_type, bl_context, bl_order = "Letters", "PROPERTIES", "WINDOW", "world", -1
    def draw(self, context):
        text.draw_text(context, self.layout, "H " * 60, "INFO")
        text.draw_text(context, self.layout.box(), "H " * 60, "INFO")
bpy.utils.register_class(MRPNN_PT_letters)
"""


@pytest.mark.newest
def test_sentences_are_wrapped_at_the_width_of_the_editor(artist):
    artist.do(LETTERS)
    try:
        panels(artist, "WORLD", "Ball")
        left, top, right, bottom = artist.box("PROPERTIES")
        rows = artist.shot("letters")[top:bottom, left:right].min(axis=2) > 150
    finally:
        artist.do("bpy.utils.unregister_class(MRPNN_PT_letters)")
    rows = rows[:, 68:]
    lines, full, widest = np.flatnonzero(rows.sum(axis=1) > 20), 0, 0
    for line in np.split(lines, np.flatnonzero(np.diff(lines) > 1) + 1):
        lit = rows[line[0] : line[-1] + 1]
        tall = np.flatnonzero(lit.sum(axis=0) >= 7)
        # Full lines: an H has two tall columns. Nothing, such as three dots, comes after the last one.
        if np.count_nonzero(np.diff(tall) > 1) > 20:
            assert not lit[:, tall[-1] + 2 : tall[-1] + 14].any()
            full, widest = full + 1, max(widest, np.ptp(tall))
    assert full >= 6
    assert widest > 0.55 * (right - left)


@pytest.mark.newest
def test_memory_shows_its_unit(artist):
    artist.do("own = next(name for name in bpy.context.preferences.addons.keys() if name.endswith('.mrpnn'))")
    for owner in ("scene.mrpnn", "bpy.context.preferences.addons[own].preferences"):
        assert "GiB" in artist.do(f"print({owner}.bl_rna.properties['memory_limit'].name)")


def test_the_comparison_dialog_draws_without_console_output(artist):
    artist.mouse("mousemove", 600, 400)
    without, before = artist.shot("no-dialog").astype(int), artist.console
    artist.do("with over(area('VIEW_3D')): bpy.ops.mrpnn.compare('INVOKE_DEFAULT')")
    dialog = artist.shot("compare-settings").astype(int)
    artist.press("Escape")
    rows = np.flatnonzero((np.abs(dialog - without).max(axis=2) > 20).sum(axis=1) > 100)
    # Samples, time and size; the other settings would take as much again.
    assert 100 < np.ptp(rows) < 250
    assert artist.console == before


# As File > New > General and Add > Volume > Import OpenVDB leave it, but few pixels, and a viewport that is soon drawn.
DEFAULT = """
bpy.ops.wm.read_homefile(app_template="")
scene = bpy.context.scene
with over(area("VIEW_3D")):
    bpy.ops.object.volume_import(filepath=WORK + "/window.vdb", directory=WORK, files=[{"name": "window.vdb"}])
scene.render.engine = "MRPNN"; scene.render.resolution_percentage = 5
scene.mrpnn.depth_samples = 1; scene.render.preview_pixel_size = "4"
area("VIEW_3D").spaces.active.shading.type = "WIREFRAME"
area("PROPERTIES").spaces.active.context = "RENDER"
"""
# What the viewport says of what it shows.
STATUS = "[found.status for found in gc.get_objects() if type(found).__name__ == 'Viewport' and found.description]"


def test_the_default_scene_names_what_is_not_rendered(window):
    """In the panel without a click, in the viewport, and once in a render's reports."""
    window.do(DEFAULT)
    try:
        window.do(
            "import gc, sys, threading\n"
            "own = lambda name: next(m for n, m in sys.modules.items() if n.endswith('.mrpnn.' + name))\n"
            "missing = own('mrpnn_addon.scene.unrendered').unrendered(bpy.context.evaluated_depsgraph_get())"
        )
        assert window.do("print(missing.summary)") == 'Not rendered: surface "Cube"'
        window.shot("default-scene-panel", window.box("PROPERTIES"))
        window.do("area('VIEW_3D').spaces.active.shading.type = 'RENDERED'")
        window.until(f"any(missing.summary in status for status in {STATUS})")
        window.until(f"not {THREADS}")
        window.shot("default-scene-viewport")
        window.do("area('VIEW_3D').spaces.active.shading.type = 'WIREFRAME'")
        window.press("96")
        window.until(RENDERING)
        window.until(f"not {RENDERING}")
        # Reports are told with the next event.
        for place in ((400, 700), (300, 720), (1100, 520)):
            window.mouse("mousemove", *place)
            time.sleep(1.0)
        window.shot("default-scene-render")
        window.do(
            "for other in [one for one in bpy.context.window_manager.windows if one.screen.is_temporary]:\n"
            "    with bpy.context.temp_override(window=other): bpy.ops.wm.window_close()\n"
            "area('VIEW_3D').type = 'INFO'"
        )
        window.do(
            "with over(area('INFO')):\n"
            "    bpy.ops.info.select_all(action='SELECT'); bpy.ops.info.report_copy()\n"
            "said = bpy.context.window_manager.clipboard"
        )
        said = window.do("print(said)")
        (told,) = [line for line in said.splitlines() if '"Cube"' in line]
        assert 'mesh object "Cube" only hides' in told and "Composite over Cycles renders it" in told
        assert '"Light"' not in said
    finally:
        window.do("bpy.ops.wm.open_mainfile(filepath=WORK + '/window.blend')")
        window.until(f"not {THREADS}")


# Names of data that panels show, each with two bytes that are not UTF-8, as other programs may write them.
ODD_NAMES = """
for data in (scene, scene.world, scene.view_layers[0], bpy.data.objects["Ball"], bpy.data.objects["Sun"],
             bpy.data.objects["Camera"], bpy.data.volumes["Ball"], bpy.data.lights["Sun"]):
    data.name = data.name + "QQ"
bpy.ops.wm.save_as_mainfile(filepath=WORK + "/odd.blend", copy=True, compress=False)
content = open(WORK + "/odd.blend", "rb").read()
open(WORK + "/odd.blend", "wb").write(content.replace(b"QQ", bytes((255, 254))))
bpy.ops.wm.open_mainfile(filepath=WORK + "/odd.blend")
scene = bpy.context.scene
print(scene.render.engine)
"""


@pytest.mark.newest
def test_panels_show_names_that_are_not_utf8(window):
    """In place of a traceback on the console at every redraw."""
    window.do("bpy.ops.wm.open_mainfile(filepath=WORK + '/window.blend')\nscene = bpy.context.scene")
    before = len(window.console)
    try:
        assert window.do(ODD_NAMES).endswith("MRPNN")
        for kind, tabs in (
            ("VOLUME", ("OBJECT", "DATA", "RENDER", "VIEW_LAYER", "WORLD")),
            ("LIGHT", ("OBJECT", "DATA")),
            ("CAMERA", ("OBJECT", "DATA")),
        ):
            window.do(
                f"shown = next(item for item in scene.objects if item.type == '{kind}')\n"
                "bpy.context.view_layer.objects.active = shown"
            )
            for tab in tabs:
                window.do(f"area('PROPERTIES').spaces.active.context = '{tab}'")
                window.shot(f"odd-names-{tab.lower()}", window.box("PROPERTIES"))
        said = window.console[before:]
        # Blender's own panels may fail; what this extension draws may not.
        assert "mrpnn" not in said.lower() and "UnicodeDecodeError" not in said, said
    finally:
        window.do("bpy.ops.wm.open_mainfile(filepath=WORK + '/window.blend')")
        window.until(f"not {THREADS}")
