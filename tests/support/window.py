# SPDX-License-Identifier: GPL-3.0-or-later
"""A Blender with a window, driven by tests: Python in it, real mouse and keys, screenshots.

MRPNN_WINDOWS names the suites (trixie, sid) that ../shared/blender/make has built in BLENDER_ROOTS.
Screenshots are left in build/window; `python -m tests.windows.screenshots` makes those of docs/images. Those Blenders
see the folder `work` of BLENDER_ROOTS as /mnt/work, the tools' convention; each has a folder of its own in it, which
its code calls WORK, so that both can be driven at the same time.
"""

import contextlib
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.support.paths import ROOT, SHARED

TOOLS = SHARED / "blender"
SUITES = os.environ.get("MRPNN_WINDOWS", "").split()
NEEDS_WINDOW = [
    pytest.mark.window,
    pytest.mark.skipif(not SUITES, reason="MRPNN_WINDOWS names no Blender with a window"),
]
# Seconds within which anything must happen, however busy the machine.
LONG = 300

# A small cloud in red light and a black World, and Properties as high as the window.
SCENE = """
import numpy, threading
try: import openvdb
except ImportError: import pyopenvdb as openvdb
grid = openvdb.FloatGrid()
axis = numpy.linspace(-1, 1, 48)
x, y, z = numpy.meshgrid(axis, axis, axis, indexing="ij")
puffs = 0.6 - numpy.sqrt(x**2 + y**2 + z**2) + 0.35 * numpy.sin(7 * x) * numpy.sin(6 * y + 1) * numpy.sin(8 * z + 2)
grid.copyFromArray(numpy.clip(8 * puffs, 0, 2).astype(numpy.float32), ijk=(-24, -24, -24))
grid.name, grid.transform = "density", openvdb.createLinearTransform(1 / 12)
openvdb.write(WORK + "/window.vdb", grids=[grid])
for item in list(bpy.data.objects): bpy.data.objects.remove(item)
volume = bpy.data.volumes.new("Ball"); volume.filepath = WORK + "/window.vdb"
sun = bpy.data.lights.new("Sun", "SUN"); sun.energy, sun.color = 10, (1, 0.5, 0.3)
for name, data in (("Ball", volume), ("Sun", sun), ("Camera", bpy.data.cameras.new("Camera"))):
    bpy.context.scene.collection.objects.link(bpy.data.objects.new(name, data))
scene = bpy.context.scene
bpy.data.objects["Sun"].rotation_euler = 0.9, 0.3, 0
scene.camera = bpy.data.objects["Camera"]; scene.camera.location.z = 8
scene.render.engine = "MRPNN"; scene.mrpnn.depth_samples = 4
scene.render.resolution_x, scene.render.resolution_y = 160, 120
scene.render.preview_pixel_size = "4"
scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0
bpy.context.view_layer.objects.active = bpy.data.objects["Ball"]
# Without a graphics driver, drawing takes most of the time: Solid shading a second for every picture of a volume.
area("VIEW_3D").spaces.active.shading.type = "WIREFRAME"
system = bpy.context.preferences.system; system.viewport_aa, system.use_overlay_smooth_wire = "OFF", False
outliner, panels = area("OUTLINER"), area("PROPERTIES")
with over(outliner):
    bpy.ops.screen.area_join(source_xy=(panels.x + 40, panels.y + 40), target_xy=(outliner.x + 40, outliner.y + 40))
bpy.ops.wm.save_as_mainfile(filepath=WORK + "/window.blend")
print("made")
"""
CUMULUS = "noon"
#: Opens this scene of the gallery, seen by its camera: each in a turn of Blender's main loop of its own.
OPEN_CUMULUS = (
    "bpy.ops.wm.open_mainfile(filepath=WORK + '/" + CUMULUS + ".blend', load_ui=False)",
    """
import threading
scene = bpy.context.scene
scene.render.resolution_x, scene.render.resolution_y, scene.mrpnn.depth_samples = 960, 540, 4
# The scene's own engine is chosen in the first step.
scene.render.engine = "CYCLES"
bpy.context.preferences.system.viewport_aa = "OFF"
bpy.context.preferences.view.render_display_type = "AREA"
outliner, panels = area("OUTLINER"), area("PROPERTIES")
with over(outliner):
    bpy.ops.screen.area_join(source_xy=(panels.x + 40, panels.y + 40), target_xy=(outliner.x + 40, outliner.y + 40))
""",
    """
space = area("VIEW_3D").spaces.active
space.region_3d.view_perspective, space.overlay.show_overlays, space.shading.type = "CAMERA", False, "SOLID"
space.show_region_toolbar = space.show_gizmo = False
area("PROPERTIES").spaces.active.context = "RENDER"
print("made")
""",
)
THREADS = "[t.name for t in threading.enumerate() if t.name.startswith('mrpnn')]"
RENDERING = "bpy.app.is_job_running('RENDER')"
# Windows of renders and preferences lie over the viewport, and Escape may go elsewhere.
CLOSE = """
for other in [one for one in bpy.context.window_manager.windows if one.screen.is_temporary]:
    with bpy.context.temp_override(window=other): bpy.ops.wm.window_close()
"""

