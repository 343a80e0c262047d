# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendering in Blender's window: buttons, F12, Esc, the preview, the panels."""

import contextlib
import inspect
import shutil
import threading
import time

import numpy as np
import pytest
from PIL import Image

from tests.support.file_state import state_of_file
from tests.support.window import CLOSE, LONG, NEEDS_WINDOW, RENDERING, THREADS

pytestmark = NEEDS_WINDOW


def test_the_panels_draw_without_console_output(window):
    before = window.console
    for context in ("VIEW_LAYER", "OBJECT", "RENDER"):
        window.do(f"area('PROPERTIES').spaces.active.context = '{context}'")
        window.shot(f"panel-{context.lower()}", window.box("PROPERTIES"))
    assert window.console == before


def test_the_preferences_draw_without_console_output(window):
    before = window.console
    window.do(
        "bpy.context.window_manager.addon_search = 'MRPNN'; bpy.ops.screen.userpref_show(section='ADDONS')\n"
        "own = next(name for name in bpy.context.preferences.addons.keys() if name.endswith('.mrpnn'))"
    )
    closed = window.shot("preferences-closed").astype(int)
    window.do("bpy.ops.preferences.addon_expand(module=own)")
    opened = window.shot("preferences").astype(int)
    window.do("bpy.ops.preferences.addon_expand(module=own); bpy.context.window_manager.addon_search = ''")
    window.do(CLOSE)
    window.until("len(bpy.context.window_manager.windows) == 1")
    # Settings under the extension's own row.
    assert (np.abs(opened - closed).max(axis=(1, 2)) > 60).sum() > 100
    assert window.console == before


@pytest.mark.parametrize(
    "sought, lit, grey",
    [
        ("File", "scene.mrpnn.use_exr = True", "scene.mrpnn.use_exr = False"),
        ("Composite", "addon_utils.enable('cycles')", "addon_utils.disable('cycles')"),
    ],
)
def test_settings_that_do_not_apply_are_greyed_out(window, sought, lit, grey):
    """The editor's search opens the setting's panel: where the picture differs, it has less contrast."""
    window.do(
        "import addon_utils; scene = bpy.context.scene; world = scene.world\n"
        f"p = area('PROPERTIES').spaces.active; p.context = 'RENDER'; p.search_filter = '{sought}'"
    )
    try:
        shots = []
        for state, name in ((lit, "lit"), (grey, "grey")):
            window.do(state)
            shots.append(window.shot(f"{sought.split()[0].lower()}-{name}").astype(int))
    finally:
        window.do(lit)
        window.do("p.search_filter = ''; scene.mrpnn.use_exr = False")
    left, top, right, bottom = window.box("PROPERTIES")
    lit, grey = (picture[top:bottom, left:right].mean(axis=2) for picture in shots)
    rows = np.flatnonzero((np.abs(lit - grey) > 3).any(axis=1))
    assert 5 < len(rows) and rows[-1] - rows[0] < 60
    # Below a tick that turns them on.
    rows = np.split(rows, np.flatnonzero(np.diff(rows) > 4) + 1)[-1]
    assert np.ptp(grey[rows]) < 0.8 * np.ptp(lit[rows])


