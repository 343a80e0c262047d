# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendering from the command line: files, messages and exit status."""

import json
import os
import shutil
import subprocess
import sys

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

# After bpy: its compiled libraries must come first.
import OpenEXR

from tests.support import blender_scenes
from tests.support.paths import ROOT


@pytest.fixture
def blend(scene, tmp_path):
    """A saved scene whose cloud is a sequence of two frames, the second one denser."""
    for number in (1, 2):
        density = number * blender_scenes.blob()
        path = blender_scenes.write_vdb(tmp_path, density, blender_scenes.centred(16, 2.0))
        shutil.move(path, tmp_path / f"fog_{number}.vdb")
    cloud, _ = blender_scenes.add_volume(scene, tmp_path / "fog_1.vdb", Density=2.0)
    cloud.data.is_sequence, cloud.data.frame_start, cloud.data.frame_duration = True, 1, 2
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene)
    scene.render.resolution_x, scene.render.resolution_y = 20, 16
    scene.mrpnn.depth_samples = 1
    scene.frame_set(1)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    cloud.data.filepath = "//fog_1.vdb"
    bpy.ops.wm.save_mainfile()
    return tmp_path / "scene.blend"


@pytest.fixture
def command(addon):
    return addon.operators.command.main


def files(folder):
    return {name for name in os.listdir(folder) if not name.startswith(("fog_", "scene."))}


def read_exr(path):
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for name, channel in file.channels().items()}, dict(file.header())


def test_a_folder_that_cannot_be_made_is_named(command, blend, capsys):
    taken = blend.parent / "taken"
    taken.write_text("a file")
    assert command(["render", "--output", str(taken / "in" / "a.exr")]) == 1
    error = capsys.readouterr().err.splitlines()[-1]
    assert f"cannot make the folder {taken / 'in'}" in error and "Errno" not in error


def test_it_writes_the_requested_frame(command, blend, capsys):
    folder = blend.parent
    assert command(["render", "--output", str(folder / "a.exr"), "--json", str(folder / "facts.json")]) == 0
    said = capsys.readouterr().out
    assert f"wrote {folder / 'a.exr'}" in said
    stated = json.loads((folder / "facts.json").read_text())["frames"][0]["report"]["expected_error"]
    assert (
        f"expected error {100 * stated['error']:.1f} %" in said
        or f"expected error {100 * stated['error']:.0f} %" in said
    )
    assert 0.0 < stated["low"] < stated["error"] < stated["high"]
    (folder / "facts.json").unlink()
    assert (
        command(
            [
                "render",
                "--output",
                str(folder / "b.exr"),
                "--frame",
                "2",
                "--depth-samples",
                "2",
                "--seed",
                "7",
                "--threads",
                "1",
                "--model",
                "mrpnn",
            ]
        )
        == 0
    )
    first, second = read_exr(folder / "a.exr"), read_exr(folder / "b.exr")
    alphas = [np.clip(channels["ViewLayer.Alpha.A"], 0, 0.999) for channels, _ in (first, second)]
    # Twice the density: twice the optical depth.
    np.testing.assert_allclose(-np.log1p(-alphas[1]), -2 * np.log1p(-alphas[0]), rtol=1e-3, atol=1e-4)
    assert (first[1]["Frame"], second[1]["Frame"]) == (1, 2)
    assert (second[1]["mrpnn.depthSamples"], second[1]["mrpnn.seed"]) == (2, 7)
    assert bpy.context.scene.mrpnn.depth_samples == 1
    assert files(folder) == {"a.exr", "b.exr"}


def test_paths_may_contain_spaces_and_any_letters(command, blend):
    folder = blend.parent / "Wolke über dem Meer 雲 'n' $HOME"
    shutil.copytree(blend.parent, folder)
    for name in ("fog_1.vdb", "fog_2.vdb"):
        (folder / name).rename(folder / f"Nebel 霧 {name}")
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    bpy.data.volumes[0].filepath = "//Nebel 霧 fog_1.vdb"
    for ending in ("exr", "png"):
        assert command(["render", "--output", f"//Ebene 層 #1.{ending}", "--json", str(folder / "Bericht ü.json")]) == 0
    assert {"Ebene 層 11.exr", "Ebene 層 11.png", "Bericht ü.json"} < set(os.listdir(folder))
    assert json.loads((folder / "Bericht ü.json").read_text())["blend"] == str(folder / "scene.blend")
    assert read_exr(folder / "Ebene 層 11.exr")[0]["ViewLayer.Alpha.A"].max() > 0.1