# Blender keeps one flag for "scripts must not write", which each call of a method of a class saves and restores. A
# render thread that begins while a panel is drawn restores it out of order, and it stays set for good: operators that
# a timer calls fail. The same trick clears it: a method that may write returns while an operator runs on a thread.
STUCK = "can't modify blend data in this state (drawing/rendering)"
CLEARING = """
import bpy, threading, time
class Wait(bpy.types.Operator):
    bl_idname, bl_label = "wm.wait", "Wait"
    def execute(self, context):
        time.sleep(0.5)
        return {"FINISHED"}
class Clearing(bpy.types.NodeTree):
    bl_idname, bl_label, bl_icon = "Clearing", "Clearing", "NODETREE"
    def update(self):
        threading.Thread(target=bpy.ops.wm.wait).start()
        time.sleep(0.2)
bpy.utils.register_class(Wait)
bpy.utils.register_class(Clearing)
"""
CLEAR = """
tree = bpy.data.node_groups.new("Clearing", "Clearing")
time.sleep(1.0)
bpy.data.node_groups.remove(tree)
"""


class Window:
    """A running Blender: `do` runs Python in it and returns what that prints.

    work: its folder, which it sees as `seen_work`.
    """

    def __init__(self, suite):
        self.suite = suite
        shared = Path(os.environ["BLENDER_ROOTS"]) / "work"
        self.run, self.work, self.seen_work = shared / f"run-{suite}", shared / suite, f"/mnt/work/{suite}"
        self.work.mkdir(parents=True, exist_ok=True)

    def _tool(self, tool, *arguments):
        run = subprocess.run(
            [TOOLS / tool, *arguments],
            capture_output=True,
            text=True,
            timeout=2 * LONG,
            env={**os.environ, "WAIT": str(10 * LONG), "OPENBLAS_NUM_THREADS": "1"},
        )
        assert run.returncode == 0, run.stdout + run.stderr
        return run.stdout.strip()

    def start(self):
        # Not through a pipe: the window inherits it and keeps it open.
        with open(os.devnull, "w") as nowhere:
            subprocess.run(
                [TOOLS / "gui", "start", self.suite],
                stdout=nowhere,
                stderr=nowhere,
                timeout=LONG,
                check=True,
                env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
            )
        self.do(CLEARING)

    def stop(self):
        subprocess.run([TOOLS / "gui", "stop", self.suite], timeout=60)

    def do(self, code):
        """Run Python in Blender's main thread; gives what it prints."""
        answer = self._do(code)
        if STUCK in answer:
            self._do(CLEAR)
            answer = self._do(code)
        return answer

    def _do(self, code):
        """By the files of `gui do`, without its shell, which looks for the answer ten times a second."""
        number = time.time_ns()
        begun, sent, answer = (self.run / "ctl" / f"{number}.{ending}" for ending in ("part", "py", "out"))
        begun.write_text(code + "\n")
        begun.rename(sent)
        start = time.monotonic()
        while not answer.exists():
            process = Path("/proc", (self.run / "blender.pid").read_text().strip())
            assert process.exists(), f"Blender has ended: {self.console[-2000:]}"
            waited = time.monotonic() - start
            assert waited < LONG, "Blender does not answer"
            time.sleep(0.02 if waited < 1.0 else 0.1)
        return answer.read_text().strip()

    def mouse(self, *arguments):
        self._tool("gui", "x", self.suite, *map(str, arguments))

    def press(self, key):
        # Keys go to the area under the pointer: the viewport.
        self.mouse("mousemove", 600, 400)
        self.mouse("key", key)

    def shot(self, name, box=None):
        """The screen, uint8 (H, W, 3); saves it, or a box (left, top, right, bottom) of it."""
        # Two answers from the main loop lie two drawings apart.
        self.do("[a.tag_redraw() for w in bpy.context.window_manager.windows for a in w.screen.areas]")
        time.sleep(1.0)
        self.do("pass")
        target = ROOT / "build" / "window" / f"{name}-{self.suite}.png"
        target.parent.mkdir(parents=True, exist_ok=True)
        screen = self.screen()
        left, top, right, bottom = box or (0, 0, screen.shape[1], screen.shape[0])
        Image.fromarray(screen[top:bottom, left:right]).save(target)
        return screen

    def screen(self):
        """The screen as it is, uint8 (H, W, 3)."""
        # Uncompressed: a PNG of it takes half a second. Its 16 bits a value take Pillow three seconds.
        self._tool("gui", "shot", self.suite, f"{self.suite}/screen.ppm")
        data = (self.work / "screen.ppm").read_bytes()
        kind, width, height, most = data[:30].split()[:4]
        assert (kind, most) == (b"P6", b"65535"), (kind, most)
        shape = int(height), int(width), 3
        return (np.frombuffer(data[-2 * np.prod(shape) :], ">u2").reshape(shape) >> 8).astype(np.uint8)

    def box(self, kind):
        """An area's rectangle on the screen: (left, top, right, bottom)."""
        return eval(
            self.do(
                f"a = area('{kind}'); print((a.x, win().height - a.y - a.height, a.x + a.width, win().height - a.y))"
            )
        )

    def until(self, expression):
        start = time.monotonic()
        while self.do(f"print(bool({expression}))") != "True":
            assert time.monotonic() - start < LONG, expression
            time.sleep(0.1)

    @property
    def console(self):
        """Blender's console output so far."""
        return (self.run / "blender.log").read_text()


