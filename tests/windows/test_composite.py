# SPDX-License-Identifier: GPL-3.0-or-later
"""Composite over Cycles in Blender's window: what it follows, the panel's texts, the preview, its removal."""

import time

import numpy as np
import pytest
from PIL import Image

from tests.support.window import CLOSE, LONG, NEEDS_WINDOW, RENDERING

pytestmark = NEEDS_WINDOW

# A cube of fog, which every build's Cycles shows, in a collection that only an instance shows; the cloud out of sight.
STAGE = """
scene = bpy.data.scenes["Scene"]
scene.render.engine = "CYCLES"
cycles = scene.cycles
cycles.samples, cycles.preview_samples, cycles.use_denoising, cycles.use_preview_denoising = 4, 16, False, False
cycles.device = "CPU"
kept = bpy.data.collections.new("Kept")
corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
box = bpy.data.meshes.new("Box")
box.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
fog = bpy.data.materials.new("Fog"); fog.use_nodes = True
nodes = fog.node_tree.nodes; nodes.clear()
principled = nodes.new("ShaderNodeVolumePrincipled"); principled.inputs["Density"].default_value = 4
fog.node_tree.links.new(principled.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
box.materials.append(fog)
cube = bpy.data.objects.new("Cube of Fog", box)
kept.objects.link(cube)
shown = bpy.data.objects.new("Instance", None)
shown.instance_type, shown.instance_collection = "COLLECTION", kept
scene.collection.objects.link(shown)
bpy.data.objects["Ball"].location.x = -6
before = state()
"""
STATE = """
def state():
    scene = bpy.data.scenes["Scene"]
    tree = scene.compositing_node_group if bpy.app.version >= (5, 0, 0) else scene.use_nodes
    return (sorted(s.name for s in bpy.data.scenes), scene.render.engine, bool(tree), scene.render.use_compositing,
            sorted((c.name, sorted(o.name for o in c.objects)) for c in bpy.data.collections),
            sorted((o.name, o.visible_camera, o.visible_shadow, o.hide_render) for o in bpy.data.objects),
            [(v.name, v.use, v.use_pass_z) for v in scene.view_layers])
def volumes(): return bpy.data.scenes["Scene MRPNN"]
def said():
    import sys
    composite = next(m for n, m in sys.modules.items() if n.endswith("mrpnn.mrpnn_addon.output.composite"))
    return composite.out_of_date(bpy.data.scenes["Scene"])
"""


@pytest.fixture
def composited(window):
    window.do(STATE)
    window.do(STAGE)
    made = window.do("with over(area('VIEW_3D')): print(bpy.ops.mrpnn.composite())")
    assert made.endswith("{'FINISHED'}"), made
    yield window
    window.do(CLOSE)
    left = window.do(
        "win().scene = bpy.data.scenes['Scene']\n"
        "if scene.mrpnn_composite.active:\n"
        "    with over(area('VIEW_3D')): bpy.ops.mrpnn.composite_remove()\n"
        "for item in (shown, cube): bpy.data.objects.remove(item)\n"
        "bpy.data.collections.remove(kept)\n"
        "bpy.data.objects['Ball'].location.x = 0; scene.render.engine = 'MRPNN'; print('restored')"
    )
    assert left.endswith("restored"), left


def render(window, name):
    """F12, by the key: float (H, W, 3) in 0 to 255."""
    window.press("96")
    window.until(RENDERING)
    window.until(f"not {RENDERING}")
    window.shot(f"{name}-window")
    window.do(f"bpy.data.images['Render Result'].save_render(WORK + '/{name}.png')")
    window.do(CLOSE)
    window.until("len(bpy.context.window_manager.windows) == 1")
    with Image.open(window.work / f"{name}.png") as picture:
        return np.array(picture.convert("RGB"), float)


