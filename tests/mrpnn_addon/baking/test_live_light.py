# SPDX-License-Identifier: GPL-3.0-or-later
"""Live Light: what it bakes again, its files, undo, saving, other scenes and files. The timer is called by hand."""

import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes
from tests.support.paths import ROOT


@pytest.fixture
def live(addon, scene, tmp_path):
    """The module, with a small cloud whose light is live; off at the end."""
    scene.render.resolution_x = scene.render.resolution_y = 32
    scene.render.engine = "CYCLES"
    blender_scenes.cloud_scene(scene, tmp_path, density=20.0)
    # Other directions take most of a small bake's time.
    scene.mrpnn_light.directional = False
    module = addon.mrpnn_addon.baking.live
    scene.mrpnn_live_light = True
    yield module
    for one in bpy.data.scenes:
        one.mrpnn_live_light = False


def settle(module, scene=None):
    """Call the timer until the final light is shown; gives the longest call in the thread's seconds."""
    longest, end = 0.0, time.monotonic() + 120
    up_to_date = 0
    while up_to_date < 3:
        assert time.monotonic() < end, module.live_status(scene or bpy.context.scene)
        # What Blender does between two calls of a timer.
        bpy.context.view_layer.update()
        start = time.thread_time()
        module.tick()
        longest = max(longest, time.thread_time() - start)
        status, is_problem = module.live_status(scene or bpy.context.scene)
        assert not is_problem, status
        up_to_date = up_to_date + 1 if "up to date" in status else 0
        time.sleep(0.01)
    return longest


def until_shown(module, before):
    """Call the timer until another file than before is shown; gives it."""
    end = time.monotonic() + 120
    while shown_file() in ("", before):
        assert time.monotonic() < end
        bpy.context.view_layer.update()
        module.tick()
        time.sleep(0.01)
    return shown_file()


def lights():
    return [shown for shown in bpy.context.scene.objects if "mrpnn_light" in shown]


def shown_file():
    return os.path.normpath(bpy.path.abspath(lights()[0].data.filepath)) if lights() else ""


def key():
    [item] = bpy.context.scene.mrpnn_light.volumes
    return item.key


def folders():
    return list(Path(bpy.app.tempdir).parent.glob("mrpnn-live-*"))


def turn_sun(angle):
    bpy.context.scene.objects["Sun"].rotation_euler = angle, 0.3, 0.2


CHANGES = {
    "a sun": lambda: turn_sun(1.4),
    "a lamp": lambda: blender_scenes.add_object(bpy.context.scene, "Lamp", bpy.data.lights.new("Lamp", "POINT")),
    "the World": lambda: setattr(
        bpy.context.scene.world.node_tree.nodes["Background"].inputs["Strength"], "default_value", 0.5
    ),
    "the material": lambda: setattr(
        bpy.data.materials["Cloud fog"].node_tree.nodes[0].inputs["Density"], "default_value", 5.0
    ),
    "the volume": lambda: setattr(bpy.context.scene.objects["Cloud"], "location", (0.5, 0.0, 0.0)),
}


@pytest.mark.parametrize("change", CHANGES)
def test_light_follows_changes_coarse_first(live, change):
    settle(live)
    before, before_key = shown_file(), key()
    CHANGES[change]()
    first = until_shown(live, before)
    assert key().endswith("-coarse") and not key().startswith(before_key)
    settle(live)
    assert shown_file() not in (before, first) and not key().endswith("-coarse")
    assert len(lights()) == 1 and all(os.path.exists(path) for path in (before, first, shown_file()))


HIDE = {
    "the lamp": lambda layer, lamp: lamp.hide_set(True),
    "the lamp's collection": lambda layer, lamp: setattr(layer.layer_collection.children["Lamps"], "exclude", True),
    "the World": lambda layer, lamp: setattr(layer, "use_sky", False),
}