def test_the_engine_menu_offers_the_engine(window):
    """By a click of the mouse; the first entries are Blender's own."""
    left, top, right, _ = window.box("PROPERTIES")
    window.do("area('PROPERTIES').spaces.active.context = 'RENDER'; scene = bpy.context.scene")
    window.mouse("mousemove", (left + right) // 2 + 80, top + 78)
    time.sleep(0.5)
    window.mouse("click", 1)
    time.sleep(1.0)
    window.shot("engine-menu", (left - 200, top, right, top + 300))
    window.press("Escape")
    assert window.do("print(bpy.context.scene.render.engine)") == "MRPNN"


# A timer looks at Blender's main loop a hundred times a second. Between two looks its own work counts, not what other
# programs do to this machine.
LOOKS = """
import threading, time
looks, looking = [], True
def look():
    looks.append(time.thread_time())
    return 0.01 if looking else None
bpy.app.timers.register(look)
"""
LONGEST = "looking = False; print(max(b - a for a, b in zip(looks, looks[1:])))"
BLOCKED = 0.2


@contextlib.contextmanager
def usable(window):
    """Asserts that Blender's main loop stays responsive meanwhile.

    A pause of the whole virtual machine counts for the thread that ran; the clock here skips as much.
    """
    done, skips = threading.Event(), [0.0]

    def watch():
        last = time.monotonic()
        while not done.wait(0.01):
            last, before = time.monotonic(), last
            skips.append(last - before)

    watcher = threading.Thread(target=watch, daemon=True)
    window.do(LOOKS)
    watcher.start()
    try:
        yield
    finally:
        done.set()
    assert float(window.do(LONGEST)) < BLOCKED + max(skips)


def test_a_comparison_runs_beside_the_interface_and_esc_keeps_finished_renders(window):
    """Confirmed in its dialog by keyboard. Where Cycles shows no volumes, as in Debian's 5.2, it ends by itself."""
    folder = window.work / "comparison"
    shutil.rmtree(folder, ignore_errors=True)
    window.do("import bpy\n" + inspect.getsource(state_of_file))
    window.do(
        "import sys; compare = next(m for n, m in sys.modules.items() if n.endswith('mrpnn.operators.compare'))\n"
        "job = lambda: compare.MRPNN_OT_compare._run and compare.MRPNN_OT_compare._run.job\n"
        "before = state_of_file()"
    )
    said = window.console
    window.mouse("mousemove", 600, 400)
    window.do(
        "with over(area('VIEW_3D')): bpy.ops.mrpnn.compare('INVOKE_DEFAULT', samples=65536, ladder=1, "
        "denoised=False, bounces=8, scale=10, budget=0, folder=WORK + '/comparison')"
    )
    time.sleep(1.0)
    window.shot("compare-dialog")
    with usable(window):
        window.mouse("key", "Return")
        window.until("job()")
        window.do("made = job()")
        assert window.do("print(bpy.ops.mrpnn.compare())").endswith("{'CANCELLED'}")
        window.until("not job() or sum(made.method == 'reference' for made in job().passes) > 1")
        trusted = window.do("print(bool(job()))") == "True"
        if not trusted:
            assert "does not render volumes correctly here" in window.do("print(made.error)")
            # Told at the pointer, until it is told away.
            time.sleep(1.0)
            window.press("Escape")
        else:
            assert 0.0 < float(window.do("print(job().fraction)")) < 1.0
            window.press("Escape")
            window.until("not job()")
        window.until(f"not {THREADS}")
    # The settings of every scene are as they were; more data there is only what the comparison shows.
    window.do("now = state_of_file()")
    assert window.do("print(now[1] == before[1])") == "True"
    left = eval(window.do("print({k: n - before[0][k] for k, n in now[0].items() if n != before[0][k]})"))
    assert left == ({"images": 4, "texts": 1} if trusted else {}), left
    assert len(list(folder.glob("passes/*/reference-*.npz"))) >= (2 if trusted else 0)
    assert (folder / "report.html").exists() == trusted
    assert "Traceback" not in window.console[len(said) :]
    window.do(
        "for image in [i for i in bpy.data.images if i.name.startswith('MRPNN')]: bpy.data.images.remove(image)\n"
        "for text in list(bpy.data.texts): bpy.data.texts.remove(text)"
    )


# A cube with a procedural shader.
FOG = """
mesh = bpy.data.meshes.new("Fog")
mesh.from_pydata([(x, y, z) for x in (2, 3) for y in (0, 1) for z in (0, 1)], [],
                 [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
fog, material = bpy.data.objects.new("Fog", mesh), bpy.data.materials.new("Fog")
bpy.context.scene.collection.objects.link(fog)
material.use_nodes = True
nodes, link = material.node_tree.nodes, material.node_tree.links.new
nodes.clear()
principled = nodes.new("ShaderNodeVolumePrincipled")
link(principled.outputs[0], nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
link(nodes.new("ShaderNodeTexNoise").outputs[0], principled.inputs["Density"])
mesh.materials.append(material)
"""


@pytest.mark.newest
def test_a_large_volume_is_read_and_rendered_while_blender_stays_usable(window):
    """320^3 voxels, in a shape that Blender itself does not draw, since software OpenGL takes seconds for it. Beside
    them a cube of fog whose noise takes seconds to evaluate."""
    window.do(
        "import numpy\n"
        "try: import openvdb\n"
        "except ImportError: import pyopenvdb as openvdb\n"
        "grid = openvdb.FloatGrid(); grid.name = 'density'\n"
        "grid.transform = openvdb.createLinearTransform(4 / 320)\n"
        "for low in ((-160,) * 3, (60,) * 3):\n"
        "    grid.copyFromArray(numpy.random.default_rng(0).random((100,) * 3, numpy.float32), ijk=low)\n"
        "openvdb.write(WORK + '/large.vdb', grids=[grid])\n"
        "area('VIEW_3D').type = 'IMAGE_EDITOR'\n"
        "bpy.data.volumes['Ball'].filepath = WORK + '/large.vdb'"
    )
    window.do(FOG)
    try:
        with usable(window):
            window.do("with over(area('IMAGE_EDITOR')): bpy.ops.mrpnn.render('INVOKE_DEFAULT')")
            window.until("'MRPNN' in bpy.data.images")
    finally:
        window.do(
            "area('IMAGE_EDITOR').type = 'VIEW_3D'\n"
            "bpy.data.volumes['Ball'].filepath = WORK + '/window.vdb'; bpy.data.objects.remove(fog)\n"
            "for image in [i for i in bpy.data.images if i.name == 'MRPNN']: bpy.data.images.remove(image)"
        )
        window.until(f"not {THREADS}")


# Width and height of the picture that Rendered shading shows.
PICTURE = (
    "next(([*v._preview.picture.shape[1::-1]] for v in gc.get_objects() if type(v).__name__ == 'Viewport' "
    "and getattr(v, '_preview', None) is not None and v._preview.done), [])"
)


def test_rendered_shading_shows_the_volume_and_leaves_no_thread(window):
    window.do(
        "s = area('VIEW_3D').spaces.active; s.region_3d.view_perspective = 'CAMERA'; s.shading.type = 'WIREFRAME'\n"
        "s.overlay.show_overlays = False"
    )
    window.do(
        "import gc; shown = region(area('VIEW_3D'))\n"
        "s.shading.type = 'RENDERED'; area('PROPERTIES').spaces.active.context = 'RENDER'"
    )
    left, top, right, bottom = window.box("VIEW_3D")
    # Threads read and refine; none is left once the last picture is there.
    start, red, blue = time.monotonic(), 0, 0
    while not red > blue + 10 and time.monotonic() - start < LONG:
        time.sleep(0.5)
        red, _, blue = window.shot("preview")[(top + bottom) // 2, (left + right) // 2].astype(int)
    assert red > blue + 10
    # Last at full size, for the picture in docs.
    for size in (4, 1):
        window.do(f"scene.render.preview_pixel_size = '{size}'; area('VIEW_3D').tag_redraw()")
        window.until(f"{PICTURE} == [round(edge / {size}) for edge in (shown.width, shown.height)]")
        window.until(f"not {THREADS}")
    window.shot("viewport")
    window.do("scene.render.preview_pixel_size = '4'")
    # Turned while it refines.
    for angle in range(5):
        window.do(
            "r = area('VIEW_3D').spaces.active.region_3d; r.view_perspective = 'PERSP'\n"
            f"r.view_rotation = (1.0, 0.1 * {angle}, 0.0, 0.0)"
        )
    window.do("s.shading.type = 'WIREFRAME'")
    window.until(f"not {THREADS}")


# The clock, which all processes share, and its own work, until Blender renders no more.
STOPPED = f"""
import time
seen, ended = [], []
def watch():
    seen.append((time.monotonic(), time.process_time()))
    if {RENDERING}: return 0.01
    ended.append(True)
bpy.app.timers.register(watch)
"""


def warm(pixels):
    """Where a picture, (H, W, 3) of bytes, shows the red light of the scene's sun."""
    red, green, blue = np.moveaxis(pixels.astype(int), 2, 0)
    return (red > 60) & (red > 1.15 * green) & (green > blue)


def test_f12_renders_and_esc_stops(window):
    # Minutes of work, to be stopped at its beginning.
    window.do("scene.render.resolution_percentage = 400; scene.mrpnn.depth_samples = 256; scene.mrpnn.threads = 1")
    # Keycode 96 is F12; the name means Alt+F12 in some keyboard maps.
    window.press("96")
    window.until(RENDERING)
    # Its picture appears while it renders: in the window that opens, of the cloud's warm light.
    start = time.monotonic()
    while np.count_nonzero(warm(window.shot("rendering"))) < 2000:
        assert window.do(f"print({RENDERING})") == "True" and time.monotonic() - start < LONG
    window.do(STOPPED)
    window.press("Escape")
    pressed = time.monotonic()
    window.until("ended")
    # A second of this process's own two threads from the key on, whatever else the machine does.
    spent = window.do(f"print(seen[-1][1] - min(work for clock, work in seen if clock >= min({pressed}, seen[-1][0])))")
    assert float(spent) < 2.0, spent
    # What was shown stays.
    window.do("bpy.data.images['Render Result'].save_render(WORK + '/window-stopped.png')")
    with Image.open(window.work / "window-stopped.png") as picture:
        assert picture.size == (640, 480) and np.count_nonzero(warm(np.array(picture.convert("RGB")))) > 2000
    window.press("Escape")
    window.do("scene.render.resolution_percentage = 100; scene.mrpnn.depth_samples = 4; scene.mrpnn.threads = 0")
    window.press("96")
    window.until(RENDERING)
    window.until(f"not {RENDERING}")
    window.shot("render")
    window.do("bpy.data.images['Render Result'].save_render(WORK + '/window-result.png')")
    with Image.open(window.work / "window-result.png") as picture:
        assert picture.size == (160, 120)
        grey = picture.convert("L")
        assert grey.getpixel((80, 60)) > 20 + grey.getpixel((2, 2))
    window.do(CLOSE)
    window.until("len(bpy.context.window_manager.windows) == 1")
    window.until(f"not {THREADS}")


def test_panels_show_the_last_render_as_soon_as_it_ends(window):
    """Of F12 without a window of its own; the mouse stands still, elsewhere."""
    window.do(
        "import sys; last = next(m for n, m in sys.modules.items() if n.endswith('mrpnn_addon.status.last_render'))\n"
        "area('PROPERTIES').spaces.active.context = 'RENDER'\n"
        "view = bpy.context.preferences.view; display = view.render_display_type; view.render_display_type = 'NONE'\n"
        "last.remember(last.LastRender(seconds=5000.0)); area('PROPERTIES').tag_redraw()"
    )
    try:
        before = window.shot("last-render-before", window.box("PROPERTIES")).astype(int)
        window.press("96")
        window.until("last.last_render().seconds < 5000.0")
        window.until(f"not {RENDERING}")
        start = time.monotonic()
        while True:
            after = window.shot("last-render-after", window.box("PROPERTIES")).astype(int)
            if (np.abs(after - before).max(axis=2) > 60).sum() > 20:
                break
            assert time.monotonic() - start < 20.0, "the panel shows the render before"
    finally:
        window.do("view.render_display_type = display")


# A sky with its sun instead of the lamp, and back again.
SKY = """
world, lamp = bpy.context.scene.world, bpy.data.objects["Sun"]
sky = bpy.data.worlds.new("Sky"); sky.use_nodes = True
texture = sky.node_tree.nodes.new("ShaderNodeTexSky"); texture.sun_elevation = ELEVATION
sky.node_tree.links.new(texture.outputs[0], sky.node_tree.nodes["Background"].inputs["Color"])
sky.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.05
bpy.context.scene.world, lamp.hide_render, lamp.hide_viewport = sky, True, True
"""
NO_SKY = "bpy.context.scene.world, lamp.hide_render, lamp.hide_viewport = world, False, False"


def test_a_sky_is_rendered_by_cycles_beside_the_interface(window):
    window.do(
        "s = area('VIEW_3D').spaces.active; s.region_3d.view_perspective = 'CAMERA'; s.overlay.show_overlays = False"
    )
    window.do(LOOKS)
    window.do(SKY.replace("ELEVATION", "0.6"))
    window.do("s.shading.type = 'RENDERED'")
    left, top, right, bottom = window.box("VIEW_3D")
    start, bright, dark = time.monotonic(), 0, 0
    while not bright > dark + 20 and time.monotonic() - start < LONG:
        time.sleep(1.0)
        picture = window.shot("sky").mean(axis=2)
        bright, dark = picture[(top + bottom) // 2, (left + right) // 2], picture[bottom - 30, left + 30]
    assert bright > dark + 20
    window.until(f"not {THREADS}")
    # Blender makes a preview of the sky's own, too.
    assert float(window.do(LONGEST)) < 2 * BLOCKED
    window.do("s.shading.type = 'WIREFRAME'; texture.sun_elevation = 0.9")
    window.press("96")
    window.until(RENDERING)
    window.until(f"not {RENDERING}")
    window.do("bpy.data.images['Render Result'].save_render(WORK + '/window-sky.png')")
    with Image.open(window.work / "window-sky.png") as image:
        grey = image.convert("L")
        assert grey.getpixel((80, 60)) > 20 + grey.getpixel((2, 2))
    window.do(CLOSE)
    window.until("len(bpy.context.window_manager.windows) == 1")
    window.do(NO_SKY)
    window.until(f"not {THREADS}")


def test_a_click_on_the_button_renders_into_the_image(window):
    left, top, right, _ = window.box("PROPERTIES")
    window.do("area('PROPERTIES').spaces.active.context = 'RENDER'")
    middle = (left + right) // 2
    row = window._tool("find_button", window.suite, "mrpnn.render", str(middle), str(top + 90), str(top + 260))
    window.mouse("mousemove", middle, row)
    time.sleep(0.5)
    window.mouse("click", 1)
    window.until("'MRPNN' in bpy.data.images")
    assert window.do("print(*bpy.data.images['MRPNN'].size)") == "160 120"
    window.do("bpy.data.images.remove(bpy.data.images['MRPNN'])")
    window.until(f"not {THREADS}")


def test_a_click_on_check_scene_lists_what_is_left_out(window):
    window.do(
        "import sys; check = next(m for n, m in sys.modules.items() if n.endswith('mrpnn_addon.status.scene_check'))\n"
        "lost = bpy.data.volumes.new('Lost'); lost.filepath = WORK + '/lost.vdb'\n"
        "lost = bpy.data.objects.new('Lost', lost); bpy.context.scene.collection.objects.link(lost)\n"
        "area('PROPERTIES').spaces.active.context = 'RENDER'"
    )
    left, top, right, bottom = window.box("PROPERTIES")
    middle, said = (left + right) // 2, window.console
    try:
        row = window._tool("find_button", window.suite, "mrpnn.check", str(middle - 40), str(top + 150), str(bottom))
        window.mouse("mousemove", middle - 40, row)
        time.sleep(0.5)
        window.mouse("click", 1)
        window.until("check.last_check() is not None")
        told = window.do("print(*check.last_check().warnings)")
        window.shot("check-scene", (left, top, right, bottom))
    finally:
        window.do("bpy.data.objects.remove(lost)")
    assert '"Lost"' in told and "file not found" in told
    assert "Traceback" not in window.console[len(said) :]


def test_esc_in_the_viewport_stops_nothing(window):
    """It belongs to Blender's own tools; the pictures go on to the last one."""
    window.do(
        "import gc; s = area('VIEW_3D').spaces.active; s.region_3d.view_perspective = 'CAMERA'\n"
        "shown = region(area('VIEW_3D')); s.shading.type = 'RENDERED'"
    )
    said = window.console
    try:
        for _ in range(3):
            window.press("Escape")
        window.until(f"{PICTURE} == [round(edge / 4) for edge in (shown.width, shown.height)]")
    finally:
        window.do("s.shading.type = 'WIREFRAME'")
        window.until(f"not {THREADS}")
    assert "Traceback" not in window.console[len(said) :]


@pytest.mark.newest
def test_loading_a_file_during_a_render_ends_the_render(window):
    """By the operator and by the render engine; the next render works."""
    load = "bpy.ops.wm.open_mainfile(filepath=WORK + '/window.blend'); scene = bpy.context.scene"
    window.do(f"import threading; {load}")
    for begin in (
        "with over(area('VIEW_3D')): bpy.ops.mrpnn.render('INVOKE_DEFAULT')",
        "bpy.ops.render.render('INVOKE_DEFAULT')",
    ):
        window.do("scene.render.resolution_percentage = 400; scene.mrpnn.depth_samples = 256; scene.mrpnn.threads = 1")
        window.do(begin)
        window.until(f"{THREADS} or {RENDERING}")
        # Scenes that are edited meanwhile are others than those that were read.
        window.do("bpy.data.objects.remove(bpy.data.objects['Ball'])")
        window.do(load)
        window.until(f"not {THREADS} and not {RENDERING}")
        assert window.do("print('MRPNN' in bpy.data.images)") == "False"
    window.do("with over(area('VIEW_3D')): bpy.ops.mrpnn.render('INVOKE_DEFAULT')")
    window.until("'MRPNN' in bpy.data.images")
    window.do("bpy.data.images.remove(bpy.data.images['MRPNN'])")
    window.until(f"not {THREADS}")


LEFT_BEHIND = (
    "sum(len(getattr(bpy.app.handlers, n)) for n in dir(bpy.app.handlers) "
    "if isinstance(getattr(bpy.app.handlers, n), list)), threading.active_count(), len(bpy.data.images), "
    "len(bpy.data.scenes), len(win().screen.areas)"
)


@pytest.mark.newest
def test_fifty_switches_of_engine_scene_and_file_leave_nothing_behind(window):
    """With the preview running whenever it can."""
    window.do("import threading; bpy.ops.wm.open_mainfile(filepath=WORK + '/window.blend')")
    window.do("area('VIEW_3D').spaces.active.shading.type = 'RENDERED'; bpy.ops.wm.save_mainfile()")
    window.do("bpy.ops.wm.open_mainfile(filepath=WORK + '/window.blend')")
    # The preview begins by itself, and ends.
    time.sleep(1.0)
    window.until(f"not {THREADS}")
    before, said = window.do(f"print({LEFT_BEHIND})"), window.console
    for turn in range(50):
        window.do(
            (
                "bpy.context.scene.render.engine = 'BLENDER_WORKBENCH'",
                "bpy.context.scene.render.engine = 'MRPNN'",
                "s = bpy.data.scenes.new('other'); win().scene = s",
                "bpy.data.scenes.remove(bpy.data.scenes['other'])",
                "bpy.ops.wm.open_mainfile(filepath=WORK + '/window.blend')",
            )[turn % 5]
        )
    window.until(f"not {THREADS}")
    assert window.do(f"print({LEFT_BEHIND})") == before
    said = window.console[len(said) :]
    assert not [line for line in said.splitlines() if "Read blend" not in line and line.strip()], said
