# SPDX-License-Identifier: GPL-3.0-or-later
"""Bake Light in Blender's window: its worker, Esc, what EEVEE's viewport shows, and its removal."""

import pytest

from tests.support.window import NEEDS_WINDOW

pytestmark = NEEDS_WINDOW

BAKE = "with over(area('VIEW_3D')): bpy.ops.mrpnn.bake_light('INVOKE_DEFAULT', folder=WORK + '/light', everything=True)"
LIGHTS = "[o for o in bpy.data.objects if 'mrpnn_light' in o]"
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
        "area('VIEW_3D').spaces.active.shading.type = 'SOLID'\n"
        "with over(area('VIEW_3D')):\n"
        "    if bpy.context.scene.mrpnn_light.active: bpy.ops.mrpnn.bake_light_remove()\n"
        "bpy.context.scene.render.engine = 'MRPNN'"
    )


def brightness(window, name):
    """Mean of the middle of the viewport."""
    screen = window.shot(name)
    left, top, right, bottom = window.box("VIEW_3D")
    x, y = (left + right) // 2, (top + bottom) // 2
    return float(screen[y - 40 : y + 40, x - 40 : x + 40].mean())


def test_esc_stops_a_bake_and_changes_nothing(lit):
    lit.do(BAKE)
    lit.press("Escape")
    lit.until(f"not {BAKING}")
    lit.until("bpy.context.window_manager.operators is not None")
    assert lit.do(f"print(len({LIGHTS}), bpy.context.scene.mrpnn_light.active)") in ("0 False", "1 True")


def test_eevee_shows_baked_light_and_removal_takes_it_away(lit):
    lit.do(EEVEE)
    dark = brightness(lit, "bake-before")
    lit.do(BAKE)
    lit.until(f"len({LIGHTS}) == 1")
    lit.until(f"not {BAKING}")
    shone = brightness(lit, "bake-after")
    assert shone > 1.15 * dark
    lit.do("with over(area('VIEW_3D')): bpy.ops.mrpnn.bake_light_remove()")
    assert lit.do(f"print(len({LIGHTS}))") == "0"
    assert brightness(lit, "bake-removed") == pytest.approx(dark, rel=0.05)