def test_f12_follows_changes_and_shows_instances(composited):
    window = composited
    window.do(
        "cut = bpy.data.objects.new('Cut', bpy.data.cameras.new('Cut')); cut.location.z = 7\n"
        "scene.collection.objects.link(cut); scene.camera = cut\n"
        "scene.render.resolution_x, scene.render.resolution_y = 200, 100\n"
        "scene.frame_end = 77; scene.view_layers.new('Further')"
    )
    window.until("volumes().render.resolution_x == 200 and volumes().frame_end == 77 and volumes().camera == cut")
    found = render(window, "composite-followed")
    # The cube of fog fills the middle, by MRPNN alone; nothing is beside it.
    assert found.shape == (100, 200, 3)
    assert found[50, 100].max() > 20 + found[5, 5].max()
    window.do("scene.render.film_transparent = True; win().scene = volumes()")
    window.do("with over(area('VIEW_3D')): bpy.ops.mrpnn.render()")
    window.do(
        "image = bpy.data.images['MRPNN']; image.save_render(WORK + '/composite-layer.png', scene=scene)\n"
        "win().scene = scene"
    )
    window.do(CLOSE)
    with Image.open(window.work / "composite-layer.png") as picture:
        alone = np.array(picture.convert("RGB"), float)
    # Where nothing shines through: files hold colours that are not multiplied by alpha.
    np.testing.assert_allclose(found[25:75, 75:125], alone[25:75, 75:125], atol=3.0)
    # A script that changes a setting and renders at once leaves no update in between.
    window.do(
        "scene.render.resolution_x = 160; scene.render.resolution_y = 120\n"
        "with over(area('VIEW_3D')): bpy.ops.render.render('INVOKE_DEFAULT')"
    )
    window.until(f"not {RENDERING}")
    window.do("bpy.data.images['Render Result'].save_render(WORK + '/composite-script.png')")
    window.do(CLOSE)
    with Image.open(window.work / "composite-script.png") as picture:
        found = np.array(picture.convert("RGB"), float)
    assert found.shape == (120, 160, 3) and found[60, 80].max() > 20 + found[5, 5].max()
    window.do(
        "scene.camera = bpy.data.objects['Camera']; bpy.data.objects.remove(cut)\n"
        "scene.view_layers.remove(scene.view_layers['Further']); scene.render.film_transparent = False"
    )
    assert "Traceback" not in window.console


def test_the_panel_states_what_is_composited_and_repairs_differences(composited):
    window = composited
    window.do("p = area('PROPERTIES').spaces.active; p.context = 'RENDER'; p.search_filter = 'Composite'")
    try:
        window.shot("panel-composited", window.box("PROPERTIES"))
        assert window.do("print(said())") == "[]"
        window.do("bpy.data.scenes.remove(volumes())")
        window.shot("panel-composite-broken", window.box("PROPERTIES"))
        assert "was deleted" in window.do("print(said())")
        window.do("with over(area('PROPERTIES')): bpy.ops.mrpnn.composite()")
        assert window.do("print(said())") == "[]"
        # Of the scene of the volumes.
        window.do("with over(area('PROPERTIES')): bpy.ops.mrpnn.show_scene(scene='Scene MRPNN')")
        assert window.do("print(win().scene.name)") == "Scene MRPNN"
        window.shot("panel-composite-volumes", window.box("PROPERTIES"))
        window.do("with over(area('PROPERTIES')): bpy.ops.mrpnn.composite_remove()")
        assert window.do("print(win().scene.name, state() == before)") == "Scene True"
    finally:
        window.do("p.search_filter = ''")
    assert "Traceback" not in window.console


def test_rendered_shading_by_cycles_still_shows_the_volumes(composited):
    window = composited
    window.do(
        "s = area('VIEW_3D').spaces.active; s.region_3d.view_perspective = 'CAMERA'\ns.overlay.show_overlays = False"
    )
    try:
        render(window, "composite-preview")
        left, top, right, bottom = window.box("VIEW_3D")
        window.do("s.shading.type = 'RENDERED'")
        start, middle, corner = time.monotonic(), 0, 0
        while not middle > corner + 10 and time.monotonic() - start < LONG:
            time.sleep(1.0)
            picture = window.shot("composite-viewport").astype(int)
            middle = picture[(top + bottom) // 2, (left + right) // 2].mean()
            corner = picture[bottom - 40, left + 60].mean()
        assert middle > corner + 10
    finally:
        window.do("s.shading.type = 'WIREFRAME'; s.overlay.show_overlays = True")
