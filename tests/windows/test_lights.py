# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered shading with each kind of light in Blender's window."""

import time

from tests.support.window import LONG, NEEDS_WINDOW, THREADS

pytestmark = NEEDS_WINDOW

# The ball alone in the dark, seen through the camera; `shine` lights it by one light of a kind, or by none.
DARK = """
import gc, threading
from mathutils import Vector
from bpy_extras.view3d_utils import location_3d_to_region_2d
scene = bpy.context.scene
bpy.data.objects.remove(bpy.data.objects["Sun"])
space = area('VIEW_3D').spaces.active
space.region_3d.view_perspective = 'CAMERA'; space.region_3d.view_camera_zoom = -20
space.overlay.show_overlays = False
scene.render.resolution_x = 240; scene.mrpnn.depth_samples = 1
space.shading.type = 'RENDERED'
background = scene.world.node_tree.nodes["Background"]
def shine(kind, **values):
    for light in list(bpy.data.lights): bpy.data.lights.remove(light)
    background.inputs["Strength"].default_value = 2.0 if kind == "WORLD" else 0.0
    background.inputs["Color"].default_value = 1.0, 0.5, 0.3, 1.0
    scene.render.film_transparent = True
    if kind in ("WORLD", "NONE"): return
    light = bpy.data.lights.new(kind, kind)
    light.color = 1.0, 0.5, 0.3
    for name, value in values.items(): setattr(light, name, value)
    shown = bpy.data.objects.new(kind, light)
    scene.collection.objects.link(shown)
    shown.location = 2.0, 1.5, 4.0
    shown.rotation_euler = Vector((2.0, 1.5, 4.0)).to_track_quat("Z", "Y").to_euler()
a = area('VIEW_3D'); r = region(a)
p = location_3d_to_region_2d(r, space.region_3d, (0, 0, 0))
print((round(r.x + p.x), round(win().height - r.y - p.y)))
"""
STATUS = "next((v.status for v in gc.get_objects() if type(v).__name__ == 'Viewport' and hasattr(v, 'status')), '')"
LIGHTS = (
    "'SUN', energy=8.0",
    "'SUN', energy=8.0, angle=0.3",
    "'POINT', energy=4000.0",
    "'SPOT', energy=4000.0",
    *(f"'AREA', energy=2000.0, shape='{shape}'" for shape in ("SQUARE", "RECTANGLE", "DISK", "ELLIPSE")),
    "'WORLD'",
)


def warmth(window, place):
    """How much more red than blue the middle of the ball is on the screen."""
    window.do("area('VIEW_3D').tag_redraw()")
    window.do("pass")
    x, y = place
    red, _, blue = window.screen()[y - 4 : y + 5, x - 4 : x + 5].astype(int).mean(axis=(0, 1))
    return red - blue


def until(window, place, lit):
    start = time.monotonic()
    while (warmth(window, place) > 10) != lit:
        assert time.monotonic() - start < LONG / 3, window.do(f"print({STATUS})") + window.console[-2000:]
        time.sleep(0.2)
    window.until(f"not {THREADS}")


def test_rendered_shading_shows_every_kind_of_light(window):
    window.do("bpy.ops.wm.open_mainfile(filepath=WORK + '/window.blend')")
    place, before = eval(window.do(DARK)), len(window.console)
    for light in LIGHTS:
        window.do("shine('NONE')")
        until(window, place, lit=False)
        window.do(f"shine({light})")
        until(window, place, lit=True)
        status = window.do(f"print({STATUS})")
        assert "bug" not in status and "failed" not in status, f"{light}: {status}"
    said = window.console[before:]
    assert "Traceback" not in said and "bug" not in said, said
    window.do("space.shading.type = 'WIREFRAME'")
    window.until(f"not {THREADS}")
