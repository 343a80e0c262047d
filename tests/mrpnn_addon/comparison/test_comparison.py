# SPDX-License-Identifier: GPL-3.0-or-later
"""The comparison: its figures for planted images, and its operator on real scenes in Blender."""

import importlib
import json
import shutil
import time

import bpy
import numpy as np
import pytest

from inference import SceneError
from tests.support import blender_scenes as make
from tests.support.file_state import state_of_file

SIZE = 48


@pytest.fixture
def comparison(addon):
    return importlib.import_module("mrpnn.mrpnn_addon.comparison.results")


@pytest.fixture
def kept(addon):
    return importlib.import_module("mrpnn.mrpnn_addon.cycles.pass_store")


@pytest.fixture
def choices(addon):
    return importlib.import_module("mrpnn.mrpnn_addon.cycles.choices")


@pytest.fixture
def planted(kept, choices):
    """A layer 5 % brighter than a noisy reference of two passes, and Cycles at three sample counts."""
    from mrpnn.mrpnn_addon.comparison.plan import Request

    rng = np.random.default_rng(3)
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE - 0.5
    alpha = np.clip(1.4 - 4 * np.hypot(x, y), 0, 1)
    truth = alpha[..., None] * np.array([1.0, 0.8, 0.6])

    def image(colour):
        return np.concatenate([colour, alpha[..., None]], axis=-1).astype(np.float32)

    def traced(samples):
        # Variance 10 of the squared value at one sample.
        return image(truth * rng.gamma(samples / 10, 10 / samples, (SIZE, SIZE, 1)))

    layer = kept.Job("mrpnn", 8)
    passes = {layer: kept.Pass(image(1.05 * truth), 1.5, 1.5, 0.5, 0.5, ["a mesh is left out"])}
    passes |= {kept.Job(choices.REFERENCE, 1000, seed): kept.Pass(traced(1000), 101.0, 200.0) for seed in range(2)}
    passes |= {kept.Job(choices.CYCLES, n): kept.Pass(traced(n), 1.0 + 0.1 * n, 2.0 + 0.2 * n) for n in (1, 4, 16)}
    passes |= {
        kept.Job(choices.DENOISED, n): kept.Pass(traced(64 * n), 1.0 + 0.1 * n, 2.0 + 0.2 * n) for n in (1, 4, 16)
    }
    return passes, Request((layer,), samples=1000, largest=16)


def test_planted_bias_noise_and_times_are_reported(comparison, planted):
    passes, request = planted
    result = comparison.compare(passes, request, 1024, "4.5.15")
    assert result.bias.low < 0.05 < result.bias.high and result.bias.value == pytest.approx(0.05, abs=0.02)
    shown = passes[request.layers[0]].image[..., 3] > comparison.MASK_ALPHA
    colour = passes[request.layers[0]].image[shown][:, :3]
    spread = np.sqrt((colour**2).mean()) / colour.mean()
    # 2 x 1000 samples, each with a relative standard deviation of sqrt(10).
    assert result.noise == pytest.approx(spread * np.sqrt(10 / 2000), rel=0.15)
    assert result.alpha_bias.value == 0.0 and result.samples == 1000
    assert result.pixels == shown.sum() and result.resolution == (SIZE, SIZE)
    table = result.table()
    for figure in ("+5.", "202.0", "1.5", "2 x 1000 samples", "1024 bounces", "4.5.15"):
        assert figure in table, table


def test_equal_error_and_equal_time_follow_from_noise_and_cost(comparison, planted):
    passes, request = planted
    result = comparison.compare(passes, request, 1024, "4.5.15")
    by = {(one.method, one.clock): one for one in result.equal}
    traced = by["cycles", "seconds"]
    # Samples until the noise is the layer's error, at 0.1 s each after a start of 1 s.
    shown = passes[request.layers[0]].image[..., 3] > comparison.MASK_ALPHA
    colour = passes[request.layers[0]].image[shown][:, :3]
    variance = 10 * (colour**2).mean() / colour.mean() ** 2
    assert traced.needed.value == pytest.approx(1.0 + 0.1 * variance / result.rmse.value**2, rel=0.2)
    assert traced.error.value == pytest.approx(np.sqrt(variance / 5.0), rel=0.1)
    # The planted times of Cycles state twice as much processor time.
    assert by["cycles", "cpu_seconds"].needed.value == pytest.approx(2 * traced.needed.value, rel=0.02)
    # A denoiser that is worth 64 times the samples.
    denoised = by["cycles denoised", "seconds"].needed
    assert denoised.value < 0.1 * traced.needed.value
    assert len(result.sentences()) == 2 and result.sentences()[0].startswith("Cycles needs ")
    # Of hours, too, an artist reads plain seconds.
    traced.needed.value = 12345.0
    assert str(traced).startswith("Cycles needs 12000 s (extrapolated) for MRPNN's error: ")


