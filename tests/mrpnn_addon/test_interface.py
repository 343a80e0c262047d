# SPDX-License-Identifier: GPL-3.0-or-later
"""Properties, preferences and the panels' texts, in real Blender; and that nothing is left behind."""

import gc
import re
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import Settings, render
from inference.network.provider import PROVIDERS
from inference.scene.optimizations import ALL, OPTIMIZATIONS
from tests.support import blender_scenes

EXPECTED_ERROR = (
    r"[\d.]+ % \([\d.]+\u2013[\d.]+ %\), "
    r"mostly in the ((upper|lower) (left|right)|(upper|lower|left|right) part|middle)(, at the rim)?"
)


@pytest.fixture
def cloud(scene, tmp_path):
    scene.render.resolution_x, scene.render.resolution_y = 32, 24
    return blender_scenes.cloud_scene(scene, tmp_path)


def test_presets_set_the_samples_and_samples_show_the_preset(scene):
    settings = scene.mrpnn
    assert (settings.preset, settings.depth_samples) == ("DRAFT", 4)
    settings.preset = "FINAL"
    assert settings.depth_samples == 16
    settings.depth_samples = 5
    assert settings.preset == "CUSTOM"
    settings.preset = "CUSTOM"
    assert settings.depth_samples == 5


def test_optimizations_are_chosen_one_by_one(addon, scene):
    assert scene.mrpnn.optimizations == set(OPTIMIZATIONS) and scene.mrpnn.settings().optimizations == ALL
    scene.mrpnn.optimizations = {"empty_space", "shared_pixels"}
    assert scene.mrpnn.settings().optimizations == {"empty_space", "shared_pixels"}
    scene.mrpnn.optimizations = set()
    assert scene.mrpnn.settings().optimizations == frozenset()


def test_preferences_apply_where_the_scene_sets_nothing(addon, scene):
    assert scene.mrpnn.settings().memory_limit == 8 << 30
    entry = bpy.context.preferences.addons.new()
    entry.module = "mrpnn"
    try:
        entry.preferences.threads, entry.preferences.memory_limit = 3, 5
        entry.preferences.model, entry.preferences.provider = "mrpnn-narrow", "OPENVINO"
        found = scene.mrpnn.settings()
        assert (found.threads, found.memory_limit) == (3, 5 << 30)
        assert (found.model, found.provider) == ("mrpnn-narrow", "OPENVINO")
        scene.mrpnn.threads, scene.mrpnn.memory_limit, scene.mrpnn.model = 2, 4, "mrpnn-wide"
        found = scene.mrpnn.settings()
        assert (found.threads, found.memory_limit, found.model) == (2, 4 << 30, "mrpnn-wide")
    finally:
        bpy.context.preferences.addons.remove(entry)


def test_the_preferences_offer_every_provider(addon, scene):
    items = addon.mrpnn_addon.settings.preferences._PROVIDER_ITEMS
    assert [item[0] for item in items] == list(PROVIDERS)


def test_files_of_the_first_version_are_brought_up_to_date(addon, scene, tmp_path, capfd):
    """There, networks were numbered by their position in the list."""
    scene.mrpnn.depth_samples, scene.mrpnn.memory_limit = 12, 6
    stored = scene.mrpnn.bl_system_properties_get(do_create=True) if bpy.app.version >= (5, 0, 0) else scene["mrpnn"]
    stored["model"], stored["version"] = 0, 0
    path = str(tmp_path / "old.blend")
    bpy.app.handlers.save_pre.remove(addon.mrpnn_addon.settings.properties._before_save)
    try:
        bpy.ops.wm.save_as_mainfile(filepath=path)
    finally:
        bpy.app.handlers.save_pre.append(addon.mrpnn_addon.settings.properties._before_save)
    capfd.readouterr()
    bpy.ops.wm.open_mainfile(filepath=path)
    settings = bpy.context.scene.mrpnn
    assert (settings.version, settings.model) == (addon.mrpnn_addon.settings.properties.VERSION, "mrpnn")
    assert (settings.depth_samples, settings.memory_limit) == (12, 6)
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=path)
    assert bpy.context.scene.mrpnn.model == "mrpnn"
    said = capfd.readouterr()
    assert "enum" not in said.out + said.err


def test_files_in_which_optimizations_had_another_name_load(addon, scene, tmp_path):
    """The same bits. Number 9 was that of an optimization that is gone."""
    properties = addon.mrpnn_addon.settings.properties
    stored = properties.stored_properties(scene)
    stored["leave_out"], stored["version"] = 1 << 1 | 1 << 9 | 1 << 10 | 1 << 12, 2
    path = str(tmp_path / "old.blend")
    bpy.app.handlers.save_pre.remove(properties._before_save)
    try:
        bpy.ops.wm.save_as_mainfile(filepath=path)
    finally:
        bpy.app.handlers.save_pre.append(properties._before_save)
    for _ in range(2):
        bpy.ops.wm.open_mainfile(filepath=path)
        settings = bpy.context.scene.mrpnn
        assert settings.settings().optimizations == {"empty_space", "unchanged", "shared_pixels"}
        assert settings.version == properties.VERSION
        assert "leave_out" not in properties.stored_properties(bpy.context.scene)
        bpy.ops.wm.save_mainfile()


