# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered shading follows hiding, local view, linked files, regions and loading, in Blender's window."""

import time

import pytest

from tests.support.window import CLOSE, LONG, NEEDS_WINDOW, THREADS

pytestmark = [*NEEDS_WINDOW, pytest.mark.newest]

# The ball twice, "Ball" on the left and "Other" on the right in a collection of its own, seen through the camera.
TWO = """
import gc, threading
bpy.ops.wm.open_mainfile(filepath=WORK + '/window.blend')
scene, layer = bpy.context.scene, bpy.context.view_layer
apart = bpy.data.collections.new("Apart"); scene.collection.children.link(apart)
ball, other = bpy.data.objects["Ball"], bpy.data.objects.new("Other", bpy.data.volumes["Ball"].copy())
apart.objects.link(other)
ball.location.x, other.location.x = -2, 2
child = layer.layer_collection.children["Apart"]
space = area('VIEW_3D').spaces.active
# Small, so that each of many pictures takes a moment.
space.region_3d.view_perspective = 'CAMERA'; space.region_3d.view_camera_zoom = -20
space.overlay.show_overlays = False
space.shading.type = 'RENDERED'
scene.render.resolution_x = 240; scene.mrpnn.depth_samples = 1
def only(*names):
    for item in scene.objects: item.select_set(item.name in names)
    layer.objects.active = scene.objects[names[0]]
def run(operator, **arguments):
    with over(area('VIEW_3D')): operator(**arguments)
"""
# Where the middle of each ball lies on the screen.
PLACES = """
from bpy_extras.view3d_utils import location_3d_to_region_2d
a = area('VIEW_3D'); r = region(a)
points = [location_3d_to_region_2d(r, a.spaces.active.region_3d, (x, 0, 0)) for x in (-2, 2)]
print([(round(r.x + p.x), round(win().height - r.y - p.y)) for p in points])
"""
STATUS = "next((v.status for v in gc.get_objects() if type(v).__name__ == 'Viewport' and hasattr(v, 'status')), '')"


@pytest.fixture
def two(window):
    window.do(TWO)
    window.places = eval(window.do(PLACES))
    until_shown(window, (True, True))
    yield window
    window.do("space.shading.type = 'WIREFRAME'")
    window.until(f"not {THREADS}")


def shown(window, places=None):
    """Whether each ball's red light is visible."""
    # Two answers from the main loop lie two drawings apart.
    window.do("area('VIEW_3D').tag_redraw()")
    window.do("pass")
    picture = window.screen().astype(int)
    found = [picture[y - 4 : y + 5, x - 4 : x + 5].mean(axis=(0, 1)) for x, y in places or window.places]
    return tuple(bool(red > blue + 10) for red, _, blue in found)


def until_shown(window, expected, places=None):
    """Wait until the viewport shows this, and still does once no thread is at work."""
    start = time.monotonic()
    while shown(window, places) != expected:
        assert time.monotonic() - start < LONG, (expected, shown(window, places))
        time.sleep(0.3)
    window.until(f"not {THREADS}")
    assert shown(window, places) == expected


CASES = {
    "the eye": ("other.hide_set(True)", "other.hide_set(False)", (True, False)),
    "the monitor": ("other.hide_viewport = True", "other.hide_viewport = False", (True, False)),
    "local view": (
        "only('Other', 'Sun'); run(bpy.ops.view3d.localview, frame_selected=False)",
        "run(bpy.ops.view3d.localview, frame_selected=False)",
        (False, True),
    ),
    "out of local view": (
        "only('Ball', 'Other', 'Sun'); run(bpy.ops.view3d.localview, frame_selected=False); only('Ball')\n"
        "run(bpy.ops.view3d.localview_remove_from)",
        "run(bpy.ops.view3d.localview, frame_selected=False)",
        (False, True),
    ),
    "a collection excluded": ("child.exclude = True", "child.exclude = False", (True, False)),
    "a collection's eye": ("child.hide_viewport = True", "child.hide_viewport = False", (True, False)),
    "a collection's monitor": ("apart.hide_viewport = True", "apart.hide_viewport = False", (True, False)),
    "indirect light only": ("child.indirect_only = True", "child.indirect_only = False", (True, False)),
    "a collection as holdout": ("child.holdout = True", "child.holdout = False", (True, False)),
    "the camera's rays": ("other.visible_camera = False", "other.visible_camera = True", (True, False)),
    "types of objects": (
        "space.show_object_viewport_volume = False",
        "space.show_object_viewport_volume = True",
        (False, False),
    ),
    "scale 0": ("other.scale = 0, 0, 0", "other.scale = 1, 1, 1", (True, False)),
    "a missing file": (
        "other.data.filepath = WORK + '/gone.vdb'",
        "other.data.filepath = WORK + '/window.vdb'",
        (True, False),
    ),
}