def test_the_quicker_way_through_volumes_is_told_first_and_the_other_beside_it(comparison, kept, planted, choices):
    passes, request = planted
    alone = comparison.compare(passes, request, 1024, "5.2.3")
    rng = np.random.default_rng(4)
    truth = np.mean([passes[kept.Job(choices.REFERENCE, 1000, seed)].image for seed in range(2)], axis=0)
    for samples in (1, 4, 16):
        # Four times the variance, and twice the seconds of a sample.
        noise = rng.gamma(samples / 40, 40 / samples, (SIZE, SIZE, 1))
        image = np.concatenate([truth[..., :3] * noise, truth[..., 3:]], axis=-1).astype(np.float32)
        passes[kept.Job(choices.NULL, samples)] = kept.Pass(image, 1.0 + 0.2 * samples, 2.0 + 0.4 * samples)
    result = comparison.compare(passes, request, 1024, "5.2.3")
    told = [line.partition(" needs ")[0] for line in result.sentences()]
    assert told == [name.capitalize() for name in (choices.CYCLES, choices.NULL, choices.DENOISED)]
    by = {(one.method, one.clock): one for one in result.equal}
    for clock in ("seconds", "cpu_seconds"):
        assert by[choices.NULL, clock].ratio == pytest.approx(8 * by[choices.CYCLES, clock].ratio, rel=0.35)
    assert [str(one) for one in alone.equal if one.method == choices.CYCLES] == [
        str(one) for one in result.equal if one.method == choices.CYCLES
    ]


def test_the_same_image_as_layer_and_reference_has_no_error(comparison, kept, planted, choices):
    passes, request = planted
    layer = passes[request.layers[0]]
    for seed in range(2):
        passes[kept.Job(choices.REFERENCE, 1000, seed)] = layer
    result = comparison.compare(passes, request, 1024, "4.5.15")
    assert result.rmse.value == result.rmse.high == result.bias.value == 0.0
    given = comparison.compare(passes, request, 1024, "4.5.15", given=layer.image)
    assert given.rmse.value == given.bias.value == 0.0
    assert any("one image from a file" in mark for mark in given.marks)


def test_few_bounces_a_different_alpha_and_a_busy_machine_are_marked(comparison, kept, planted):
    passes, request = planted
    assert comparison.compare(passes, request, 1024, "4.5.15").marks == []
    layer = passes[request.layers[0]]
    passes[request.layers[0]] = kept.Pass(layer.image * [1, 1, 1, 0.8], 9.0, 1.5)
    marks = comparison.compare(passes, request, 16, "4.5.15").marks
    assert len(marks) == 3
    for words in ("after 16 bounces", "different volumes", "other programs slowed"):
        assert any(words in mark for mark in marks), marks
    with pytest.raises(SceneError, match="different volumes; render the file"):
        comparison.compare(passes, request, 1024, "4.5.15", given=layer.image)


def test_json_holds_every_figure_and_replaces_the_file_atomically(comparison, planted, tmp_path):
    result = comparison.compare(*planted, 1024, "4.5.15")
    path = tmp_path / "figures.json"
    path.write_text("old")
    result.judged.rmse.high = float("inf")
    result.write_json(str(path))
    found = json.loads(path.read_text(), parse_constant=lambda name: pytest.fail(f"{name} is no JSON"))
    assert found["bias"]["value"] == result.bias.value and found["bias"]["low"] < found["bias"]["high"]
    assert found["layer_seconds"] == 1.5 and found["warnings"] == ["a mesh is left out"]
    assert found["judged"]["rmse"]["high"] is None and len(found["rungs"]) == 7
    assert [entry.name for entry in tmp_path.iterdir()] == ["figures.json"]


def test_json_that_cannot_be_written_is_a_plain_error(comparison, planted, tmp_path):
    (tmp_path / "file").write_text("")
    result = comparison.compare(*planted, 1024, "4.5.15")
    with pytest.raises(SceneError, match="cannot write"):
        result.write_json(str(tmp_path / "file" / "figures.json"))


def test_images_of_different_size_an_empty_view_and_no_reference_are_refused(comparison, kept, planted):
    passes, request = planted
    layer = passes[request.layers[0]]
    with pytest.raises(SceneError, match="48 x 48 pixels and the reference 48 x 47"):
        comparison.compare(passes, request, 1024, "4.5.15", given=layer.image[:-1])
    empty = {**passes, request.layers[0]: kept.Pass(0 * layer.image, 1.0, 1.0)}
    with pytest.raises(SceneError, match="nothing to compare"):
        comparison.compare(empty, request, 1024, "4.5.15")
    with pytest.raises(SceneError, match="no reference yet"):
        comparison.compare({request.layers[0]: layer}, request, 1024, "4.5.15")