@pytest.mark.parametrize("hide", HIDE)
def test_light_follows_what_the_view_layer_shows(live, hide):
    scene, lamps = bpy.context.scene, bpy.data.collections.new("Lamps")
    scene.collection.children.link(lamps)
    lamp = bpy.data.objects.new("Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamps.objects.link(lamp)
    CHANGES["the World"]()
    settle(live)
    before = shown_file()
    HIDE[hide](scene.view_layers[0], lamp)
    until_shown(live, before)


def test_the_final_light_is_that_of_a_bake(addon, live, tmp_path):
    settle(live)
    turn_sun(1.4)
    settle(live)
    assert bpy.ops.mrpnn.bake_light(folder=str(tmp_path), directional=False) == {"FINISHED"}
    # It is up to date.
    assert not os.path.exists(tmp_path / "baked_light") and str(tmp_path) not in shown_file()


def test_nothing_is_baked_while_nothing_changes(live):
    settle(live)
    before = shown_file()
    # A selection, and another camera with nothing but other directions to see.
    bpy.context.scene.objects["Sun"].select_set(True)
    settle(live)
    assert shown_file() == before


def test_the_interface_never_waits(live):
    settle(live)
    turn_sun(1.4)
    assert settle(live) < 0.1


def test_blender_reads_files_of_light_between_calls_of_the_timer(live):
    """What evaluates the scene reads them, which takes long where they are large."""
    settle(live)
    evaluated, end = [], time.monotonic() + 120
    handler = lambda *_: evaluated.append(shown_file())  # noqa: E731
    turn_sun(1.4)
    until_shown(live, shown_file())
    first = shown_file()
    bpy.app.handlers.depsgraph_update_post.append(handler)
    try:
        while shown_file() == first:
            assert time.monotonic() < end
            bpy.context.view_layer.update()
            evaluated.clear()
            live.tick()
            assert not evaluated
            time.sleep(0.01)
        bpy.context.view_layer.update()
        assert evaluated == [shown_file()]
    finally:
        bpy.app.handlers.depsgraph_update_post.remove(handler)


def test_light_that_was_baked_before_comes_back_without_a_bake(live):
    settle(live)
    first = shown_file()
    turn_sun(1.4)
    settle(live)
    turn_sun(0.6)
    assert until_shown(live, shown_file()) == first


def test_objects_come_and_go_with_volumes(live):
    settle(live)
    bpy.data.objects.remove(bpy.context.scene.objects["Cloud"])
    settle(live)
    assert not lights()


@pytest.mark.slow
def test_undo_and_redo_name_files_that_are_there(live):
    bpy.ops.ed.undo_push(message="Before")
    settle(live)
    bpy.ops.ed.undo_push(message="Lit")
    first = shown_file()
    turn_sun(1.4)
    bpy.ops.ed.undo_push(message="Turned")
    settle(live)
    second, files = shown_file(), set(os.listdir(os.path.dirname(shown_file())))
    # The last step is that of the turn: updates add none.
    bpy.ops.ed.undo()
    assert bpy.context.scene.objects["Sun"].rotation_euler[0] == pytest.approx(0.6)
    assert os.path.exists(shown_file())
    settle(live)
    assert shown_file() == first
    bpy.ops.ed.redo()
    assert bpy.context.scene.objects["Sun"].rotation_euler[0] == pytest.approx(1.4)
    assert os.path.exists(shown_file())
    settle(live)
    assert shown_file() == second and files <= set(os.listdir(os.path.dirname(second)))
    for _ in range(2):
        bpy.ops.ed.undo()
    settle(live)
    assert os.path.exists(shown_file())


@pytest.mark.slow
def test_saving_makes_the_light_permanent(live, tmp_path):
    settle(live)
    temporary = shown_file()
    blend = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    assert os.path.samefile(os.path.dirname(shown_file()), tmp_path / "baked_light")
    assert os.path.exists(temporary)
    turn_sun(1.4)
    settle(live)
    assert str(tmp_path) not in shown_file()
    other = tmp_path / "other"
    other.mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(other / "scene.blend"))
    for path in (blend, other / "scene.blend"):
        bpy.ops.wm.open_mainfile(filepath=str(path))
        assert lights()[0].data.filepath.startswith("//baked_light") and os.path.exists(shown_file())
        assert not os.path.exists(temporary)
        # What is saved is up to date.
        before = shown_file()
        settle(live)
        assert shown_file() == before


def test_a_folder_that_cannot_be_made_is_told_when_saving(live, tmp_path):
    settle(live)
    (tmp_path / "baked_light").write_text("")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    [sentence] = live.not_kept()
    assert "Cloud" in sentence and "temporary" in sentence


@pytest.mark.slow
def test_rendering_shows_the_light_and_leaves_its_file(live, tmp_path):
    bpy.context.scene.cycles.samples, bpy.context.scene.cycles.volume_bounces = 8, 0
    dark = blender_scenes.rendered(bpy.context.scene, tmp_path)[..., :3].mean()
    settle(live)
    turn_sun(0.7)
    until_shown(live, shown_file())
    lit = blender_scenes.rendered(bpy.context.scene, tmp_path)[..., :3].mean()
    assert lit > 1.1 * dark and os.path.exists(shown_file())
    settle(live)