def test_png_keeps_the_layers_alpha(command, blend):
    folder = blend.parent
    assert command(["render", "--output", str(folder / "a.png")]) == 0
    assert command(["render", "--output", str(folder / "a.exr")]) == 0
    from PIL import Image

    with Image.open(folder / "a.png") as png:
        alpha = np.asarray(png)[..., 3] / 255.0
    np.testing.assert_allclose(alpha, read_exr(folder / "a.exr")[0]["ViewLayer.Alpha.A"], atol=1 / 255)
    assert files(folder) == {"a.exr", "a.png"}


@pytest.mark.parametrize("option", ["--optimizations", "--leave-out"])
def test_optimizations_have_the_flag_of_earlier_versions_too(addon, option):
    """A name that earlier versions knew is accepted."""
    parser = addon.operators.command._parser()
    parsed = parser.parse_args(["report", option, "empty_space,unread_fields,shared_pixels"])
    assert parsed.optimizations == {"empty_space", "shared_pixels"}
    assert "--leave-out" not in parser.format_help()


@pytest.mark.parametrize(
    "arguments, said",
    [
        ([], "render"),
        (["render"], "--output"),
        (["paint"], "paint"),
        (["render", "--output", "picture.jpg"], "must end in .exr or .png"),
        (["render", "--output", "scene.blend/picture.exr"], "scene.blend"),
        (["render", "--output", "x.exr", "--frames", "1-"], "1-10,15"),
        (["render", "--output", "x.exr", "--frames", "9-3"], "backwards"),
        (["render", "--output", "x.exr", "--camera", "Sun"], "there are: Camera"),
        (["render", "--output", "x.exr", "--view-layer", "Fog"], "there are: ViewLayer"),
        (["render", "--output", "x.exr", "--memory-limit", "0.001"], "the memory limit is 0.0 GiB"),
        (["compare", "--samples", "0"], "not positive"),
        (["report", "--depth-samples", "1e9"], "'1e9' is not a whole number"),
        (["compare", "--seconds", "soon"], "'soon' is not a number"),
        (["report", "--depth-samples", "0"], "depth samples"),
        (["report", "--optimizations", "empty_space,noise"], "no optimization 'noise'; there are: missed_pixels"),
        (["render", "--output", "x.exr", "--depth-samples", "0"], "depth samples"),
        (["render", "--output", "x.exr", "--depth-samples", "many"], "many"),
        (["render", "--output", "x.exr", "--threads", "-1"], "threads"),
        (["render", "--output", "x.exr", "--model", "nothing"], "nothing"),
    ],
)
def test_wrong_arguments_give_one_line_and_status_1(command, blend, capsys, monkeypatch, arguments, said):
    monkeypatch.chdir(blend.parent)
    assert command(arguments) == 1
    errors = capsys.readouterr().err
    assert errors.startswith("mrpnn: error: ") and errors.count("\n") == 1 and said in errors
    assert files(blend.parent) == set()


@pytest.mark.parametrize("ending", ["exr", "png"])
def test_a_scene_that_cannot_be_rendered_leaves_the_old_file(command, blend, capsys, ending):
    output = blend.parent / f"out.{ending}"
    output.write_bytes(b"old")
    bpy.data.volumes["Cloud"].is_sequence = False
    (blend.parent / "fog_1.vdb").unlink()
    assert command(["render", "--output", str(output)]) == 1
    errors = capsys.readouterr().err
    assert 'volume "Cloud"' in errors and "fog_1.vdb" in errors and errors.count("\n") == 1
    assert output.read_bytes() == b"old" and files(blend.parent) == {output.name}


def test_frames_are_written_to_the_patterns_files(command, blend):
    folder = blend.parent
    assert command(["render", "--output", "//new/fog_###.exr", "--frames", "1..2"]) == 0
    assert command(["render", "--output", str(folder / "fog.exr"), "--frames", "2,1"]) == 0
    assert files(folder) == {"new", "fog0001.exr", "fog0002.exr"}
    assert set(os.listdir(folder / "new")) == {"fog_001.exr", "fog_002.exr"}
    for number in (1, 2):
        found, facts = read_exr(folder / "new" / f"fog_{number:03}.exr")
        again, _ = read_exr(folder / f"fog{number:04}.exr")
        assert facts["Frame"] == number
        for name, values in found.items():
            np.testing.assert_array_equal(again[name], values)