def small(folder, **settings):
    """Options of a comparison that takes seconds."""
    return {"samples": 16, "scale": 50, "ladder": 1, "folder": str(folder / "comparison"), **settings}


def test_operator_measures_a_thin_cloud_right_and_leaves_the_scene_alone(scene, tmp_path):
    make.cloud_scene(scene, tmp_path, density=1.0)
    scene.camera.location.z = 4.0
    scene.render.engine = "BLENDER_WORKBENCH"
    scene.cycles.samples = 7
    path = tmp_path / "comparison" / "figures.json"
    before = state_of_file()
    assert bpy.ops.mrpnn.compare(**small(tmp_path, samples=32)) == {"FINISHED"}
    after = state_of_file()
    # The layer, Cycles, the error and the chart; the table.
    assert after[1] == before[1]
    assert after[0] == {**before[0], "images": before[0]["images"] + 4, "texts": before[0]["texts"] + 1}

    found = json.loads(path.read_text())
    assert found["resolution"] == [32, 32] and found["samples"] == 32
    # Thin: nearly all light is scattered once, which is computed, not predicted.
    assert abs(found["bias"]["value"]) < 0.1
    assert abs(found["alpha_bias"]["value"]) < 0.02
    assert found["noise"] > 0.0 and found["cycles_seconds"] > 0.0

    layer, cycles, error = (image_pixels(name) for name in ("MRPNN", "MRPNN Cycles", "MRPNN error"))
    assert layer.shape == (32, 32, 4)
    assert np.allclose(layer[..., :3] - cycles[..., :3], error[..., :3], atol=1e-6)
    assert "relative bias" in bpy.data.texts["MRPNN comparison"].as_string()
    assert (tmp_path / "comparison" / "report.html").exists()


@pytest.mark.slow
def test_operator_measures_every_way_through_volumes_and_what_artists_set(scene, tmp_path, choices):
    make.cloud_scene(scene, tmp_path, density=40.0)
    scene.camera.location.z = 4.0
    assert bpy.ops.mrpnn.compare(**small(tmp_path, samples=64, scale=25, ladder=4, usual=True)) == {"FINISHED"}
    found = json.loads((tmp_path / "comparison" / "figures.json").read_text())
    bias = {(rung["method"], rung["samples"]): rung["bias"]["value"] for rung in found["rungs"]}
    null = choices.has_null_scattering(scene)
    ladders = [name for name in choices.LADDERS if null or not choices.CHOICES[name].null]
    assert {key for key in bias if key[0] in choices.LADDERS} == {(name, n) for name in ladders for n in (1, 4)}
    assert {one["method"] for one in found["equal"]} == set(ladders)
    usual = {(choice.name, samples) for choice, samples in choices.USUAL if null or not choice.null}
    assert usual <= set(bias)
    # The fewer bounces, the darker; path guiding and adaptive sampling do not add any.
    dark = [bias[choices.usual(bounces).name, 32] for bounces in (0, 4, 12)]
    assert dark[0] < dark[1] - 0.1 < dark[2] - 0.2 < -0.2
    for others in ({"guided": True}, {"adaptive": True}):
        choice = choices.usual(12, **others)
        assert bias[choice.name, 32 if choice.guided else 128] == pytest.approx(dark[2], abs=0.1)
    # The scene's own settings are its own.
    assert scene.cycles.volume_bounces == 0 and "as artists set it" in (
        tmp_path / "comparison" / "report.html"
    ).read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_later_frame_of_a_sequence_is_compared_with_its_own_file(scene, tmp_path):
    """Cycles' process has never rendered that frame. The second file is four times as dense."""
    cloud = make.cloud_scene(scene, tmp_path, density=1.0)
    folder = tmp_path / "sequence"
    folder.mkdir()
    for number, factor in ((1, 0.25), (2, 1.0)):
        written = make.write_vdb(folder, factor * make.blob(), make.centred(16, 2.0))
        shutil.move(written, folder / f"cloud_{number:04}.vdb")
    data = cloud.data
    data.filepath, data.is_sequence, data.frame_duration = str(folder / "cloud_0001.vdb"), True, 2
    scene.frame_set(2)
    assert bpy.ops.mrpnn.compare(**small(tmp_path)) == {"FINISHED"}
    found = json.loads((tmp_path / "comparison" / "figures.json").read_text())
    assert abs(found["alpha_bias"]["value"]) < 0.02


