# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that cannot be rendered are named and left out; the others are rendered, without numpy warnings."""

import json
import os
import shutil
import subprocess
import sys
import warnings

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix

from inference import SceneError
from tests.support import blender_scenes
from tests.support.paths import ROOT

NAN = float("nan")


@pytest.fixture(autouse=True)
def silence():
    """Every numpy warning is an error, on every thread."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        yield


@pytest.fixture
def cloud(scene, tmp_path):
    """A small cloud: the valid object of each scene."""
    scene.render.engine = "MRPNN"
    scene.render.resolution_x, scene.render.resolution_y = 16, 12
    scene.mrpnn.depth_samples = 1
    return blender_scenes.cloud_scene(scene, tmp_path)


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


def refusal(addon) -> str:
    with pytest.raises(SceneError) as caught:
        read(addon)
    return str(caught.value)


def alpha_of(addon, scene):
    """Alpha of the scene as `Render Volumes` renders it."""
    found = addon.mrpnn_addon.engine.render_job.render_scene(read(addon), scene.mrpnn.settings())
    assert np.isfinite(found.layer.rgb).all() and np.isfinite(found.layer.alpha).all()
    return found.layer.alpha, found.warnings


@pytest.fixture(scope="module")
def rendered_alone():
    """What `alone` has rendered: one image."""
    return []


@pytest.fixture
def alone(addon, scene, cloud, rendered_alone):
    """Alpha of the cloud by itself, which is the same in every test."""
    if not rendered_alone:
        rendered_alone.append(alpha_of(addon, scene)[0])
    return rendered_alone[0]


def second_cloud(scene, folder, name="Second", **inputs):
    path = blender_scenes.write_vdb(folder, blender_scenes.blob(), blender_scenes.centred(16, 1.0))
    added, node = blender_scenes.add_volume(scene, path, name, **inputs)
    added.location.x = 1.0
    return added, node


def cube(scene, name="Cube"):
    mesh = bpy.data.meshes.new(name)
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    mesh.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    return blender_scenes.add_object(scene, name, mesh)


def fog_cube(scene, name="Second"):
    added = cube(scene, name)
    added.location.x = 1.5
    return added, blender_scenes.add_fog(added.data, name, "ShaderNodeVolumePrincipled")


# Mistakes


def missing_file(scene, folder):
    second_cloud(scene, folder)[0].data.filepath = str(folder / "gone.vdb")


def no_file(scene, folder):
    blender_scenes.add_object(scene, "Second", bpy.data.volumes.new("Second"))


def no_volume_file(scene, folder):
    (folder / "text.vdb").write_text("not a volume")
    second_cloud(scene, folder)[0].data.filepath = str(folder / "text.vdb")


def empty_grid(scene, folder):
    path = blender_scenes.write_vdb(folder, np.zeros((4, 4, 4)))
    blender_scenes.add_volume(scene, path, "Second")


def background_grid(scene, folder):
    blender_scenes.add_volume(scene, blender_scenes.write_vdb(folder, blender_scenes.blob(), background=0.5), "Second")


def unsupported_node(scene, folder):
    _, node = second_cloud(scene, folder)
    tree = node.id_data
    tree.links.new(tree.nodes.new("ShaderNodeBsdfDiffuse").outputs[0], tree.nodes["Material Output"].inputs["Volume"])


def no_density(scene, folder):
    second_cloud(scene, folder, Density=0.0)


def several_materials(scene, folder):
    mesh = fog_cube(scene)[0].data
    blender_scenes.add_fog(mesh, "More", "ShaderNodeVolumeScatter")
    mesh.polygons[0].material_index = 1


def open_mesh(scene, folder):
    mesh = fog_cube(scene)[0].data
    corners = [vertex.co[:] for vertex in mesh.vertices]
    faces = [tuple(polygon.vertices) for polygon in mesh.polygons][:-1]
    mesh.clear_geometry()
    mesh.from_pydata(corners, [], faces)


def not_a_number(scene, folder):
    second_cloud(scene, folder)[0].location.x = NAN


def far_away(scene, folder):
    second_cloud(scene, folder)[0].location.x = 1e30


def vertices_of_no_number(scene, folder):
    fog_cube(scene)[0].data.vertices[0].co.x = NAN


MISTAKES = [
    (missing_file, "file not found"),
    (no_file, "loads no file"),
    (no_volume_file, "as OpenVDB"),
    (empty_grid, "is empty"),
    (background_grid, "background 0.5"),
    (unsupported_node, "not supported"),
    (no_density, "neither scatters"),
    (several_materials, "several volume materials"),
    (open_mesh, "not closed"),
    (not_a_number, "not finite"),
    (far_away, "exceeds 1e+09"),
    (vertices_of_no_number, "not finite"),
]
# One of each part: the file, its grid, the material, a mesh and the transform.
QUICK = missing_file, background_grid, unsupported_node, open_mesh, not_a_number


@pytest.mark.parametrize(
    "mistake, said",
    [
        pytest.param(make, said, id=make.__name__, marks=() if make in QUICK else pytest.mark.slow)
        for make, said in MISTAKES
    ],
)
def test_an_invalid_volume_is_named_and_the_others_are_rendered(addon, scene, cloud, alone, tmp_path, mistake, said):
    mistake(scene, tmp_path)
    described = read(addon)
    assert [volume.name for volume, _ in described.volumes] == ["Cloud"]
    (warning,) = [text for text in described.warnings if '"Second"' in text]
    assert said in warning and warning.endswith("(left out)")
    (problem,) = described.refused
    assert problem in warning and described.left_out == {"Second"}
    found, warned = alpha_of(addon, scene)
    np.testing.assert_array_equal(found, alone)
    assert warning in warned
    # Panels ask too, at every redraw. Only of a file can they tell without reading it that it is missing.
    told = addon.mrpnn_addon.status.forecast.forecast(blender_scenes.depsgraph())
    if mistake is missing_file:
        assert (told.volumes, told.empty) == (1, 1)
        assert told.warnings == ['volume "Second" is empty, or its file is missing (left out)']
    # With nothing else to render it is an error with the same message.
    bpy.data.objects.remove(cloud)
    message = refusal(addon)
    assert message.startswith("no volume is left to render: ") and said in message
    addon.mrpnn_addon.status.forecast.forecast(blender_scenes.depsgraph())


def test_each_of_several_invalid_volumes_is_named_with_its_reason(addon, scene, cloud, tmp_path):
    cloud.data.filepath = str(tmp_path / "gone.vdb")
    open_mesh(scene, tmp_path)
    cube(scene, "Hidden")
    blender_scenes.add_fog(scene.objects["Hidden"].data, "Hidden", "ShaderNodeVolumeScatter")
    scene.objects["Hidden"].visible_camera = False
    message = refusal(addon)
    for said in ('"Cloud": file not found', '"Second": the mesh is not closed', '"Hidden" is hidden from the camera'):
        assert said in message


def test_a_black_frame_names_lights_alone(addon, scene, cloud, tmp_path):
    """A volume that is left out as well is no reason for the darkness of others."""
    missing_file(scene, tmp_path)
    scene.objects["Sun"].hide_render = True
    found = addon.mrpnn_addon.scene.reader.read_frame(blender_scenes.depsgraph())
    (black,) = [warning for warning in found.warnings if "is black" in warning]
    assert '"Sun" is hidden' in black and '"Second"' not in black
    assert any('"Second"' in warning and "(left out)" in warning for warning in found.warnings)


def test_instances_of_an_invalid_volume_are_named_once(addon, scene, cloud, tmp_path):
    missing_file(scene, tmp_path)
    group, second = bpy.data.collections.new("Group"), scene.objects["Second"]
    scene.collection.objects.unlink(second)
    group.objects.link(second)
    for x in range(5):
        empty = blender_scenes.add_object(scene, f"At {x}", None)
        empty.instance_type, empty.instance_collection, empty.location.x = "COLLECTION", group, x
    described = read(addon)
    assert len(described.volumes) == len(described.refused) == 1
    assert described.left_out == {f"Second in At {x}" for x in range(5)}


@pytest.mark.parametrize(
    "mistake, said",
    [
        (lambda sun: setattr(sun.rotation_euler, "x", NAN), "not finite"),
        (lambda sun: setattr(sun.data, "color", (NAN, 1.0, 1.0)), "strength is not finite; check"),
        (lambda sun: setattr(sun.data, "energy", -1.0), "negative"),
        (lambda sun: setattr(sun, "scale", (0.0, 0.0, 0.0)), "scale 0"),
        (lambda sun: nodes_of(sun), "Blackbody"),
    ],
)
def test_an_invalid_light_is_named_and_left_out(addon, scene, cloud, mistake, said):
    bad = blender_scenes.add_sun(scene, "Second")
    mistake(bad)
    described = read(addon)
    assert [sun.name for sun in described.suns] == ['sun "Sun"']
    (warning,) = [text for text in described.warnings if '"Second"' in text]
    assert said in warning and described.refused
    alpha_of(addon, scene)
    forecast = addon.mrpnn_addon.status.forecast.forecast(blender_scenes.depsgraph())
    assert forecast.suns == 1 and not forecast.problem and warning in forecast.warnings
    # It was the last one: an error that says why.
    bpy.data.objects.remove(scene.objects["Sun"])
    message = refusal(addon)
    assert "no sun" in message and said in message


def nodes_of(sun):
    sun.data.use_nodes = True
    tree = sun.data.node_tree
    emission = next(node for node in tree.nodes if node.bl_idname == "ShaderNodeEmission")
    tree.links.new(tree.nodes.new("ShaderNodeTexNoise").outputs[0], emission.inputs["Strength"])
    tree.nodes["Noise Texture"].name = "Blackbody"


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.5, 2.0])
def test_a_sun_flattened_on_one_axis_shines_where_it_points(addon, scene, cloud, angle):
    sun = scene.objects["Sun"]
    sun.data.angle = angle
    whole = read(addon).suns
    sun.scale = (0.0, 1.0, 1.0)
    flat = read(addon).suns
    assert len(flat) == len(whole)
    mean = [np.sum([one.direction * one.irradiance.sum() for one in suns], axis=0) for suns in (whole, flat)]
    np.testing.assert_allclose(*mean, atol=1e-5)


@pytest.mark.parametrize(
    "mistake",
    [
        lambda wall: setattr(wall, "location", (NAN, 0.0, 0.0)),
        lambda wall: setattr(wall, "scale", (1e20, 1.0, 1.0)),
        lambda wall: setattr(wall.data.vertices[0], "co", (NAN, 0.0, 0.0)),
    ],
)
def test_an_invalid_surface_is_named_and_left_out(addon, scene, cloud, alone, mistake):
    wall = cube(scene, "Wall")
    mistake(wall)
    described = read(addon)
    assert not described.opaque and '"Wall"' in described.refused[0]
    np.testing.assert_array_equal(alpha_of(addon, scene)[0], alone)


@pytest.mark.parametrize(
    "scale",
    [
        (0, 1, 1),
        (0, 0, 0),
        (1e6, 1, 1),
        *(pytest.param(scale, marks=pytest.mark.slow) for scale in ((1, 0, 1), (1, 1, 0), (0, 0, 1), (1e-7,) * 3)),
    ],
)
def test_a_surface_may_be_flat(addon, scene, cloud, scale):
    """Scaled to 0 on one axis it is a wall, as in Cycles; on all, it is nothing."""
    cube(scene, "Wall").scale = scale
    alpha_of(addon, scene)
    assert not read(addon).refused


@pytest.mark.parametrize(
    "mistake, said",
    [
        (lambda camera: setattr(camera, "scale", (0.0, 1.0, 1.0)), '"Camera": it has scale 0'),
        (lambda camera: setattr(camera, "location", (NAN, 0.0, 0.0)), '"Camera": its location'),
        (lambda camera: setattr(camera, "location", (1e30, 0.0, 0.0)), '"Camera": its location or scale exceeds'),
        (lambda camera: setattr(camera.data, "type", "PANO"), "of type Fisheye Equisolid"),
        (lambda camera: empty_as_camera(), '"Empty", which is not a camera'),
    ],
)
def test_a_camera_that_cannot_be_used_is_an_error(addon, scene, cloud, mistake, said):
    mistake(scene.camera)
    assert said in refusal(addon)
    assert said in addon.mrpnn_addon.status.forecast.forecast(blender_scenes.depsgraph()).problem


def empty_as_camera():
    bpy.context.scene.camera = blender_scenes.add_object(bpy.context.scene, "Empty", None)


# Scale 0, and volumes that have not begun


@pytest.mark.parametrize("kind", ["file", "mesh"])
@pytest.mark.parametrize(
    "scale",
    [
        (0, 1, 1),
        (0, 0, 0),
        *(
            pytest.param(scale, marks=pytest.mark.slow)
            for scale in ((1, 0, 1), (1, 1, 0), (0, 0, 1), (1, 1, 1e-12), (1e-30,) * 3)
        ),
    ],
)
def test_a_volume_of_scale_0_is_nothing_in_that_frame(addon, scene, cloud, alone, tmp_path, kind, scale):
    second, _ = second_cloud(scene, tmp_path) if kind == "file" else fog_cube(scene)
    second.scale = scale
    found, warned = alpha_of(addon, scene)
    np.testing.assert_array_equal(found, alone)
    assert warned == ['volume "Second" has scale 0 in frame 1 (left out)'] and not read(addon).refused
    forecast = addon.mrpnn_addon.status.forecast.forecast(blender_scenes.depsgraph())
    assert forecast.volumes == 1
    # Alone, the picture is empty.
    bpy.data.objects.remove(cloud)
    found, warned = alpha_of(addon, scene)
    assert not found.any() and warned == ['volume "Second" has scale 0 in frame 1 (left out)']


@pytest.mark.parametrize(
    "scale, location",
    [
        ((1e-7,) * 3, 0.0),
        ((1e8, 1e8, 1e8), 0.0),
        ((1, 1, 1), 1e8),
        *(
            pytest.param(scale, 0.0, marks=pytest.mark.slow)
            for scale in ((1e-4,) * 3, (1, 1, 1e-6), (1e-6, 1, 1e-6), (1e6, 1e6, 1e6), (-1, 1, 1))
        ),
    ],
)
@pytest.mark.parametrize("kind", ["file", "mesh"])
def test_extreme_transforms_are_rendered_without_warnings(addon, scene, cloud, tmp_path, kind, scale, location):
    bpy.data.objects.remove(cloud)
    second, _ = second_cloud(scene, tmp_path) if kind == "file" else fog_cube(scene)
    second.scale, second.location.x = scale, location
    described = read(addon)
    assert not described.refused and len(described.volumes) == 1
    alpha_of(addon, scene)
    addon.mrpnn_addon.status.forecast.forecast(blender_scenes.depsgraph())


def test_matrices_singular_from_shear_are_nothing_too(addon, scene, cloud, tmp_path):
    second, _ = second_cloud(scene, tmp_path)
    second.matrix_world = Matrix(((1, 1, 0, 0), (1, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1)))
    alpha_of(addon, scene)


def keyed(owner, path, values):
    for frame, value in enumerate(values, 1):
        setattr(owner, path, value)
        owner.keyframe_insert(path, frame=frame)


def test_an_animation_that_begins_at_scale_0_or_density_0_is_rendered_from_the_start(addon, scene, cloud, tmp_path):
    """By the render engine, each alone in its scene; all frames are written, the first ones empty."""
    node = cloud.data.materials[0].node_tree.nodes["Principled Volume"]
    keyed(cloud, "scale", [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1.0, 1.0, 1.0)])
    keyed(node.inputs["Density"], "default_value", [4.0, 0.0, 4.0])
    scene.render.film_transparent = True
    scene.frame_start, scene.frame_end = 1, 3
    scene.render.image_settings.file_format = "OPEN_EXR"
    scene.render.image_settings.color_mode = "RGBA"
    scene.render.filepath = str(tmp_path / "frame")
    bpy.ops.render.render(animation=True)
    peaks = []
    for frame in (1, 2, 3):
        image = bpy.data.images.load(str(tmp_path / f"frame{frame:04}.exr"))
        peaks.append(np.array(image.pixels).reshape(-1, 4)[:, 3].max())
    assert peaks[0] == peaks[1] == 0.0 and peaks[2] > 0.3
    for frame, said in ((1, "has scale 0 in frame 1"), (2, "is empty in frame 2")):
        scene.frame_set(frame)
        assert read(addon).warnings == [f'volume "Cloud" {said} (left out)']


def test_a_sequence_that_begins_with_an_empty_grid_starts_with_empty_pictures(addon, scene, cloud, tmp_path):
    """As simulations write them; a single file without voxels is a mistake."""
    for number, density in ((1, np.zeros((16, 16, 16))), (2, blender_scenes.blob())):
        path = blender_scenes.write_vdb(tmp_path, density, blender_scenes.centred(16, 2.0))
        shutil.move(path, tmp_path / f"smoke_{number}.vdb")
    cloud.data.filepath = str(tmp_path / "smoke_1.vdb")
    cloud.data.is_sequence, cloud.data.frame_start, cloud.data.frame_duration = True, 1, 2
    scene.frame_set(1)
    found, warned = alpha_of(addon, scene)
    assert not found.any() and warned == ['volume "Cloud" is empty in frame 1 (left out)']
    scene.frame_set(2)
    assert alpha_of(addon, scene)[0].any()


# F12, the button and the command line


def test_f12_and_the_operator_render_the_rest_and_name_what_is_missing(addon, scene, cloud, tmp_path):
    missing_file(scene, tmp_path)
    scene.render.filepath = str(tmp_path / "still.png")
    bpy.ops.render.render(write_still=True)
    assert (tmp_path / "still.png").is_file()
    last = addon.mrpnn_addon.status.last_render
    assert any("gone.vdb" in warning for warning in last.last_render().warnings)
    last.remember(None)
    assert bpy.ops.mrpnn.render() == {"FINISHED"}
    assert any("gone.vdb" in warning for warning in last.last_render().warnings)
    assert bpy.ops.mrpnn.check() == {"FINISHED"}
    check = addon.mrpnn_addon.status.scene_check.last_check()
    assert not check.error and any("gone.vdb" in warning for warning in check.warnings)
    assert check.voxels == {"Cloud": (16, 16, 16)}


def test_a_comparison_shows_cycles_what_the_layer_shows(addon, scene, cloud, tmp_path):
    unsupported_node(scene, tmp_path)
    described = read(addon)
    shown = addon.mrpnn_addon.cycles.reference.volumes_and_lights(blender_scenes.depsgraph(), described.left_out)
    assert {item.name for item in shown} == {"Cloud", "Sun"}


def test_the_command_line_is_strict_on_request(addon, scene, cloud, tmp_path, capsys):
    missing_file(scene, tmp_path)
    command, output = addon.operators.command.main, tmp_path / "out.exr"
    for action in (["render", "--output", str(output)], ["report"]):
        assert command([*action, "--strict", "--json", str(tmp_path / "facts.json")]) == 1
        said = capsys.readouterr().err
        assert said.startswith('mrpnn: error: volume "Second": file not found') and said.count("\n") == 1
        assert "gone.vdb" in json.loads((tmp_path / "facts.json").read_text())["error"] and not output.exists()
        assert command(action) == 0
        assert 'mrpnn: warning: volume "Second": file not found' in capsys.readouterr().err
        assert output.exists() == (action[0] == "render")
        output.unlink(missing_ok=True)
    # A volume that has not begun is no error.
    scene.objects["Second"].data.filepath = cloud.data.filepath
    scene.objects["Second"].scale = (0.0, 0.0, 0.0)
    assert command(["render", "--output", str(output), "--strict"]) == 0
    assert "has scale 0" in capsys.readouterr().err


@pytest.mark.parametrize(
    "load",
    [lambda path: bpy.ops.wm.open_mainfile(filepath=path), lambda path: bpy.ops.wm.read_homefile(use_empty=True)],
)
def test_loading_another_file_clears_the_former_ones_messages(addon, scene, cloud, tmp_path, load):
    missing_file(scene, tmp_path)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.mrpnn.render()
    bpy.ops.mrpnn.check()
    said = addon.mrpnn_addon.status
    said.last_comparison.remember("a comparison", tmp_path)
    load(str(tmp_path / "scene.blend"))
    assert said.last_render.last_render() is None and said.scene_check.last_check() is None
    assert said.last_comparison.last_comparison() is None


PROCESS = """
import sys
import bpy
from benchmarks.support.extension import load_extension
package = load_extension()
bpy.ops.wm.open_mainfile(filepath=sys.argv[1])
bpy.context.scene.render.filepath = sys.argv[2]
bpy.ops.render.render(animation=True)
package.unregister()
"""


def test_the_console_shows_no_numpy_warnings(scene, cloud, tmp_path):
    """An animation of everything that may go wrong, in a process of its own, as on a render farm."""
    not_a_number(scene, tmp_path)
    keyed(cloud, "scale", [(0.0, 0.0, 0.0), (0.0, 1.0, 1.0), (1e-8, 1e-8, 1e-8), (1.0, 1.0, 1.0)])
    wall = cube(scene, "Wall")
    keyed(wall, "scale", [(0.0, 0.0, 0.0), (1.0, 0.0, 1.0), (0.1, 0.1, 0.1), (1e20, 1.0, 1.0)])
    blender_scenes.add_sun(scene, "Second").scale = (0.0, 0.0, 0.0)
    scene.frame_start, scene.frame_end = 1, 4
    blend = tmp_path / "scene.blend"
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    run = subprocess.run(
        [sys.executable, "-c", PROCESS, str(blend), str(tmp_path / "frame")],
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=120,
        env={**os.environ, "PYTHONWARNINGS": "always::RuntimeWarning"},
    )
    said = run.stdout + run.stderr
    assert run.returncode == 0 and len(list(tmp_path.glob("frame*"))) == 4, said
    assert "RuntimeWarning" not in said and "Traceback" not in said, said
    assert "has scale 0 in frame 1" in said and '"Second": its location' in said


def test_glass_around_the_only_volume_is_named(addon, scene):
    bpy.ops.mesh.primitive_cube_add()
    bpy.context.object.name = "Tank"
    blender_scenes.add_fog(bpy.context.object.data, "Tank", "ShaderNodeVolumePrincipled")
    tree = bpy.context.object.data.materials[0].node_tree
    glass = tree.nodes.new("ShaderNodeBsdfGlass")
    tree.links.new(glass.outputs[0], tree.nodes["Material Output"].inputs["Surface"])
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene)
    message = refusal(addon)
    assert '"Tank": a volume inside a transparent surface' in message and "unlink its surface" in message