@pytest.mark.parametrize("directions", [0, 5])
def test_files_with_world_directions_load(addon, scene, tmp_path, capfd, directions):
    """They were a number of parallel lights; 0 left out the World, which its ray visibility does now."""
    properties = addon.mrpnn_addon.settings.properties
    scene.world.cycles_visibility.scatter = True
    scene.mrpnn.depth_samples, scene.mrpnn.model = 12, "mrpnn-wide"
    stored = properties.stored_properties(scene)
    stored["world_directions"], stored["version"] = directions, 1
    path = str(tmp_path / "old.blend")
    bpy.app.handlers.save_pre.remove(properties._before_save)
    try:
        bpy.ops.wm.save_as_mainfile(filepath=path)
    finally:
        bpy.app.handlers.save_pre.append(properties._before_save)
    capfd.readouterr()
    bpy.ops.wm.open_mainfile(filepath=path)
    scene = bpy.context.scene
    settings = scene.mrpnn
    assert (settings.version, settings.depth_samples, settings.model) == (properties.VERSION, 12, "mrpnn-wide")
    assert scene.world.cycles_visibility.scatter == (directions > 0)
    assert "world_directions" not in properties.stored_properties(scene)
    assert ("0 World Directions" in capfd.readouterr().out) == (directions == 0)
    # Chosen anew it stays.
    scene.world.cycles_visibility.scatter = True
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.open_mainfile(filepath=path)
    assert bpy.context.scene.world.cycles_visibility.scatter


def test_the_estimate_counts_what_a_render_does(addon, scene, cloud):
    blender_scenes.add_sun(scene, "Second", rotation=(1.0, 0.0, 0.0))
    found = addon.mrpnn_addon.status.forecast.forecast(blender_scenes.depsgraph())
    assert (found.volumes, found.suns, found.problem) == (1, 2, "")
    bpy.ops.mrpnn.render()
    counts = addon.mrpnn_addon.status.last_render.last_render()
    # As the panel says it.
    assert re.fullmatch(EXPECTED_ERROR, counts.expected_error)
    # The bounds contain all pixels that show the cloud, which does not fill them.
    assert 0.3 * found.points < counts.points <= found.points < 32 * 24 * 8 * 2
    scene.camera.location.z = 0.5
    inside = addon.mrpnn_addon.status.forecast.forecast(blender_scenes.depsgraph())
    assert inside.pixels == 32 * 24


def test_the_estimates_bounds_follow_the_camera(addon, scene, cloud):
    """For shifted, orthographic and rotated cameras: no pixel that shows the cloud is outside."""
    lens = scene.camera.data
    for kind, shift in (("PERSP", (0.2, -0.1)), ("ORTHO", (-0.3, 0.2))):
        lens.type, lens.ortho_scale, (lens.shift_x, lens.shift_y) = kind, 5.0, shift
        scene.camera.rotation_euler = (0.1, 0.15, 0.4)
        graph = blender_scenes.depsgraph()
        described = addon.mrpnn_addon.scene.reader.read_scene(graph)
        alpha = render(described.volumes, described.suns, described.camera, Settings(1)).alpha
        boxes = [box for box, _ in described.boxes]
        covered = addon.mrpnn_addon.objects.workload.pixels_around(boxes, described.camera)
        assert np.all(covered[alpha > 0]) and alpha.max() > 0.1
        assert covered.sum() < 4 * (alpha > 0).sum()


