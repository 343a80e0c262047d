# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake Light in Blender's window: its worker, Esc, what EEVEE's viewport shows, and its removal."""

import time

import pytest

from tests.support.window import LONG, NEEDS_WINDOW

pytestmark = NEEDS_WINDOW

BAKE = "with over(area('VIEW_3D')): bpy.ops.mrpnn.bake_light('INVOKE_DEFAULT', folder=WORK + '/light', everything=True)"
OPTIMIZATIONS = "OPTIMIZATIONS = bpy.context.scene.mrpnn.optimizations\n"
LIGHTS = "[o for o in bpy.data.objects if 'mrpnn_light' in o]"
# Every call of a kernel takes a twentieth of a second more.
SLOW = """
import sys, time
library = next(module for name, module in sys.modules.items() if name.endswith("inference.kernels.library"))
fast = library.load_kernels
library.load_kernels = lambda: (time.sleep(0.05), fast())[1]
"""
BAKING = "[t for t in threading.enumerate() if t.name.startswith('mrpnn')]"
EEVEE = """
scene = bpy.context.scene
names = [item.identifier for item in scene.render.bl_rna.properties["engine"].enum_items]
scene.render.engine = "BLENDER_EEVEE_NEXT" if bpy.app.version < (5, 0, 0) else "BLENDER_EEVEE"
space = area("VIEW_3D").spaces.active
space.shading.type, space.overlay.show_overlays = "RENDERED", False
space.shading.use_scene_lights_render = space.shading.use_scene_world_render = True
space.region_3d.view_perspective = "CAMERA"
"""


@pytest.fixture
def lit(window):
    yield window
    window.do(
        "area('VIEW_3D').spaces.active.shading.type = 'WIREFRAME'\n"
        "with over(area('VIEW_3D')):\n"
        "    if bpy.context.scene.mrpnn_light.active: bpy.ops.mrpnn.bake_light_remove()\n"
        "bpy.context.scene.render.engine = 'MRPNN'"
    )


def picture(window, name):
    """Means of the middle of the viewport, and beside the cloud in its box, where the cloud is not."""
    screen = window.shot(name)
    left, top, right, bottom = window.box("VIEW_3D")
    x, y = (left + right) // 2, (top + bottom) // 2
    return float(screen[y - 40 : y + 40, x - 40 : x + 40].mean()), float(
        screen[y - 190 : y - 160, x - 200 : x - 170].mean()
    )


def compiled(window, name):
    """As `picture`, once EEVEE has compiled the light's material: until then it fills the light's box."""
    start = time.monotonic()
    while True:
        middle, corner = picture(window, name)
        if corner < 0.1 * middle:
            return middle
        assert time.monotonic() - start < LONG, "the light fills its box"


def test_esc_stops_a_bake_and_changes_nothing(lit):
    # Otherwise this small bake ends before anybody could press Esc.
    lit.do(SLOW + OPTIMIZATIONS + "bpy.context.scene.mrpnn.optimizations = set()")
    try:
        lit.do(BAKE)
        lit.press("Escape")
        lit.until(f"not {BAKING}")
    finally:
        lit.do("library.load_kernels = fast; bpy.context.scene.mrpnn.optimizations = OPTIMIZATIONS")
    assert lit.do(f"print(len({LIGHTS}), bpy.context.scene.mrpnn_light.active)") == "0 False"


def test_eevee_shows_baked_light_and_removal_takes_it_away(lit):
    lit.do(EEVEE)
    dark = compiled(lit, "bake-before")
    lit.do(BAKE.replace("everything", "directional=False, everything"))
    lit.until(f"len({LIGHTS}) == 1")
    lit.until(f"not {BAKING}")
    assert compiled(lit, "bake-after") > 1.02 * dark
    lit.do("with over(area('VIEW_3D')): bpy.ops.mrpnn.bake_light_remove()")
    assert lit.do(f"print(len({LIGHTS}))") == "0"
    assert compiled(lit, "bake-removed") == pytest.approx(dark, rel=0.02)


def test_an_animation_is_baked_while_blender_stays_usable(lit):
    lit.do(
        "scene = bpy.context.scene; scene.frame_start, scene.frame_end = 1, 2; scene.frame_set(2)\n"
        "sun = bpy.data.objects['Sun']\n"
        "for frame, angle in ((1, 0.9), (2, 1.5)):\n"
        "    sun.rotation_euler[0] = angle; sun.keyframe_insert('rotation_euler', frame=frame)"
    )
    animate = BAKE.replace("bake_light", "bake_animation").replace("everything=True", "directional=False")
    lit.do(animate)
    lit.until(f"len({LIGHTS}) == 1 and not {BAKING}")
    assert lit.do(f"print({LIGHTS}[0].data.is_sequence, scene.frame_current)") == "True 2"
    # Nothing has changed.
    lit.do(animate)
    lit.until(f"not {BAKING}")
    lit.do("sun.animation_data_clear()")
    assert "Traceback" not in lit.console