def test_the_viewport_follows(two):
    """Each change and its reversal, without console output."""
    said = two.console
    for case, (hide, show, expected) in CASES.items():
        assert not two.do(hide), case
        until_shown(two, expected)
        two.do(show)
        until_shown(two, (True, True))
    said = two.console[len(said) :]
    assert "Warning" not in said and "Traceback" not in said, said


def test_h_and_alt_h(two):
    """By keyboard; F12 renders what is hidden in the viewport only."""
    two.do("only('Other')")
    two.press("h")
    until_shown(two, (True, False))
    assert two.do(f"print({STATUS})") == ""
    two.do(
        "scene.render.filepath = WORK + '/hidden.png'; bpy.ops.render.render(write_still=True)\n"
        "import numpy; image = bpy.data.images.load(WORK + '/hidden.png', check_existing=False)\n"
        "pixels = numpy.array(image.pixels).reshape(120, 240, 4)[60]; bpy.data.images.remove(image)\n"
        "sides = [bool(side[:, 0].max() > side[:, 2].max() + 0.04) for side in (pixels[:120], pixels[120:])]"
    )
    assert two.do("print(sides)") == "[True, True]"
    two.press("alt+h")
    until_shown(two, (True, True))


def test_objects_hidden_in_renders_show_in_the_viewport_as_in_cycles(two):
    two.do("other.hide_render = True")
    until_shown(two, (True, True))
    two.do("other.hide_render = False; apart.hide_render = True")
    until_shown(two, (True, True))


def test_with_all_hidden_it_is_empty_and_without_light_black(two):
    two.do("only('Ball', 'Other'); run(bpy.ops.object.hide_view_set)")
    until_shown(two, (False, False))
    two.do("run(bpy.ops.object.hide_view_clear)")
    until_shown(two, (True, True))
    grey = two.shot("lit")
    two.do("bpy.data.objects['Sun'].hide_set(True)")
    until_shown(two, (False, False))
    assert "no sun" in two.do(f"print({STATUS})")
    # A black ball covers what lies behind it.
    (x, y), _ = two.places
    assert two.shot("black")[y, x].max() < 20 < grey[y, x].max()
    two.do("bpy.data.objects['Sun'].hide_set(False)")
    until_shown(two, (True, True))


def test_another_world_lights_the_volumes(two):
    two.do(
        "red, dark = bpy.data.worlds.new('Red'), scene.world; red.use_nodes = True\n"
        "red.node_tree.nodes['Background'].inputs['Color'].default_value = 1, 0.1, 0.05, 1\n"
        "scene.render.film_transparent = True; bpy.data.objects['Sun'].hide_viewport = True"
    )
    until_shown(two, (False, False))
    two.do("scene.world = red")
    until_shown(two, (True, True))
    two.do("scene.world = dark")
    until_shown(two, (False, False))


def test_a_scene_without_a_camera_is_shown(two):
    two.do("space.region_3d.view_perspective = 'PERSP'; scene.camera = None; ball.location.y = 0.01")
    until_shown(two, (True, True), eval(two.do(PLACES)))
    assert two.do(f"print({STATUS})") == ""


def test_an_invalid_volume_is_named_in_the_viewport_that_shows_the_others(two):
    two.do("other.data.filepath = WORK + '/gone.vdb'")
    until_shown(two, (True, False))
    two.shot("bad-volume")
    said = two.do(f"print({STATUS})")
    assert '"Other": file not found' in said and "gone.vdb" in said


def test_a_render_region_drawn_with_ctrl_b(two):
    """The render's region in the camera view, by keys and mouse, and the viewport's own elsewhere."""
    (left, top), (right, bottom) = two.places
    for view in ("CAMERA", "PERSP"):
        # The same view, through the camera or not.
        two.do(f"space.region_3d.view_perspective = '{view}'")
        places = eval(two.do(PLACES))
        until_shown(two, (True, True), places)
        (x, y), _ = places
        two.mouse("mousemove", x - 60, y - 60)
        two.mouse("key", "ctrl+b")
        time.sleep(0.5)
        for place in ((x - 60, y - 60), (x, y), (x + 60, y + 60)):
            two.mouse("mousemove", *place, *(["mousedown", 1] if place[0] < x else []))
            time.sleep(0.3)
        two.mouse("mouseup", 1)
        until_shown(two, (True, False), places)
        two.shot(f"region-{view.lower()}")
        assert two.do("print(scene.render.use_border, space.use_render_border)") == (
            "True False" if view == "CAMERA" else "False True"
        )
        # What lies inside is where it was: its edge's pixels, too.
        two.do("scene.render.use_border = space.use_render_border = False; area('VIEW_3D').tag_redraw()")
        until_shown(two, (True, True), places)


