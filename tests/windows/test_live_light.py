# SPDX-License-Identifier: GPL-3.0-or-later
"""Live Light in Blender's window: EEVEE's viewport follows a sun that turns, without waits and without undo steps."""

import time

import pytest

from tests.support.window import LONG, NEEDS_WINDOW, RENDERING

pytestmark = NEEDS_WINDOW

# Where EEVEE shows the light from the camera. Its shader without other directions compiles at once.
EEVEE = """
import sys, time, threading
scene = bpy.context.scene
names = [item.identifier for item in scene.render.bl_rna.properties["engine"].enum_items]
scene.render.engine = "BLENDER_EEVEE_NEXT" if bpy.app.version < (5, 0, 0) else "BLENDER_EEVEE"
space = area("VIEW_3D").spaces.active
space.shading.type, space.overlay.show_overlays = "RENDERED", False
space.shading.use_scene_lights_render = space.shading.use_scene_world_render = True
space.region_3d.view_perspective = "CAMERA"
live = next(module for name, module in sys.modules.items() if name.endswith("baking.live"))
live_scene = next(module for name, module in sys.modules.items() if name.endswith("baking.live_scene"))
LONGEST = [0.0]
def timed(self, context, advance=live_scene.LiveScene._advance):
    start = time.perf_counter()
    advance(self, context)
    LONGEST[0] = max(LONGEST[0], time.perf_counter() - start)
live_scene.LiveScene._advance = timed
scene.mrpnn_light.directional = False
scene.mrpnn_live_light = True
dense = bpy.data.materials.get("Dense") or bpy.data.materials.new("Dense")
dense.use_nodes = True
dense.node_tree.nodes.clear()
fog = dense.node_tree.nodes.new("ShaderNodeVolumePrincipled")
fog.inputs["Density"].default_value = 4.0
fog.inputs["Color"].default_value = 0.9, 0.9, 0.9, 1
dense.node_tree.links.new(fog.outputs[0], dense.node_tree.nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
bpy.data.volumes["Ball"].materials.clear()
bpy.data.volumes["Ball"].materials.append(dense)
bpy.data.lights["Sun"].energy = 2
def turn(angle):
    bpy.data.objects["Sun"].rotation_euler = 0, angle, 0
"""
LIGHTS = "[o for o in bpy.data.objects if 'mrpnn_light' in o]"
BAKING = "[t for t in threading.enumerate() if t.name == 'mrpnn bake']"
UP_TO_DATE = f"'up to date' in live.live_status(bpy.context.scene)[0] and not {BAKING}"
KEY = "bpy.context.scene.mrpnn_light.volumes[0].key"


@pytest.fixture
def lit(window):
    window.do(EEVEE)
    window.until(f"len({LIGHTS}) == 1 and {UP_TO_DATE}")
    yield window
    window.do(
        "area('VIEW_3D').spaces.active.shading.type = 'WIREFRAME'\n"
        "with over(area('VIEW_3D')):\n"
        "    if bpy.context.scene.mrpnn_light.active: bpy.ops.mrpnn.bake_light_remove()\n"
        "bpy.context.scene.render.engine = 'MRPNN'"
    )


def turned(window, angle):
    """Turn the sun; waits until the final light is shown, and gives the seconds until there was a coarse one."""
    before = window.do(f"print({KEY})")
    window.do(f"turn({angle})")
    start, coarse = time.monotonic(), None
    while True:
        key, done = window.do(f"print({KEY}, bool({UP_TO_DATE}))").split()
        if coarse is None and key != before:
            coarse = time.monotonic() - start
        if coarse is not None and done == "True" and not key.endswith("-coarse"):
            return coarse
        assert time.monotonic() - start < LONG
        time.sleep(0.05)


def right_over_left(window, name):
    """Brightness of the cloud's right over that of its left."""
    screen = window.shot(name).astype(float)
    left, top, right, bottom = window.box("VIEW_3D")
    x, y = (left + right) // 2, (top + bottom) // 2
    return screen[y - 40 : y + 40, x + 20 : x + 80].mean() / screen[y - 40 : y + 40, x - 80 : x - 20].mean()


