# SPDX-License-Identifier: GPL-3.0-or-later
"""Progress and times of a render: all that the user waits for."""

import time

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes
from tests.support.exr_files import header


@pytest.fixture
def cloud(scene, tmp_path):
    scene.render.resolution_x, scene.render.resolution_y = 48, 32
    scene.mrpnn.depth_samples = 2
    scene.render.engine = "MRPNN"
    return blender_scenes.cloud_scene(scene, tmp_path)


def test_the_last_render_and_its_stamp_count_all_that_was_waited_for(addon, scene, cloud, tmp_path, capfd):
    """Reading, the World behind and all view layers, where Blender's clock goes on."""
    blender_scenes.write_multilayer(scene)
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.2
    scene.view_layers.new("Again")
    scene.render.filepath = str(tmp_path / "timed.exr")
    before = time.perf_counter()
    bpy.ops.render.render(write_still=True)
    waited = time.perf_counter() - before
    taken = addon.mrpnn_addon.status.last_render.last_render().seconds
    assert 0.8 * waited < taken < waited
    found = header(tmp_path / "timed.exr")
    parts = [float(found[f"mrpnn.{name}.seconds"]) for name in ("ViewLayer", "Again")]
    assert 0.8 * waited < sum(parts) < waited + 0.02
    # A uniform World is known without Cycles.
    assert "Rendering the sky" not in capfd.readouterr().out
    before = time.perf_counter()
    bpy.ops.mrpnn.render()
    waited = time.perf_counter() - before
    assert 0.8 * waited < addon.mrpnn_addon.status.last_render.last_render().seconds < waited


class Pictures:
    """Takes the pictures of a render, as a window does."""

    def __init__(self):
        self.coarse, self.parts, self.steps = None, [], []

    def show_coarse(self, layer):
        self.coarse = layer
        self.steps.append("coarse")

    def show_part(self, window, layer):
        self.parts.append(window)

    def progress(self, fraction, message):
        self.steps.append(fraction)


def test_the_first_picture_is_a_part_of_the_progress_and_of_the_times(addon, scene, cloud):
    described = addon.mrpnn_addon.scene.reader.read_frame(blender_scenes.depsgraph())
    shown, module = Pictures(), addon.mrpnn_addon.engine.render_job
    before = time.process_time()
    finished = module.render_scene(described, scene.mrpnn.settings(), None, shown.progress, None, {"": shown})
    used = time.process_time() - before
    middle = shown.steps.index("coarse")
    first, second = shown.steps[:middle], shown.steps[middle + 1 :]
    assert first == sorted(first) and second == sorted(second) and first[-1] <= second[0] and second[-1] == 1.0
    assert len({*first}) > 5 and 0.0 < first[1] < first[-1] < 1.0
    # Fields are computed for the first picture alone.
    report = finished.layer.report
    assert report.seconds["fields"] > report.seconds["march"]
    assert 0.8 * used < report.cpu_seconds["total"] < used + 0.01
    assert np.isfinite(shown.coarse.rgb).all()


def test_light_groups_progress_one_after_the_other(addon, scene, cloud):
    for name in ("Key", "Fill"):
        scene.view_layers[0].lightgroups.add(name=name)
        sun = blender_scenes.add_sun(scene, name, rotation=(len(name), 0.0, 0.0))
        sun.lightgroup = name
    described = addon.mrpnn_addon.scene.reader.read_frame(blender_scenes.depsgraph())
    seen = []
    addon.mrpnn_addon.engine.render_job.render_scene(
        described, scene.mrpnn.settings(), progress=lambda fraction, message: seen.append(fraction)
    )
    assert seen == sorted(seen) and seen[-1] == 1.0 and min(seen) < 0.3
