# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the docs' pictures of Blender's window: the first steps with the gallery's cumulus.

    MRPNN_WINDOWS=sid python -m tests.windows.screenshots

The Blender is the last that MRPNN_WINDOWS names. The zip is built, and the scene made where build/gallery lacks it.
Writes docs/images/engine-menu.png, panel.png, viewport.png, render.png, workflow.jpg and workflow.webp, an animation of
20 seconds.
"""

import sys
import time

from PIL import Image

from benchmarks.support.pages import IMAGES
from gallery.page import steps
from tests.support.paths import ROOT
from tests.support.window import LONG, RENDERING, THREADS, cumulus

# Frames of the animation: their width in pixels, and the milliseconds that each is shown.
WIDTH, SHOWN = 960, 1000
#: The interface's scale in the animation, where it is shown smaller; and the height of the panel's picture in pixels.
SCALE, PANEL = 1.25, 770
#: From the render, which takes the place of the largest area, to the viewport.
BACK = "with over(area('IMAGE_EDITOR')): bpy.ops.render.view_cancel()"


def engine_menu(window, scale: float):
    """Open the menu of render engines; the box of it and of what is around."""
    left, top, right, _ = window.box("PROPERTIES")
    window.mouse("mousemove", round((left + right) / 2 + 60 * scale), round(top + 78 * scale))
    time.sleep(0.5)
    window.mouse("click", 1)
    time.sleep(1.0)
    return left - 200, top, right, top + 300


def refined(window) -> None:
    """Wait for the viewport's last picture."""
    time.sleep(1.0)
    window.until(f"not {THREADS}")


def stills(window) -> None:
    """The pictures of docs/use/install.md."""
    made = {}

    def shot(name, box):
        window.shot(name, box)
        made[name] = ROOT / "build" / "window" / f"{name}-{window.suite}.png"

    window.do("scene.render.engine = 'MRPNN'")
    shot("engine-menu", engine_menu(window, 1.0))
    window.press("Escape")
    left, top, right, _ = window.box("PROPERTIES")
    shot("panel", (left, top, right, top + PANEL))
    window.do("space.shading.type = 'RENDERED'")
    refined(window)
    shot("viewport", window.box("VIEW_3D"))
    window.do("space.shading.type = 'SOLID'")
    render(window)
    shot("render", window.box("IMAGE_EDITOR"))
    window.do(BACK)
    for name, path in made.items():
        with Image.open(path) as image:
            image.convert("RGB").quantize(256, dither=Image.Dither.FLOYDSTEINBERG).save(
                IMAGES / f"{name}.png", optimize=True
            )


def render(window, meanwhile=lambda: None) -> None:
    """Press F12 and wait; keycode 96 is F12 in every keyboard map."""
    window.press("96")
    window.until(RENDERING)
    start = time.monotonic()
    while window.do(f"print({RENDERING})") == "True":
        assert time.monotonic() - start < LONG
        meanwhile()


def animation(window) -> list[Image.Image]:
    """The same steps, frame by frame, and the sun turned in the viewport."""
    frames = []

    def keep(times=1):
        image = Image.fromarray(window.shot("frame"))
        frames.extend([image.resize((WIDTH, round(image.height * WIDTH / image.width)), Image.LANCZOS)] * times)

    window.do(f"bpy.context.preferences.view.ui_scale = {SCALE}; scene.render.engine = 'CYCLES'")
    keep(2)
    engine_menu(window, SCALE)
    keep(2)
    window.press("Escape")
    window.do("scene.render.engine = 'MRPNN'")
    keep(2)
    window.do("space.shading.type = 'RENDERED'")
    keep()
    refined(window)
    keep(2)
    for turn in range(4):
        window.do("bpy.data.objects['Sun'].rotation_euler.z += 0.8")
        refined(window)
        keep(1 + turn // 3)
    window.do("space.shading.type = 'SOLID'")
    render(window, keep)
    del frames[20 - 4 : -1]
    keep(20 - len(frames))
    return frames


def main() -> int:
    with cumulus() as window:
        stills(window)
        first, *others = animation(window)
    first.save(IMAGES / "workflow.webp", save_all=True, append_images=others, duration=SHOWN, loop=0, quality=70)
    steps().save(IMAGES / "workflow.jpg", quality=88, optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