@pytest.mark.parametrize(
    "frames, expected",
    [("-2", [-2]), ("-2..-1", [-2, -1]), ("-2--1", [-2, -1]), ("-1,1", [-1, 1]), ("-2-1:3", [-2, 1])],
)
def test_frames_may_be_negative(command, blend, frames, expected):
    facts = blend.parent / "facts.json"
    assert command(["render", "--output", "//new/a.exr", "--frames", frames, "--json", str(facts)]) == 0
    assert [frame["frame"] for frame in json.loads(facts.read_text())["frames"]] == expected


def test_lists_of_frames_and_their_files(addon):
    frames = addon.mrpnn_addon.output.frames
    assert frames.parse_frames("1-3, 7,2..4") == [1, 2, 3, 7, 4]
    assert frames.parse_frames("1-7:2,10") == [1, 3, 5, 7, 10]
    assert frames.parse_frames("-2..1") == frames.parse_frames("-2-1") == [-2, -1, 0, 1]
    assert frames.frame_path("/a#/b_##.png", 7, many=False) == "/a#/b_07.png"
    assert frames.frame_path("/a/b.png", 7, many=False) == "/a/b.png"
    assert frames.frame_path("/a/b.png", -7, many=True) == "/a/b-0007.png"
    assert frames.frame_path("/a/b##.png", 12345, many=True) == "/a/b12345.png"


def test_existing_frames_are_skipped_on_request(command, blend, capsys):
    folder = blend.parent
    (folder / "a0001.exr").write_bytes(b"done")
    assert command(["render", "--output", str(folder / "a.exr"), "--frames", "1,2", "--skip-existing"]) == 0
    assert (folder / "a0001.exr").read_bytes() == b"done" and (folder / "a0002.exr").stat().st_size > 1000
    assert "is there already" in capsys.readouterr().out


def test_the_report_file_and_the_machine_readable_lines_agree(command, blend, capsys):
    folder = blend.parent
    assert (
        command(
            [
                "render",
                "--output",
                str(folder / "a.exr"),
                "--frames",
                "1-2",
                "--json",
                str(folder / "report.json"),
                "--progress",
                "json",
            ]
        )
        == 0
    )
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines() if line.startswith("{")]
    report = json.loads((folder / "report.json").read_text())
    assert report["error"] is None and report["action"] == "render" and report["blend"] == str(blend)
    written = [event for event in events if event["event"] == "frame"]
    assert (
        [event["file"] for event in written]
        == [frame["file"] for frame in report["frames"]]
        == [str(folder / "a0001.exr"), str(folder / "a0002.exr")]
    )
    assert all(len(frame["report"]["checksum"]) == 64 for frame in report["frames"])
    for number in (1, 2):
        fractions = [event["fraction"] for event in events if event["event"] == "progress" and event["frame"] == number]
        assert fractions == sorted(fractions) and fractions[-1] == 1.0
    assert events[-1]["event"] == "end" and events[-1]["status"] == 0


def test_with_strict_a_failure_keeps_the_frames_before_it(command, blend, capsys):
    """The second frame's file is missing: the first frame is written, and the report says so."""
    folder, output = blend.parent, ["--output", str(blend.parent / "a.exr"), "--frames", "1-2", "--strict"]
    (folder / "fog_2.vdb").unlink()
    assert command(["render", *output, "--json", str(folder / "report.json"), "--progress", "json"]) == 1
    report = json.loads((folder / "report.json").read_text())
    assert [frame["frame"] for frame in report["frames"]] == [1] and "fog_2.vdb" in report["error"]
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines() if line.startswith("{")]
    assert events[-2]["message"] == report["error"] and events[-1]["status"] == 1
    assert files(folder) == {"a0001.exr", "report.json"}


def test_overrides_last_for_one_command(command, blend):
    folder, scene = blend.parent, bpy.context.scene
    camera = scene.camera
    other = blender_scenes.add_camera(scene, location=(0.0, 0.0, 9.0))
    scene.camera = camera
    other.name = "Far"
    assert command(["render", "--output", str(folder / "near.exr")]) == 0
    assert (
        command(["render", "--output", str(folder / "far.exr"), "--camera", "Far", "--resolution-percentage", "50"])
        == 0
    )
    near, far = (read_exr(folder / f"{name}.exr")[0]["ViewLayer.Alpha.A"] for name in ("near", "far"))
    assert near.shape == (16, 20) and far.shape == (8, 10)
    assert np.mean(far > 0.01) < 0.7 * np.mean(near > 0.01)
    assert scene.camera == camera and scene.render.resolution_percentage == 100


