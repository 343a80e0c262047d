# SPDX-License-Identifier: GPL-3.0-or-later
"""Each scene of the gallery is made and rendered, small, as an artist would; and the templates open in Blender."""

import os
import re
import subprocess
import sys
import warnings

import numpy as np
import pytest

from tests.support.paths import ROOT

bpy = pytest.importorskip("bpy")

from benchmarks.support.pages import read_csv
from gallery import page, pictures, scenes
from gallery.__main__ import make

SIZE, DETAIL = (48, 27), 0.2
# What the report says of a scene, by its words: all else is a fault of the scene or of the renderer.
EXPECTED = {
    "explosion": ("very dense, so the glow",),
    "fire": ("very dense, so the glow",),
    "storm": ("lies deep inside",),
}
# Seconds.
SLOW = {"fog": 20, "stage": 60, "milk": 40, "dusk": 20, "explosion": 8, "inside": 6, "storm": 6}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow(seconds=SLOW[name])) if name in SLOW else name
             for name in scenes.SCENES]
)  # fmt: skip
def test_scene_renders_without_other_warnings(addon, name, tmp_path):
    make(name, tmp_path, DETAIL)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / f"{name}.blend"))
    scene = bpy.context.scene
    assert all(data.filepath.startswith("//volumes") for data in bpy.data.volumes)
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        image, _ = pictures.ours(scene, tmp_path / "picture.png", tmp_path / "light")
    values = np.asarray(image, float)
    assert 5.0 < values.mean() < 230.0 and values.std() > 8.0
    said = addon.mrpnn_addon.status.last_render.last_render().warnings if pictures.way(scene) == "layer" else []
    assert [text for text in said if not any(words in text for words in EXPECTED.get(name, ()))] == []


def test_templates_find_their_volumes_where_they_are_installed(tmp_path):
    run = [sys.executable, "-m", "gallery", "noon", "--templates", "--detail", str(DETAIL), "--out", tmp_path / "out"]
    subprocess.run(run, cwd=ROOT, check=True)
    assert not (tmp_path / "out" / "noon.png").exists()
    packed = tmp_path / "out" / "mrpnn-gallery.zip"
    code = f"""
import os, sys
import bpy
assert bpy.ops.preferences.app_template_install(filepath={str(packed)!r}) == {{"FINISHED"}}
bpy.ops.wm.read_homefile(app_template="Volumes_Cumulus_at_noon")
(cloud,) = bpy.data.volumes
assert cloud.grids.load(), cloud.grids.error_message
assert [grid.name for grid in cloud.grids] == ["density"]
assert bpy.data.objects["Camera"] == bpy.context.scene.camera
print("opened", cloud.filepath)
# The bpy module may hang at the end of a process in which something refers to its types.
sys.stdout.flush()
os._exit(0)
"""
    run = subprocess.run(
        [sys.executable, "-c", code],
        env={**os.environ, "BLENDER_USER_RESOURCES": str(tmp_path / "user")},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0 and "opened " + str(tmp_path / "user") in run.stdout, run.stderr


def test_the_page_is_that_of_the_scenes_and_figures():
    assert page.PAGE.read_text() == page.text(), "python -m gallery --docs makes it anew"
    shown = {row["scene"] for row in read_csv(page.TABLE)}
    assert shown and shown <= set(scenes.SCENES)
    assert [name for name in shown if not (page.PICTURES / f"{name}.jpg").exists()] == []
    assert ROOT in page.PAGE.parents


@pytest.mark.slow
def test_errors_beside_cycles_are_those_of_the_pictures(addon, tmp_path):
    make("noon", tmp_path, DETAIL)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    pictures.ours(scene, tmp_path / "ours.png", tmp_path / "light")
    scene.cycles.film_exposure = 0.5
    pictures.ours(scene, tmp_path / "dark.png", tmp_path / "light")
    scene.cycles.film_exposure = 1.0
    # The extension has rays through pixels' centres alone.
    scene.cycles.filter_width = 0.01
    paths = [tmp_path / "ours.png", tmp_path / "dark.png"]
    assert pictures.radiance(paths[1]) == pytest.approx(pictures.radiance(paths[0]) / 2, rel=1e-3, abs=1e-5)
    ours, dark = (re.findall(r"[\d.]+", text) for text in pictures.errors(scene, paths, tmp_path, 16))
    # Half the light errs by half of the mean, and by more where the picture is bright.
    assert float(ours[-1]) < 0.3 and 0.5 < float(dark[0]) < 0.7, (ours, dark)