def test_the_check_lists_what_is_left_out_and_becomes_outdated(addon, scene, cloud, tmp_path):
    lamp = blender_scenes.add_object(scene, "Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.visible_volume_scatter = False
    check = addon.mrpnn_addon.status.scene_check
    assert bpy.ops.mrpnn.check() == {"FINISHED"}
    found = check.last_check()
    assert any('"Lamp"' in warning for warning in found.warnings) and found.memory > 0
    assert not found.outdated(scene)
    assert found.voxels == {"Cloud": (16, 16, 16)} and not found.error
    scene.camera.location.x = 1.0
    blender_scenes.depsgraph().update()
    assert found.outdated(scene)
    cloud.data.filepath = str(tmp_path / "gone.vdb")
    with pytest.raises(RuntimeError, match='"Cloud": file not found'):
        bpy.ops.mrpnn.check()
    assert "gone.vdb" in check.last_check().error


def test_a_missing_onnxruntime_is_named(addon, monkeypatch):
    monkeypatch.setattr(sys, "path", [])
    for name in [name for name in sys.modules if name.partition(".")[0] == "onnxruntime"]:
        monkeypatch.delitem(sys.modules, name)
    runtime = addon.mrpnn_addon.runtime.onnxruntime_version
    assert runtime.runtime_version() is None and runtime.check_runtime() == []
    assert runtime.runtime_problem().startswith("onnxruntime, which MRPNN Volumes brings, is missing. Uninstall MRPNN")


def test_a_zip_without_onnxruntime_says_so_and_takes_the_one_it_finds(addon, monkeypatch, tmp_path):
    import build_extension

    runtime = addon.mrpnn_addon.runtime.onnxruntime_version
    name = "blender_manifest.toml"
    files = build_extension.without_onnxruntime({name: (build_extension.ROOT / name).read_bytes()})
    (tmp_path / name).write_bytes(files[name])
    monkeypatch.setattr(runtime, "MANIFEST", tmp_path / name)
    runtime.shipped_version.cache_clear()
    try:
        assert runtime.runtime_version() and runtime.runtime_problem() == "" and runtime.check_runtime() == []
        monkeypatch.setattr(sys, "path", [])
        for loaded in [loaded for loaded in sys.modules if loaded.partition(".")[0] == "onnxruntime"]:
            monkeypatch.delitem(sys.modules, loaded)
        assert runtime.runtime_problem() == "This zip of MRPNN Volumes brings no onnxruntime for Python {}.{}".format(
            *sys.version_info
        )
    finally:
        runtime.shipped_version.cache_clear()


def test_the_shipped_onnxruntime_is_that_of_the_manifest(addon):
    """Of every platform and Python, and the tests run the one for theirs."""
    import onnxruntime

    import build_extension

    runtime = addon.mrpnn_addon.runtime.onnxruntime_version
    shipped = runtime.shipped_version
    platforms = {
        "manylinux_2_28_x86_64": ("linux", "x86_64"),
        "manylinux_2_28_aarch64": ("linux", "aarch64"),
        "win_amd64": ("win32", "AMD64"),
        "win_arm64": ("win32", "ARM64"),
        "macosx_14_0_arm64": ("darwin", "arm64"),
    }
    for name in build_extension.manifest()["wheels"]:
        package, version, tag, _, built_for = Path(name).stem.split("-")
        if package.endswith("onnxruntime"):
            system, machine = platforms[built_for.rpartition(".")[2]]
            assert shipped(system, machine, (3, int(tag.removeprefix("cp3")))) == version
    assert shipped("darwin", "x86_64", (3, 11)) is None and shipped("linux", "x86_64", (3, 14)) is None
    assert shipped() == onnxruntime.__version__ and runtime.check_runtime() == []


def _left_behind():
    handlers = sum(
        len(getattr(bpy.app.handlers, name))
        for name in dir(bpy.app.handlers)
        if isinstance(getattr(bpy.app.handlers, name), list)
    )
    return handlers, threading.active_count(), len(bpy.data.images), len(bpy.data.scenes)


@pytest.mark.slow
def test_fifty_switches_of_engine_and_file_leave_nothing_behind(addon, scene, cloud, tmp_path, capfd):
    """Also of scenes and registrations; the console stays silent."""
    path = str(tmp_path / "scene.blend")
    scene.mrpnn.depth_samples, scene.render.resolution_percentage = 1, 25
    bpy.ops.wm.save_as_mainfile(filepath=path)
    bpy.ops.render.render()
    capfd.readouterr()
    before, said = None, ""
    for turn in range(50):
        bpy.context.scene.render.engine = ("CYCLES", "MRPNN", "BLENDER_WORKBENCH")[turn % 3]
        other = bpy.data.scenes.new("other")
        bpy.data.scenes.remove(other)
        bpy.ops.ed.undo_push(message="turn")
        addon.unregister()
        addon.register()
        if turn in (1, 40):
            bpy.context.scene.render.engine = "MRPNN"
            bpy.ops.render.render()
        said += "".join(capfd.readouterr()) if turn not in (1, 40) else capfd.readouterr().err
        bpy.ops.wm.open_mainfile(filepath=path)
        capfd.readouterr()
        gc.collect()
        if turn == 2:
            before = _left_behind()
    assert _left_behind() == before
    assert said == ""


def test_lines_of_a_panel_keep_numbers_and_their_units_together(addon):
    from mrpnn.panels.text import wrapped

    text = "Expected error: 1.6 % (1.1\u20132.5 %), mostly in the lower part"
    for width in range(len("(1.1\u20132.5 %),"), 60):
        lines = wrapped(text, width, len)
        assert max(map(len, lines)) <= width
        assert " ".join(lines) == text
        assert not any(line.startswith("%") for line in lines)
    for unit in ("s", "min", "h", "GiB", "%"):
        assert wrapped(f"Baking all light takes roughly 12 {unit}", 31, len)[-1] == f"12 {unit}"
    assert wrapped("a part of 12 shown", 12, len) == ["a part of 12", "shown"]