# A library of one ball in a collection, which another file instances and overrides.
LIBRARY = """
lib = bpy.data.collections.new("Lib"); lib.objects.link(other); scene.collection.children.link(lib)
apart.objects.unlink(other); other.location.x = 0
bpy.data.libraries.write(WORK + '/library.blend', {lib}, fake_user=True)
bpy.data.objects.remove(other); bpy.data.collections.remove(lib)
def link():
    with bpy.data.libraries.load(WORK + '/library.blend', link=True) as (there, here): here.collections = ["Lib"]
    return bpy.data.collections["Lib"]
"""
CHANGE = """
import subprocess, sys
code = '''import bpy, sys
bpy.data.objects["Other"].scale = (SCALE,) * 3
bpy.data.objects["Other"].data.filepath = sys.argv[-1]
bpy.ops.wm.save_mainfile()'''.replace("SCALE", "%s")
subprocess.run([bpy.app.binary_path, '-b', '--factory-startup', WORK + '/library.blend', '--python-expr', code, '--',
                WORK + '/window.vdb'], check=True, stdout=subprocess.DEVNULL)
bpy.data.libraries[0].reload()
"""


@pytest.mark.parametrize("how", ["instance", "override"])
def test_a_linked_library_that_is_reloaded(two, how):
    two.do(LIBRARY)
    until_shown(two, (True, False))
    if how == "instance":
        two.do(
            "empty = bpy.data.objects.new('At', None); scene.collection.objects.link(empty); empty.location.x = 2\n"
            "empty.instance_type = 'COLLECTION'; empty.instance_collection = link()"
        )
    else:
        two.do(
            "made = link().override_hierarchy_create(scene, layer)\n"
            "next(o for o in scene.objects if o.override_library).location.x = 2"
        )
    until_shown(two, (True, True))
    two.do(CHANGE % "0.0")
    until_shown(two, (True, False))
    two.do(CHANGE % "1.0")
    until_shown(two, (True, True))


@pytest.mark.parametrize("interface", [True, False])
def test_loading_another_file_clears_the_former_ones_messages(two, interface):
    """In the panel and in the viewport, whether or not the file's interface is loaded."""
    two.do(
        "bpy.ops.wm.save_as_mainfile(filepath=WORK + '/good.blend'); other.data.filepath = WORK + '/gone.vdb'\n"
        "bpy.ops.mrpnn.render(); bpy.ops.mrpnn.check()\n"
        "import sys; said = lambda name: getattr(next(m for n, m in sys.modules.items() "
        "if n.endswith('mrpnn_addon.status.' + name)), name.replace('scene', 'last'))()"
    )
    # The picture's window lies over the viewport.
    two.until("len(bpy.context.window_manager.windows) > 1")
    two.do(CLOSE)
    until_shown(two, (True, False))
    assert two.do("print(bool(said('last_render').warnings), bool(said('scene_check').warnings))") == "True True"
    two.do(
        f"bpy.ops.wm.open_mainfile(filepath=WORK + '/good.blend', load_ui={interface})\n"
        # Files are loaded in Solid shading.
        "space = area('VIEW_3D').spaces.active; space.shading.type = 'RENDERED'"
    )
    until_shown(two, (True, True))
    assert two.do("print(said('last_render'), said('scene_check'))") == "None None"
    two.do("gc.collect()")
    assert two.do(f"print({STATUS})") == ""


def test_exposure_counts_at_once(two):
    two.do("scene.cycles.film_exposure = 0.0")
    until_shown(two, (False, False))
    two.do("scene.cycles.film_exposure = 1.0")
    until_shown(two, (True, True))


# Every picture takes a second more, many frames long.
SLOW = """
import sys, time
preview = next(module for name, module in sys.modules.items() if name.endswith("mrpnn_addon.engine.preview"))
steps, pictures = preview.steps, set()
def slowly(*arguments):
    time.sleep(1.0)
    return steps(*arguments)
preview.steps = slowly
def watch():
    shown = [v for v in gc.get_objects() if type(v).__name__ == "Viewport" and hasattr(v, "_drawn")]
    pictures.update((id(v._drawn[0]), v._drawn[1]) for v in shown)
    return 0.1 if preview.steps is slowly else None
sun = bpy.data.objects["Sun"]
for frame, turn in ((1, 0.0), (200, 3.0)):
    sun.rotation_euler.y = turn
    sun.keyframe_insert("rotation_euler", frame=frame)
bpy.app.timers.register(watch)
with over(area("VIEW_3D")): bpy.ops.screen.animation_play()
"""


def test_an_animation_that_plays_shows_pictures_that_take_longer_than_a_frame(two):
    two.do(SLOW)
    try:
        two.until("len(pictures) > 3")
        assert int(two.do("print(scene.frame_current)")) > 5
    finally:
        two.do("with over(area('VIEW_3D')): bpy.ops.screen.animation_cancel()\npreview.steps = steps")
        two.do("sun.animation_data_clear(); scene.frame_set(1)")
    # The last frame is shown once it stops.
    until_shown(two, (True, True))