def test_light_follows_the_sun(lit):
    turned(lit, 1.4)
    before = right_over_left(lit, "live-right")
    seconds = turned(lit, -1.4)
    assert right_over_left(lit, "live-left") < before / 1.1
    # Without a graphics card, drawing takes most of the time.
    assert seconds < 10.0
    assert float(lit.do("print(LONGEST[0])")) < 0.5


def test_updates_add_no_undo_steps(lit):
    lit.do("bpy.ops.ed.undo_push(message='Before'); turn(0.4); bpy.ops.ed.undo_push(message='Turned')")
    lit.until(UP_TO_DATE)
    turned(lit, 1.0)
    with_undo = "with over(area('VIEW_3D')): bpy.ops.ed.undo()"
    lit.do(with_undo)
    assert (
        lit.do("import os; print(all(os.path.exists(bpy.path.abspath(o.data.filepath)) for o in " + LIGHTS + "))")
        == "True"
    )
    lit.until(UP_TO_DATE)
    assert lit.do(f"print(len({LIGHTS}))") == "1"


def test_light_comes_back_with_redo_and_is_saved_with_the_file(lit):
    lit.do("bpy.ops.ed.undo_push(message='Before'); turn(0.2); bpy.ops.ed.undo_push(message='Turned')")
    lit.until(UP_TO_DATE)
    keys = [lit.do(f"print({KEY})")]
    for step in ("undo", "redo"):
        lit.do(f"with over(area('VIEW_3D')): bpy.ops.ed.{step}()")
        lit.until(UP_TO_DATE)
        keys.append(lit.do(f"print({KEY})"))
    assert keys[0] == keys[2] != keys[1]
    lit.do("bpy.ops.wm.save_mainfile()")
    lit.until(UP_TO_DATE)
    saved = f"[bpy.path.abspath(o.data.filepath) for o in {LIGHTS}]"
    assert (
        lit.do(
            f"import os; print([os.path.dirname(f) == WORK + '/baked_light' and os.path.exists(f) for f in {saved}])"
        )
        == "[True]"
    )
    turned(lit, 0.7)


def test_each_of_two_windows_shows_its_scene(lit):
    lit.do(
        "with over(area('VIEW_3D')): bpy.ops.wm.window_new_main()\n"
        "with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]):\n"
        "    bpy.ops.scene.new(type='FULL_COPY')\n"
        "first, second = (one.scene for one in bpy.context.window_manager.windows)"
    )
    try:
        assert lit.do("print(first != second and second.mrpnn_live_light)") == "True"
        both = f"all('up to date' in live.live_status(one)[0] for one in (first, second)) and not {BAKING}"
        lit.until(both)
        keys = "print(*(one.mrpnn_light.volumes[0].key for one in (first, second)))"
        before = lit.do(keys).split()
        lit.do("next(o for o in second.objects if o.type == 'LIGHT').rotation_euler = 0, -1.0, 0")
        lit.until(f"second.mrpnn_light.volumes[0].key not in ('{before[1]}', '{before[1]}-coarse') and {both}")
        assert lit.do(keys).split()[0] == before[0]
        counts = "print(*(sum('mrpnn_light' in o for o in one.objects) for one in (first, second)))"
        assert lit.do(counts) == "1 1"
    finally:
        lit.do(
            "second.mrpnn_live_light = False\n"
            "with bpy.context.temp_override(window=bpy.context.window_manager.windows[-1]): bpy.ops.wm.window_close()\n"
            "bpy.data.scenes.remove(second)"
        )
    turned(lit, 0.9)


@pytest.mark.newest
def test_f12_while_live(lit):
    lit.do("scene.render.resolution_percentage = 25; scene.eevee.taa_render_samples = 1; turn(1.3)")
    lit.do("with over(area('VIEW_3D')): bpy.ops.render.render('INVOKE_DEFAULT')")
    lit.until(f"not {RENDERING}")
    lit.until(UP_TO_DATE)
    assert "Traceback" not in lit.console and "Error" not in lit.console