@pytest.mark.slow
def test_two_scenes_have_light_of_their_own(live, tmp_path):
    settle(live)
    first, first_file = bpy.context.scene, shown_file()
    bpy.ops.scene.new(type="FULL_COPY")
    second = bpy.context.scene
    assert second != first and second.mrpnn_live_light
    next(shown for shown in second.objects if shown.type == "LIGHT").rotation_euler = 1.4, 0.3, 0.2
    settle(live)
    [other] = lights()
    assert bpy.path.abspath(other.data.filepath) != first_file and os.path.exists(first_file)
    second.mrpnn_live_light = False
    assert os.path.exists(first_file) and os.path.exists(shown_file()) and "mrpnn-live" not in shown_file()
    bpy.context.window.scene = first
    settle(live)
    assert shown_file() == first_file


def test_switching_off_keeps_the_light_and_clears_the_rest(live):
    settle(live)
    turn_sun(1.4)
    settle(live)
    mine = {folder for folder in folders() if str(folder) in shown_file()}
    assert len(mine) == 1
    bpy.context.scene.mrpnn_live_light = False
    assert not mine & set(folders()) and os.path.exists(shown_file())
    assert live.tick() is None


def test_removing_the_light_switches_off(live):
    settle(live)
    folder = Path(shown_file()).parents[1]
    bpy.ops.mrpnn.bake_light_remove()
    assert not folder.exists() and not lights() and live.tick() is None


def test_undo_of_the_switch_clears_files(live):
    bpy.context.scene.mrpnn_live_light = False
    bpy.ops.ed.undo_push(message="Off")
    bpy.context.scene.mrpnn_live_light = True
    bpy.ops.ed.undo_push(message="On")
    settle(live)
    folder = Path(shown_file()).parents[1]
    bpy.ops.ed.undo()
    assert live.tick() is None and not folder.exists() and not lights()
    bpy.ops.ed.redo()
    settle(live)
    assert os.path.exists(shown_file())


def test_another_file_clears_files_and_stops_the_work(live):
    settle(live)
    folder = Path(shown_file()).parents[1]
    turn_sun(1.4)
    bpy.context.view_layer.update()
    live.tick()
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not folder.exists()


def test_unregistering_leaves_no_handler_and_no_file(addon, live):
    settle(live)
    folder = Path(shown_file()).parents[1]
    addon.unregister()
    try:
        handlers = [
            handler
            for name in dir(bpy.app.handlers)
            if isinstance(found := getattr(bpy.app.handlers, name), list)
            for handler in found
        ]
        assert not [one for one in handlers if getattr(one, "__module__", "").startswith("mrpnn")]
        assert not bpy.app.timers.is_registered(live.tick) and not folder.exists()
    finally:
        addon.register()


CRASH = """
import os, sys
from pathlib import Path
from mrpnn_runtime import SessionFolder
folder = SessionFolder(Path(sys.argv[1]), "mrpnn-live-")
(folder.path / "light.vdb").write_text("light")
print(folder.path, flush=True)
if sys.argv[2] == "crash": os.kill(os.getpid(), 9)
sys.stdin.read()
"""


def test_what_a_crash_leaves_is_cleared_and_what_runs_is_not(addon, tmp_path):
    session = addon.mrpnn_addon.runtime.session_folder
    script = CRASH.replace("mrpnn_runtime", "session_folder")
    source = {**os.environ, "PYTHONPATH": str(ROOT / "mrpnn_addon" / "runtime")}
    command = [sys.executable, "-c", script, str(tmp_path)]
    crashed = subprocess.run([*command, "crash"], env=source, capture_output=True, text=True).stdout.strip()
    running = subprocess.Popen([*command, "run"], env=source, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        used = running.stdout.readline().strip()
        own = session.SessionFolder(tmp_path, "mrpnn-live-")
        assert os.path.exists(crashed) and os.path.exists(used)
        session.remove_leftovers(tmp_path, "mrpnn-live-")
        assert not os.path.exists(crashed) and os.path.exists(used) and own.path.exists()
        own.remove()
        assert not own.path.exists()
    finally:
        running.communicate("")
