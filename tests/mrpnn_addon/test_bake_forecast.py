# SPDX-License-Identifier: GPL-3.0-or-later
"""The estimate of a bake's time: the work it counts, what it learns from bakes, and where it is told."""

import json

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from benchmarks.cost import forecast as forecasts
from inference import Settings, bake
from tests.support import blender_scenes

# An estimate may be wrong by this factor.
RIGHT = 1.5


def billows(cells):
    """A density that fades to 0 at its bounds and swells and ebbs, float32 (cells,) * 3."""
    x, y, z = np.indices((cells,) * 3) / (cells - 1.0) * 2.0 - 1.0
    radius = np.sqrt(x * x + y * y + z * z)
    return np.clip(1.0 - radius + 0.3 * np.sin(7.0 * x) * np.sin(6.0 * y) * np.sin(5.0 * z), 0.0, None)


@pytest.fixture
def cloud(scene, tmp_path, uncalibrated):
    """A cloud of 48^3 voxels, before anything is known of it or of the machine's speed."""
    shown, _ = blender_scenes.add_volume(
        scene,
        blender_scenes.write_vdb(tmp_path, billows(48), blender_scenes.centred(48, 2.0)),
        Density=20.0,
        Color=(0.9, 0.9, 0.9, 1.0),
        Anisotropy=0.5,
    )
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene)
    return shown


@pytest.fixture
def said(addon, cloud):
    forecast_bake = addon.mrpnn_addon.status.forecast.forecast_bake
    return lambda directional=True: forecast_bake(blender_scenes.depsgraph(), directional)


def described(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


@pytest.mark.parametrize("directional, suns", [(False, 1), (False, 2), pytest.param(True, 1, marks=pytest.mark.slow)])
def test_as_many_predictions_are_expected_as_a_bake_makes(addon, scene, cloud, said, directional, suns):
    """They do not depend on the machine."""
    for number in range(1, suns):
        blender_scenes.add_sun(scene, f"Sun {number}", rotation=(-1.0, 0.4, 0.0))
    found = described(addon)
    expected = said(directional).work
    assert (expected.suns, expected.lamps, expected.worlds) == (suns, 0, 0)
    [lit] = bake(found.volumes, found.lights, found.camera, Settings(directional=directional))
    # All suns are predicted at the same points.
    points = lit.report.counts["network points"] / suns
    assert points / RIGHT < expected.points < points * RIGHT


def test_estimates_grow_with_the_work(addon, scene, cloud, said):
    assert said().rough
    described(addon)
    alone = said()
    assert not alone.rough and said(False).seconds < alone.seconds
    blender_scenes.add_sun(scene, "Second", rotation=(-1.0, 0.4, 0.0))
    assert said().seconds > alone.seconds


def test_voxels_much_smaller_than_pixels_are_expected_to_be_joined(addon, scene, cloud, said, tmp_path):
    cloud.data.filepath = blender_scenes.write_vdb(tmp_path, billows(128), blender_scenes.centred(128, 2.0))
    described(addon)
    near = said(False).work
    scene.render.resolution_x = scene.render.resolution_y = 8
    assert said(False).work.voxels < 0.5 * near.voxels


def test_a_bake_calibrates_further_estimates(addon, scene, cloud, said, tmp_path):
    assert bpy.ops.mrpnn.bake_light(folder=str(tmp_path), directional=False) == {"FINISHED"}
    calibration = addon.mrpnn_addon.status.calibration
    [(names, rate)] = calibration.calibration().bakes.items()
    assert names == {"Cloud"} and rate > 0.0
    before = said(False).seconds
    # Other scenes on this machine in later sessions, too.
    calibration.forget()
    assert said(False).seconds == pytest.approx(before, rel=1e-6)
    calibration.forget()
    (tmp_path / ".user" / calibration.FILE).unlink()
    assert said(False).seconds != pytest.approx(before, rel=1e-6)


@pytest.mark.slow
def test_estimates_of_new_scenes_are_right_beside_each_other(addon, scene):
    """In processor seconds of one thread, since the constants are of one machine. More scenes in the benchmark."""
    cases = [(name, directional) for name in ("cloud", "cloud, grey World") for directional in (False, True)]
    errors = {}
    for name, directional in cases:
        expected, took = forecasts.compare_bake(addon, name, (160, 90), directional)
        errors[name, directional] = expected.seconds / took
    typical = np.exp(np.mean(np.log(list(errors.values()))))
    assert all(1.0 / RIGHT < error / typical < RIGHT for error in errors.values()), errors


def test_nothing_is_estimated_where_nothing_is_baked(addon, scene, cloud, said):
    bpy.data.objects.remove(scene.objects["Sun"])
    assert said() is None
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1.0
    assert said().work.worlds == 1
    bpy.data.objects.remove(cloud)
    assert said() is None


def test_the_command_tells_before_it_bakes(addon, scene, cloud, said, tmp_path, capsys):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    facts = tmp_path / "facts.json"
    assert addon.operators.command.main(["report", "--json", str(facts)]) == 0
    told = json.loads(facts.read_text())["plan"]["bake_seconds"]
    assert told == pytest.approx(said().seconds, rel=0.1) and "baking its light takes about" in capsys.readouterr().out
    command = ["bake", "--no-directions", "--folder", str(tmp_path / "light"), "--progress", "json"]
    assert addon.operators.command.main(command) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines() if line.startswith("{")]
    kinds = [event["event"] for event in events]
    assert kinds.count("estimate") == 1 and kinds.index("estimate") < kinds.index("progress")
    assert 0.0 < events[kinds.index("estimate")]["seconds"] < 1.01 * told + 0.1


def test_eevee_says_what_it_still_lacks(addon, scene, cloud):
    told = addon.mrpnn_addon.status.lacking.lacking
    scene.eevee.use_volumetric_shadows = True
    scene.render.engine = "CYCLES"
    scene.camera.data.type = "PANO"
    assert told(blender_scenes.depsgraph()) == ""
    engines = type(scene.render).bl_rna.properties["engine"].enum_items.keys()
    scene.render.engine = next(name for name in engines if name.startswith("BLENDER_EEVEE"))
    assert told(blender_scenes.depsgraph()) == "EEVEE still lacks panoramic cameras"
    scene.camera.data.type = "PERSP"
    assert told(blender_scenes.depsgraph()) == ""
    scene.eevee.use_volumetric_shadows = False
    assert "turn on Sampling > Shadows > Volume Shadows" in told(blender_scenes.depsgraph())
    scene.eevee.use_volumetric_shadows = True
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 1.0
    bpy.ops.mesh.primitive_plane_add()
    material = bpy.data.materials.new("Glass")
    material.use_nodes = True
    shader = material.node_tree.nodes.new("ShaderNodeBsdfGlass")
    material.node_tree.links.new(shader.outputs[0], material.node_tree.nodes["Material Output"].inputs["Surface"])
    bpy.context.object.data.materials.append(material)
    expected = "volumes in mirrors and glass, shadows of volumes on surfaces, shadows in the World's light"
    assert told(blender_scenes.depsgraph()) == f"EEVEE still lacks {expected}"
