"""The extension in Blender's real window: F12, Esc, the preview, the panels.

MRPNN_WINDOWS names the suites (trixie, sid) that ../shared/blender/make has built in BLENDER_ROOTS.
Screenshots are left in build/window.
"""

import os
import shutil
import subprocess
import time
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
GUI = ROOT.parent / "shared" / "blender" / "gui"
SUITES = os.environ.get("MRPNN_WINDOWS", "").split()

pytestmark = pytest.mark.skipif(not SUITES, reason="MRPNN_WINDOWS names no Blender with a window")

# The ball of fog that all steps look at.
SCENE = """
import numpy
try: import openvdb
except ImportError: import pyopenvdb as openvdb
grid = openvdb.FloatGrid()
axis = numpy.linspace(-1, 1, 48)
radius = numpy.sqrt(sum(a**2 for a in numpy.meshgrid(axis, axis, axis)))
grid.copyFromArray(numpy.clip(1 - radius, 0, None).astype(numpy.float32), ijk=(-24, -24, -24))
grid.name, grid.transform = "density", openvdb.createLinearTransform(1 / 12)
openvdb.write("/mnt/work/window.vdb", grids=[grid])
for item in list(bpy.data.objects): bpy.data.objects.remove(item)
volume = bpy.data.volumes.new("Ball"); volume.filepath = "/mnt/work/window.vdb"
for name, data in (("Ball", volume), ("Sun", bpy.data.lights.new("Sun", "SUN")),
                   ("Camera", bpy.data.cameras.new("Camera"))):
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, data))
scene = bpy.context.scene
scene.camera = bpy.data.objects["Camera"]; scene.camera.location.z = 8
scene.render.engine = "MRPNN"; scene.mrpnn.depth_samples = 2
scene.render.resolution_x, scene.render.resolution_y = 160, 120
print("made")
"""
THREADS = "import threading; print([t.name for t in threading.enumerate() if t.name.startswith('mrpnn')])"


def patience():
    """How many times slower than alone this machine is just now, at least 1."""
    return max(1.0, os.getloadavg()[0] / os.cpu_count())


class Window:
    """A running Blender: `do` runs Python in it and gives what that prints."""

    def __init__(self, suite):
        self.suite = suite

    def _gui(self, what, *arguments):
        run = subprocess.run([GUI, what, self.suite, *arguments], capture_output=True, text=True, timeout=120)
        assert run.returncode == 0, run.stdout + run.stderr
        return run.stdout.strip()

    def start(self):
        # Not through a pipe: the window inherits it and keeps it open.
        with open(os.devnull, "w") as nowhere:
            subprocess.run([GUI, "start", self.suite], stdout=nowhere, stderr=nowhere, timeout=120, check=True)

    def do(self, code):
        return self._gui("do", code)

    def press(self, *keys):
        self._gui("x", "key", *keys)

    def shot(self, name):
        self._gui("shot", f"{name}.png")
        target = ROOT / "build" / "window" / f"{name}-{self.suite}.png"
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(Path(os.environ["BLENDER_ROOTS"]) / "work" / f"{name}.png", target)

    def until(self, expression, seconds):
        """Wait until an expression holds, so many seconds on a machine that has nothing else to do."""
        start = time.monotonic()
        while self.do(f"print(bool({expression}))") != "True":
            assert time.monotonic() - start < seconds * patience(), expression
            time.sleep(0.1)


@pytest.fixture(scope="module", params=SUITES)
def window(request):
    import build_extension

    (package,) = [path for path in build_extension.build() if "linux_x64" in path.name]
    shutil.copy(package, Path(os.environ["BLENDER_ROOTS"]) / "work" / "window.zip")
    window = Window(request.param)
    window.start()
    window.do("bpy.ops.extensions.package_install_files(filepath='/mnt/work/window.zip', repo='user_default', "
              "enable_on_install=True, overwrite=True)")
    assert window.do(SCENE).endswith("made")
    yield window
    subprocess.run([GUI, "stop", request.param], timeout=60)


def test_the_panels_draw_and_say_nothing_on_the_console(window):
    log = Path(os.environ["BLENDER_ROOTS"]) / "work" / f"run-{window.suite}" / "blender.log"
    before = log.read_text()
    for context in ("RENDER", "VIEW_LAYER", "OBJECT"):
        window.do("bpy.context.view_layer.objects.active = bpy.data.objects['Ball']\n"
                  f"a = area('PROPERTIES'); a.spaces.active.context = '{context}'; a.tag_redraw()")
        time.sleep(1.0)
    window.do("a = area('PROPERTIES'); a.spaces.active.context = 'RENDER'")
    time.sleep(1.0)
    window.shot("panels")
    assert "Traceback" not in log.read_text()[len(before):]


def test_rendered_shading_shows_the_volume_and_leaves_no_thread(window):
    window.do("s = area('VIEW_3D').spaces.active; s.region_3d.view_perspective = 'CAMERA'; s.shading.type = 'RENDERED'")
    # A thread while it refines, none once the last picture is there.
    time.sleep(1.0)
    window.until("not [t for t in __import__('threading').enumerate() if t.name == 'mrpnn preview']", 120)
    time.sleep(1.0)
    window.shot("preview")
    # The window answers while it orbits and refines.
    slowest = 0.0
    for angle in range(5):
        start = time.monotonic()
        window.do("r = area('VIEW_3D').spaces.active.region_3d; r.view_perspective = 'PERSP'\n"
                  f"r.view_rotation = (1.0, 0.1 * {angle}, 0.0, 0.0)")
        slowest = max(slowest, time.monotonic() - start)
    # Most of it is the wait for the answer's file.
    assert slowest < patience()
    window.do("area('VIEW_3D').spaces.active.shading.type = 'SOLID'")
    window.until("not [t for t in __import__('threading').enumerate() if t.name == 'mrpnn preview']", 10)


def test_f12_renders_and_esc_stops(window):
    running = "bpy.app.is_job_running('RENDER')"
    window.do("bpy.context.scene.render.resolution_percentage = 400; bpy.context.scene.mrpnn.depth_samples = 256")
    # Keycode 96 is F12; the name means Alt+F12 in some keyboard maps.
    window._gui("x", "mousemove", "600", "400")
    window.press("96")
    window.until(running, 20)
    time.sleep(1.0)
    window.press("Escape")
    # A second, and what it takes to ask.
    window.until(f"not {running}", 2)
    window.press("Escape")
    window.do("bpy.context.scene.render.resolution_percentage = 100; bpy.context.scene.mrpnn.depth_samples = 2")
    window._gui("x", "mousemove", "600", "400")
    window.press("96")
    window.until(running, 20)
    window.until(f"not {running}", 120)
    time.sleep(1.0)
    window.shot("render")
    window.do("bpy.data.images['Render Result'].save_render('/mnt/work/window-result.png')")
    from PIL import Image
    with Image.open(Path(os.environ["BLENDER_ROOTS"]) / "work" / "window-result.png") as picture:
        assert picture.size == (160, 120)
        grey = picture.convert("L")
        assert grey.getpixel((80, 60)) > 20 + grey.getpixel((2, 2))
    assert window.do(THREADS) == "[]"
