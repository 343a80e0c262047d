# SPDX-License-Identifier: GPL-3.0-or-later
"""Render Flipbook in Blender's window: its workers, Esc, and the plane that shows it."""

import pytest

from tests.support.window import NEEDS_WINDOW

pytestmark = NEEDS_WINDOW

START = "with over(area('VIEW_3D')): bpy.ops.mrpnn.flipbook('INVOKE_DEFAULT')"
WORKING = "[t for t in threading.enumerate() if t.name.startswith('mrpnn')]"
STAGE = """
import shutil
shutil.rmtree(WORK + "/flipbook", ignore_errors=True)
scene = bpy.context.scene
wanted = scene.mrpnn_flipbook
wanted.columns = wanted.rows = 2
wanted.size, wanted.filepath = 128, WORK + "/flipbook/cloud"
scene.frame_start, scene.frame_end = 1, 4
scene.frame_set(7, subframe=0.5)
"""
FILES = "import os; print(sorted(os.listdir(WORK + '/flipbook')) if os.path.isdir(WORK + '/flipbook') else [])"


@pytest.mark.newest
def test_a_flipbook_is_rendered_shown_and_stopped(window):
    window.do(STAGE)
    window.do(START)
    window.press("Escape")
    window.until(f"not {WORKING}")
    assert window.do(FILES) == "[]"
    assert window.do("print(scene.frame_current, scene.frame_subframe)") == "7 0.5"
    window.do(START)
    window.until(f"os.path.exists(WORK + '/flipbook/cloud.json') and not {WORKING}")
    assert window.do(FILES) == "['cloud.json', 'cloud_A.png', 'cloud_B.png']"
    assert window.do("print(scene.frame_current, scene.frame_subframe)") == "7 0.5"
    shown = window.do("with over(area('VIEW_3D')): print(bpy.ops.mrpnn.flipbook_show(), bpy.context.object.name)")
    assert shown.endswith("{'FINISHED'} cloud"), shown
    window.do("bpy.data.objects.remove(bpy.data.objects['cloud'])")
    assert "Traceback" not in window.console