def test_a_view_layer_may_be_chosen(command, blend, capsys):
    folder, scene = blend.parent, bpy.context.scene
    scene.view_layers.new("Empty")
    collection = bpy.data.collections.new("Clouds")
    scene.collection.children.link(collection)
    collection.objects.link(scene.objects["Cloud"])
    scene.collection.objects.unlink(scene.objects["Cloud"])
    scene.view_layers["Empty"].layer_collection.children["Clouds"].exclude = True
    assert command(["render", "--output", str(folder / "a.exr"), "--view-layer", "ViewLayer"]) == 0
    assert "ViewLayer.Alpha.A" in read_exr(folder / "a.exr")[0]
    assert command(["render", "--output", str(folder / "b.exr"), "--view-layer", "Empty"]) == 1
    assert "shows no Volume" in capsys.readouterr().err and files(folder) == {"a.exr"}


def test_report_states_what_a_render_would_do(command, blend, capsys):
    lamp = blender_scenes.add_object(bpy.context.scene, "Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.visible_volume_scatter = False
    assert command(["report", "--frame", "2", "--json", str(blend.parent / "plan.json")]) == 0
    said = capsys.readouterr()
    assert "frame 2, 20 x 16 pixels" in said.out and 'volume "Cloud"' in said.out and '"Lamp"' in said.err
    plan = json.loads((blend.parent / "plan.json").read_text())["plan"]
    assert plan["volumes"][0]["name"] == "Cloud" and plan["memory"] > 0 and len(plan["warnings"]) == 1
    assert files(blend.parent) == {"plan.json"}


@pytest.mark.slow
def test_compare_measures_against_cycles(command, blend, capsys):
    assert (
        command(
            [
                "compare",
                "--samples",
                "4",
                "--bounces",
                "8",
                "--scale",
                "100",
                "--ladder",
                "1",
                "--json",
                str(blend.parent / "figures.json"),
            ]
        )
        == 0
    )
    said = capsys.readouterr().out
    assert "relative RMSE" in said and "after 8 bounces" in said
    assert (blend.parent / "mrpnn-comparison" / "report.html").exists()
    figures = json.loads((blend.parent / "figures.json").read_text())["comparison"]
    assert figures["resolution"] == [20, 16] and figures["samples"] == 4 and abs(figures["alpha_bias"]["value"]) < 0.1


def test_warnings_go_to_stderr(command, blend, capsys):
    lamp = blender_scenes.add_object(bpy.context.scene, "Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.visible_volume_scatter = False
    assert command(["render", "--output", str(blend.parent / "a.exr")]) == 0
    assert 'mrpnn: warning: point light "Lamp"' in capsys.readouterr().err


def test_help_is_status_0(command, capsys):
    assert command(["render", "--help"]) == 0
    assert "--depth-samples" in capsys.readouterr().out


SCRIPT = """
import sys
import bpy
from benchmarks.support.extension import load_extension
package = load_extension()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
status = package.operators.command.main(["render", "--output", sys.argv[2]])
bpy.ops.mrpnn.render(filepath="//operator.exr")
package.unregister()
sys.exit(status)
"""


@pytest.mark.slow
def test_a_script_in_its_own_process_ends_cleanly(blend):
    """The file is written, nothing leaks and nothing hangs."""
    folder = blend.parent
    run = subprocess.run(
        [sys.executable, "-c", SCRIPT, str(blend), str(folder / "command.exr")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert "Not freed memory" not in run.stdout + run.stderr
    by_command, by_operator = (read_exr(folder / f"{name}.exr")[0] for name in ("command", "operator"))
    for name, values in by_command.items():
        np.testing.assert_array_equal(values, by_operator[name])


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="file names are bytes on Linux only")
def test_paths_may_hold_bytes_that_are_not_utf8(command, blend, capsys):
    folder = blend.parent / os.fsdecode(b"odd\xff")
    folder.mkdir()
    for path in [blend, *blend.parent.glob("fog_*")]:
        shutil.copy(path, folder)
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    assert command(["render", "--output", str(folder / "a.exr"), "--json", str(folder / "facts.json")]) == 0
    assert r"odd\xff/a.exr" in capsys.readouterr().out
    assert json.loads((folder / "facts.json").read_text())["blend"] == str(folder / "scene.blend")
    for name in ("a.exr", "facts.json"):
        assert (folder / name).stat().st_size > 0
    (folder / "fog_1.vdb").write_bytes(b"no volume")
    bpy.ops.wm.open_mainfile(filepath=str(folder / "scene.blend"))
    command(["render", "--output", str(folder / "b.exr"), "--progress", "json"])
    said = capsys.readouterr()
    assert "fog_1.vdb" in said.out + said.err