@contextlib.contextmanager
def opened(suite, extension):
    """A running Blender of a suite with the extension of a zip."""
    window = Window(suite)
    # Blender keeps a wheel of the same version, which an earlier run has installed with other kernels.
    home = Path(os.environ["BLENDER_ROOTS"], suite, "root", ".config", "blender")
    for stale in home.glob("*/extensions/.local/lib/*/site-packages/mrpnn_kernels*"):
        shutil.rmtree(stale)
    shutil.copy(extension, window.work / "window.zip")
    window.start()
    try:
        window.do(f"WORK = '{window.seen_work}'")
        said = window.do(
            "bpy.ops.extensions.package_install_files(filepath=WORK + '/window.zip', repo='user_default', "
            "enable_on_install=True, overwrite=True); print(hasattr(bpy.context.scene, 'mrpnn'))"
        )
        assert said.endswith("True"), said + window.console[-2000:]
        yield window
    finally:
        window.stop()


@contextlib.contextmanager
def cumulus():
    """The window of the last Blender that MRPNN_WINDOWS names, with the gallery's cumulus seen by its camera."""
    import build_extension

    assert SUITES, "MRPNN_WINDOWS names no Blender with a window"
    suite, made = SUITES[-1], ROOT / "build" / "gallery"
    if not (made / f"{CUMULUS}.blend").exists():
        subprocess.run([sys.executable, "-m", "gallery", CUMULUS], cwd=ROOT, check=True)
    ending = "linux_x64-any_python.zip" if suite == "sid" else "linux_x64.zip"
    (extension,) = [path for path in build_extension.build() if path.name.endswith(ending)]
    with opened(suite, extension) as window:
        shutil.copy(made / f"{CUMULUS}.blend", window.work)
        shutil.copytree(made / "volumes", window.work / "volumes", dirs_exist_ok=True)
        for code in OPEN_CUMULUS:
            said = window.do(code)
        assert said.endswith("made"), said
        yield window
