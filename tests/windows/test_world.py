# SPDX-License-Identifier: GPL-3.0-or-later
"""The World behind Rendered shading in Blender's window, against Cycles."""

import time

import numpy as np
import pytest

from tests.support.window import LONG, NEEDS_WINDOW, THREADS

pytestmark = NEEDS_WINDOW

SETTINGS = """
import threading
from mathutils import Euler
scene = bpy.context.scene
s = area("VIEW_3D").spaces.active; view = s.region_3d
s.overlay.show_overlays = s.show_gizmo = s.show_region_toolbar = s.show_region_header = False
s.show_region_tool_header = False
scene.cycles.preview_samples, scene.cycles.use_preview_denoising = 4, False
bpy.data.objects["Ball"].location = 0, 60, 30
world = bpy.data.worlds.new("Behind"); world.use_nodes = True; scene.world = world
tree, background = world.node_tree, world.node_tree.nodes["Background"]
"""
WORLDS = {
    "colour": "background.inputs[0].default_value = 0.05, 0.4, 0.9, 1.0; background.inputs[1].default_value = 0.6",
    "directions": "tree.links.new(tree.nodes.new('ShaderNodeTexCoord').outputs['Generated'], background.inputs[0])",
    "sky": "tree.links.new(tree.nodes.new('ShaderNodeTexSky').outputs[0], background.inputs[0])\n"
    "background.inputs[1].default_value = 0.1",
}
VIEWS = {
    "perspective": "view.view_perspective = 'PERSP'; view.view_rotation = Euler((1.7, 0.0, 0.4)).to_quaternion()",
    "orthographic": "view.view_perspective = 'ORTHO'; view.view_rotation = Euler((1.2, 0.0, 0.4)).to_quaternion()",
    "camera": "view.view_perspective = 'CAMERA'; scene.camera.rotation_euler = 1.8, 0.0, 2.0",
}


def rim(window, name):
    """Screen colours (n, 3) near the corners and edges of the 3D viewport, as means of small squares."""
    picture = window.shot(name).astype(float)
    left, top, right, bottom = window.box("VIEW_3D")
    across, down = np.linspace(left + 30, right - 30, 5).astype(int), np.linspace(top + 40, bottom - 30, 5).astype(int)
    places = [(x, y) for x in across for y in down if x in (across[0], across[-1]) or y in (down[0], down[-1])]
    return np.array([picture[y - 3 : y + 4, x - 3 : x + 4].mean(axis=(0, 1)) for x, y in places])


def agreed(window, name, expected):
    """The largest difference of the viewport's border from what is expected, once it is small or time is up."""
    start, apart = time.monotonic(), np.inf
    while apart > 3.0 and time.monotonic() - start < LONG / 3:
        time.sleep(1.0)
        apart = np.abs(rim(window, name) - expected).max()
    return apart


def still(window, name):
    """The border's colours once two readings agree, with no thread at work."""
    window.until(f"not {THREADS}")
    before, now = None, rim(window, name)
    while before is None or np.abs(now - before).max() > 0.5:
        time.sleep(2.0)
        before, now = now, rim(window, name)
    return now


@pytest.mark.parametrize(
    "world, view",
    [
        ("colour", "camera"),
        ("directions", "perspective"),
        ("directions", "orthographic"),
        ("directions", "camera"),
        ("sky", "perspective"),
    ],
)
def test_rendered_shading_shows_the_world_as_cycles_does(window, world, view):
    window.do("bpy.ops.wm.open_mainfile(filepath=WORK + '/window.blend')")
    window.do(SETTINGS + WORLDS[world] + "\n" + VIEWS[view])
    window.do("s.shading.type = 'WIREFRAME'; scene.render.engine = 'MRPNN'")
    time.sleep(1.0)
    grey = rim(window, "world-solid")
    window.do("s.shading.type = 'RENDERED'")
    time.sleep(2.0)
    found = still(window, f"world-{world}-{view}")
    assert np.abs(found - grey).max() > 20
    window.do("s.shading.type = 'WIREFRAME'; scene.render.engine = 'CYCLES'; s.shading.type = 'RENDERED'")
    assert agreed(window, f"world-{world}-{view}-cycles", found) <= 3.0
    window.do("s.shading.type = 'WIREFRAME'; scene.render.engine = 'MRPNN'")
    window.until(f"not {THREADS}")


def test_a_transparent_film_looks_as_in_cycles(window):
    window.do("bpy.ops.wm.open_mainfile(filepath=WORK + '/window.blend')")
    window.do(SETTINGS + WORLDS["colour"] + "\n" + VIEWS["perspective"])
    window.do("s.shading.type = 'RENDERED'")
    time.sleep(2.0)
    opaque = still(window, "world-opaque")
    # Without another change than that.
    window.do("scene.render.film_transparent = True")
    time.sleep(2.0)
    found = still(window, "world-transparent")
    assert np.abs(found - opaque).min(axis=0).max() > 20
    window.do("s.shading.type = 'WIREFRAME'; scene.render.engine = 'CYCLES'; s.shading.type = 'RENDERED'")
    assert agreed(window, "world-transparent-cycles", found) <= 3.0
    window.do("s.shading.type = 'WIREFRAME'; scene.render.engine = 'MRPNN'; scene.render.film_transparent = False")
    window.do("s.shading.type = 'RENDERED'")
    assert agreed(window, "world-opaque-again", opaque) <= 1.0
    # Another World, and what its nodes hold.
    window.do(
        "other = bpy.data.worlds.new('Other'); other.use_nodes = True\n"
        "node = other.node_tree.nodes['Background']; node.inputs[0].default_value = 0.8, 0.1, 0.1, 1.0"
    )
    window.do("scene.world = other")
    time.sleep(2.0)
    red = still(window, "world-other")
    assert red[:, 0].min() > red[:, 2].max() + 50
    window.do("node.inputs[0].default_value = 0.1, 0.8, 0.1, 1.0")
    time.sleep(2.0)
    green = still(window, "world-changed")
    assert green[:, 1].min() > green[:, 0].max() + 50
    window.do("s.shading.type = 'WIREFRAME'")
    window.until(f"not {THREADS}")
