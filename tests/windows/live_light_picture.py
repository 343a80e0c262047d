# SPDX-License-Identifier: GPL-3.0-or-later
"""Make the docs' picture of Live Light: EEVEE's viewport in Blender's window, for three suns.

    MRPNN_WINDOWS=sid python -m tests.windows.live_light_picture

The scene is the gallery's cumulus. Writes docs/images/live-light.jpg.
"""

import sys
import time

import numpy as np
from PIL import Image

from benchmarks.support.pages import IMAGES
from benchmarks.support.pictures import row
from tests.support.window import cumulus

#: EEVEE with fine volumes, between the nearest and the farthest part of the cloud.
EEVEE = """
import sys, threading
from mathutils import Vector
live = next(module for name, module in sys.modules.items() if name.endswith("baking.live"))
eevee, tree, sun = scene.eevee, scene.world.node_tree, bpy.data.objects["Sun"]
scene.render.engine = "BLENDER_EEVEE_NEXT" if bpy.app.version < (5, 0, 0) else "BLENDER_EEVEE"
eevee.volumetric_tile_size, eevee.volumetric_samples, eevee.taa_samples = "4", 128, 16
eevee.use_volumetric_shadows, eevee.volumetric_shadow_samples = True, 64
eevee.use_volume_custom_range, eevee.volumetric_start, eevee.volumetric_end = True, 2.5, 8.0
space.shading.use_scene_lights_render = space.shading.use_scene_world_render = True
scene.mrpnn_light.directional = False
scene.mrpnn_live_light = True
def light(towards, strength, colour, world):
    sun.rotation_euler = Vector(towards).to_track_quat("Z", "Y").to_euler()
    sun.data.energy, sun.data.color = strength, colour
    tree.nodes["Background"].inputs["Strength"].default_value = world
"""
#: Caption; direction to the sun, its strength and colour, and the strength of the World.
SUNS = (
    ("Live Light in EEVEE: a sun at the left", ((-1.0, -0.12, 0.62), 9.5, (1.0, 0.94, 0.86), 0.75)),
    ("turned to the right, at dusk", ((0.95, 0.12, 0.22), 8.0, (1.0, 0.5, 0.22), 0.35)),
    ("turned back, as a moon", ((-0.8, -0.1, 0.5), 1.6, (0.6, 0.72, 1.0), 0.06)),
)
KEY = "''.join(item.key for item in scene.mrpnn_light.volumes)"
DONE = (
    f"'up to date' in live.live_status(scene)[0] and 'coarse' not in {KEY} "
    "and not [thread for thread in threading.enumerate() if thread.name == 'mrpnn bake']"
)
#: The camera's view in the viewport, as left, top, right and bottom in pixels of the window.
VIEW = """
from bpy_extras.view3d_utils import location_3d_to_region_2d as seen
region = next(item for item in area("VIEW_3D").regions if item.type == "WINDOW")
lens, turned = scene.camera, scene.camera.matrix_world
corners = [seen(region, space.region_3d, turned @ corner) for corner in lens.data.view_frame(scene=scene)]
x, y = [region.x + corner.x for corner in corners], [win().height - region.y - corner.y for corner in corners]
print([round(value) for value in (min(x), min(y), max(x), max(y))])
"""
HEIGHT = 240


def view(window) -> np.ndarray:
    """The camera's view, uint8 (H, W, 3), when EEVEE has drawn all its samples."""
    left, top, right, bottom = eval(window.do(VIEW))
    before = None
    while True:
        # Without the frame that Blender draws around it.
        drawn = window.shot("live-light")[top + 2 : bottom - 2, left + 2 : right - 2]
        if before is not None and np.array_equal(before, drawn):
            return drawn
        before = drawn


def pictures(window) -> list[tuple[str, Image.Image]]:
    """Caption and picture of each sun."""
    said = window.do(EEVEE)
    assert not said, said
    made = []
    for caption, values in SUNS:
        # Without a graphics card, EEVEE takes the processor from what bakes.
        window.do("space.shading.type = 'WIREFRAME'")
        window.do(f"light(*{values})")
        # By then Live Light has seen the change.
        time.sleep(2.0)
        window.until(DONE)
        window.do("space.shading.type = 'RENDERED'")
        made.append((caption, Image.fromarray(view(window))))
    return made


def main() -> int:
    with cumulus() as window:
        row(pictures(window), HEIGHT, 15).save(IMAGES / "live-light.jpg", quality=88, optimize=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