def test_operator_refuses_a_scene_without_volume_and_writes_nothing(scene, tmp_path):
    make.add_sun(scene)
    make.add_camera(scene)
    path = tmp_path / "comparison" / "figures.json"
    with pytest.raises(RuntimeError, match="Volume"):
        bpy.ops.mrpnn.compare(**small(tmp_path))
    assert not path.exists() and scene.render.resolution_percentage == 100


def test_operator_refuses_an_instancer_that_shows_a_surface_beside_the_volume(scene, tmp_path):
    cloud = make.cloud_scene(scene, tmp_path)
    group = bpy.data.collections.new("group")
    wall = bpy.data.objects.new("wall", bpy.data.meshes.new("wall"))
    for member in (cloud, wall):
        group.objects.link(member)
    scene.collection.objects.unlink(cloud)
    instancer = make.add_object(scene, "both", None)
    instancer.instance_type, instancer.instance_collection = "COLLECTION", group
    with pytest.raises(RuntimeError, match='"both" instances a volume'):
        bpy.ops.mrpnn.compare(**small(tmp_path))


@pytest.mark.slow
def test_a_region_is_compared_at_its_own_size(scene, tmp_path):
    make.cloud_scene(scene, tmp_path, density=1.0)
    render = scene.render
    render.use_border, render.use_crop_to_border = True, False
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.75, 0.5, 1.0
    path = tmp_path / "comparison" / "figures.json"
    assert bpy.ops.mrpnn.compare(**small(tmp_path, scale=100)) == {"FINISHED"}
    found = json.loads(path.read_text())
    assert found["resolution"] == [32, 32]
    assert abs(found["alpha_bias"]["value"]) < 0.03


@pytest.fixture
def started(addon, scene, tmp_path):
    """start(**options) gives a ComparisonRun of a small cloud."""
    run = importlib.import_module("mrpnn.mrpnn_addon.comparison.run")
    make.cloud_scene(scene, tmp_path)
    scene.mrpnn.depth_samples = 2

    def start(**options):
        options = {"samples": 16, "ladder": 1, "scale": 25, "depths": (), "folder": str(tmp_path / "out"), **options}
        return run.ComparisonRun(bpy.context, scene.mrpnn.settings(), run.Options(**options))

    return start


@pytest.mark.slow
def test_a_cancelled_comparison_keeps_finished_renders_and_the_next_resumes(started, scene, tmp_path):
    before = state_of_file()
    first = started()
    while sum(job.by_cycles for job in first.job.passes) < 2:
        first.job.step()
        time.sleep(0.01)
    first.job.stop()
    assert first.job.cancelled and state_of_file() == before
    assert any("stopped before its end" in mark for mark in first.result().marks)
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.npz")}
    assert len(kept) == 2

    second = started()
    second.wait()
    assert not any("stopped" in mark for mark in second.result().marks) and state_of_file() == before
    later = {path: path.stat().st_mtime_ns for path in (tmp_path / "out").rglob("*.npz")}
    assert len(later) == 4 and kept.items() <= later.items()
    # Another view finds no stored passes.
    scene.camera.location.z += 1.0
    third = started()
    while third.job.store is None:
        third.job.step()
        time.sleep(0.01)
    assert third.job.passes == {}
    third.job.stop()


def test_a_crash_of_cycles_is_a_message_and_leaves_the_file_alone(started):
    before = state_of_file()
    run = started()
    while run.job._process._process is None:
        run.job.step()
        time.sleep(0.01)
    run.job._process._process.kill()
    run.wait()
    with pytest.raises(ValueError, match="renders Cycles' images ended"):
        run.result()
    assert state_of_file() == before


@pytest.mark.slow
def test_a_given_reference_is_used_and_a_wrong_one_refused(started, scene, tmp_path):
    first = started()
    first.wait()
    image = bpy.data.images.new("given", 16, 16, alpha=True, float_buffer=True)
    image.pixels.foreach_set(first.layer_image()[::-1].ravel())
    image.colorspace_settings.is_data, image.alpha_mode, image.file_format = True, "CHANNEL_PACKED", "OPEN_EXR"
    image.save(filepath=str(tmp_path / "given.exr"))
    run = started(reference_path=str(tmp_path / "given.exr"))
    run.wait()
    result = run.result()
    # These EXR files have half precision.
    assert result.rmse.value < 1e-3 and abs(result.bias.value) < 1e-3 and result.equal == []
    (tmp_path / "words.exr").write_text("no image")
    for name in ("words.exr", "missing.exr"):
        with pytest.raises(ValueError, match=f"the reference .*{name}"):
            started(reference_path=str(tmp_path / name))


def image_pixels(name):
    image = bpy.data.images[name]
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)[::-1]
