# SPDX-License-Identifier: GPL-3.0-or-later
"""Opaque meshes in front of, inside and behind volumes, against Cycles rendering everything together."""

import time

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")
from mathutils import Vector

from inference import Cancelled, SceneError, Settings, render
from tests.support import blender_scenes


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


def ball(scene, location, radius=0.6):
    """A black ball that casts no shadow."""
    mesh = bpy.data.meshes.new("Ball")
    import bmesh

    shape = bmesh.new()
    bmesh.ops.create_icosphere(shape, subdivisions=3, radius=radius)
    shape.to_mesh(mesh)
    shape.free()
    material = bpy.data.materials.new("Black")
    material.use_nodes = True
    material.node_tree.nodes["Principled BSDF"].inputs["Base Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    material.node_tree.nodes["Principled BSDF"].inputs["Specular IOR Level"].default_value = 0.0
    mesh.materials.append(material)
    added = blender_scenes.add_object(scene, "Ball", mesh)
    added.location, added.visible_shadow = location, False
    return added


@pytest.mark.parametrize(
    "kind, place",
    [
        ("PERSP", "inside"),
        *(
            pytest.param(kind, place, marks=pytest.mark.slow)
            for kind, place in (
                ("PERSP", "before"),
                ("PERSP", "behind"),
                ("ORTHO", "before"),
                ("ORTHO", "inside"),
                ("ORTHO", "behind"),
            )
        ),
    ],
)
def test_a_ball_hides_what_lies_behind_it(addon, scene, tmp_path, place, kind):
    """Alpha and single scattering equal those of Cycles with the ball as a holdout."""
    scene.render.resolution_x = scene.render.resolution_y = 48
    blender_scenes.cloud_scene(scene, tmp_path)
    scene.camera.data.type, scene.camera.data.ortho_scale = kind, 2.2
    scene.camera.location = (0.4, 0.2, 6.0)
    parent = blender_scenes.add_object(scene, "Parent", None)
    parent.scale, parent.rotation_euler = (1.0, 0.8, -1.1), (0.2, 0.1, 0.4)
    hidden = ball(scene, {"before": (0.2, 0.1, -1.2), "inside": (0.2, 0.1, 0.0), "behind": (0.2, 0.1, 1.4)}[place])
    hidden.parent = parent
    described = read(addon)
    assert len(described.surfaces) == 1
    [warning] = described.warnings
    assert '"Ball"' in warning and "hides, shades and lights volumes" in warning
    settings = Settings(multiple=False)
    layer, alone = (
        render(described.volumes, described.suns, described.camera, settings, surfaces=surfaces)
        for surfaces in (described.surfaces, [])
    )
    hidden.is_holdout = True
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=256)
    level, seen = expected[..., 3].mean(), expected[..., 3] > 0.005
    # Cycles averages over each pixel, the layer evaluates the fog at its centre.
    assert np.sqrt(((layer.alpha - expected[..., 3])[seen] ** 2).mean()) < 0.08 * expected[..., 3][seen].mean()
    assert layer.alpha.mean() == pytest.approx(level, rel=0.01)
    assert layer.single.mean() == pytest.approx(expected[..., :3].mean(), rel=0.02)
    covered = alone.alpha.mean() - layer.alpha.mean()
    assert (covered > 0.05 * level) == (place != "behind")


def glass(material):
    nodes = material.node_tree.nodes
    nodes["Principled BSDF"].inputs["Transmission Weight"].default_value = 1.0


def mixed_with_transparency(material):
    tree = material.node_tree
    mixed, clear = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
    tree.links.new(tree.nodes["Principled BSDF"].outputs[0], mixed.inputs[1])
    tree.links.new(clear.outputs[0], mixed.inputs[2])
    tree.links.new(mixed.outputs[0], tree.get_output_node("CYCLES").inputs["Surface"])


@pytest.mark.parametrize("change", [glass, mixed_with_transparency])
def test_transparent_surfaces_are_named(addon, scene, tmp_path, change):
    blender_scenes.cloud_scene(scene, tmp_path)
    change(ball(scene, (0.0, 0.0, 2.0)).data.materials[0])
    described = read(addon)
    assert not described.surfaces
    [warning] = described.warnings
    assert '"Ball"' in warning and "is transparent" in warning


def test_a_surface_that_hides_its_own_fog_says_how_to_show_it(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    filled = ball(scene, (0.0, 0.0, 2.0))
    tree = filled.data.materials[0].node_tree
    output, fog = tree.nodes["Material Output"], tree.nodes.new("ShaderNodeVolumePrincipled")

    def said():
        panel = addon.mrpnn_addon.scene.unrendered.unrendered(blender_scenes.depsgraph()).fog
        return [*filter(None, [panel]), *(text for text in read(addon).warnings if "Unlink Surface" in text)]

    assert said() == []
    tree.links.new(fog.outputs[0], output.inputs["Volume"])
    assert len(said()) == 2 and all('"Ball" hides the fog of its own material' in text for text in said())
    scene.objects["Cloud"].hide_viewport = scene.objects["Cloud"].hide_render = True
    with pytest.raises(SceneError, match='"Ball" hides the fog of its own material'):
        read(addon)
    scene.objects["Cloud"].hide_viewport = scene.objects["Cloud"].hide_render = False
    tree.links.remove(output.inputs["Surface"].links[0])
    assert said() == [] and len(read(addon).volumes) == 2


def test_instances_and_text_occlude_and_objects_hidden_from_the_camera_do_not(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    shown = ball(scene, (0.0, 0.0, 2.0))
    text = blender_scenes.add_object(scene, "Words", bpy.data.curves.new("Words", "FONT"))
    text.data.body = "fog"
    group = bpy.data.collections.new("Group")
    group.objects.link(shown)
    blender_scenes.add_object(scene, "Copy", None).instance_type = "COLLECTION"
    bpy.data.objects["Copy"].instance_collection = group
    bpy.data.objects["Copy"].location = (1.0, 0.0, 0.0)
    described = read(addon)
    # Blender shows a text twice, as itself and as its mesh.
    middles = sorted(
        {tuple(np.round(surface.triangles.reshape(-1, 3).mean(axis=0), 2)) for surface in described.surfaces}
    )
    assert len(middles) == 3
    assert np.allclose(middles[0], (0.0, 0.0, 2.0), atol=0.02) and np.allclose(middles[2], (1.0, 0.0, 2.0), atol=0.02)
    shown.visible_camera = text.visible_camera = text.visible_shadow = text.visible_volume_scatter = False
    shown.visible_shadow = True
    # The ball and its copy still cast shadows; the text does not.
    assert [(surface.covers, surface.shades) for surface in read(addon).surfaces] == [(False, True)] * 2


def test_a_panorama_warns_that_surfaces_do_not_occlude(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    ball(scene, (0.0, 0.0, 2.0))
    lens = scene.camera.data
    lens.type = "PANO"
    if hasattr(lens, "panorama_type"):  # 5.0 and later
        lens.panorama_type = "EQUIRECTANGULAR"
    else:
        lens.cycles.panorama_type = "EQUIRECTANGULAR"
    described = read(addon)
    assert any('"Ball"' in warning and "panoramas" in warning for warning in described.warnings)


@pytest.mark.parametrize("kind", ["SINGLE", pytest.param("SEVERAL", marks=pytest.mark.slow)])
def test_a_balls_shadow_equals_cycles(addon, scene, tmp_path, kind):
    """Single scattering with the ball between sun and cloud, alone and beside other surfaces."""
    scene.render.resolution_x = scene.render.resolution_y = 48
    blender_scenes.cloud_scene(scene, tmp_path)
    bpy.context.view_layer.update()
    towards = np.array(bpy.data.objects["Sun"].matrix_world.to_3x3())[:, 2]
    balls = [ball(scene, 2.5 * towards, radius=0.35)]
    if kind == "SEVERAL":
        balls += [ball(scene, (-3.0, 0.0, 0.0)), ball(scene, -2.5 * towards)]
    for shown in balls:
        shown.visible_shadow, shown.visible_camera = True, False
    described = read(addon)
    assert any("shade" in warning for warning in described.warnings)
    settings = Settings(multiple=False)
    layer, alone = (
        render(described.volumes, described.suns, described.camera, settings, surfaces=surfaces)
        for surfaces in (described.surfaces, [])
    )
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=512)
    level, seen = expected[..., :3].mean(), expected[..., 3] > 0.005
    assert layer.single.mean() == pytest.approx(level, rel=0.02)
    assert alone.single.mean() > 1.1 * level
    error = np.sqrt(((layer.single - expected[..., :3])[seen] ** 2).mean()) / expected[..., :3][seen].mean()
    before = np.sqrt(((alone.single - expected[..., :3])[seen] ** 2).mean()) / expected[..., :3][seen].mean()
    assert error < 0.3 * before


@pytest.mark.slow
def test_reading_and_rasterizing_surfaces_can_be_cancelled(addon, scene, tmp_path):
    """Two meshes of half a million triangles: at most a second of two threads between two polls."""
    # Enough rays for several tasks.
    scene.render.resolution_x = scene.render.resolution_y = 128
    blender_scenes.cloud_scene(scene, tmp_path)
    for height in (-1.0, 0.2):
        bpy.ops.mesh.primitive_grid_add(x_subdivisions=500, y_subdivisions=500, size=8.0, location=(0.0, 0.0, height))
    looks, marching = [time.process_time()], []

    def look():
        looks.append(time.process_time())
        return bool(marching)

    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph(), check=look)
    assert [len(surface.triangles) for surface in described.surfaces] == [500_000] * 2
    read = len(looks)
    with pytest.raises(Cancelled):
        render(
            described.volumes,
            described.suns,
            described.camera,
            Settings(multiple=False),
            cancelled=look,
            progress=lambda share, message: "single" in message and marching.append(message),
            surfaces=described.surfaces,
        )
    assert marching and 4 < read < len(looks) - 10
    assert max(np.diff(looks)) < 2.0


@pytest.mark.parametrize("kind", ["triangles", "quads", "concave quads", "pentagons"])
def test_triangles_equal_blenders(addon, scene, kind):
    """Also of polygons that are not planar."""
    bpy.ops.mesh.primitive_ico_sphere_add(
        subdivisions=3
    ) if kind == "triangles" else bpy.ops.mesh.primitive_uv_sphere_add()
    shown, random = bpy.context.object, np.random.default_rng(2)
    if kind == "concave quads":
        shown.data.clear_geometry()
        shown.data.from_pydata(
            [(0, 0, 0), (1, 0, 0), (0.2, 0.2, 0), (0, 1, 0), (1, 1, 0)], [], [(1, 2, 3, 0), (0, 1, 2, 3)]
        )
    elif kind == "pentagons":
        shown.data.clear_geometry()
        shown.data.from_pydata([(np.cos(a), np.sin(a), 0.1 * a) for a in range(6)], [], [(0, 1, 2, 3, 4), (0, 4, 5)])
    else:
        for vertex in shown.data.vertices:
            vertex.co += Vector(0.02 * random.normal(size=3))
    matrix = np.eye(4)
    matrix[:3] += 0.3 * random.normal(size=(3, 4))
    found = addon.mrpnn_addon.objects.mesh_triangles.read_mesh(
        shown.evaluated_get(blender_scenes.depsgraph())
    ).triangles(matrix)
    shown.data.calc_loop_triangles()
    places = np.array([vertex.co for vertex in shown.data.vertices]) @ matrix[:3, :3].T + matrix[:3, 3]
    expected = places[[tuple(triangle.vertices) for triangle in shown.data.loop_triangles]]
    assert len(found) > 2
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.slow
def test_a_million_triangles_hold_blenders_main_thread_only_briefly(addon, scene, tmp_path):
    """0.2 processor seconds at most; the render thread does the rest."""
    blender_scenes.cloud_scene(scene, tmp_path)
    bpy.ops.mesh.primitive_grid_add(x_subdivisions=707, y_subdivisions=707, size=8.0)
    reader, depsgraph = addon.mrpnn_addon.volumes.reader.VolumeReader(), blender_scenes.depsgraph()
    for source in reader.wanted(depsgraph):
        reader.known[source.key] = source.read()
    start = time.thread_time()
    described = addon.mrpnn_addon.scene.reader.read_scene(depsgraph, reader)
    assert time.thread_time() - start < 0.2
    (surface,) = described.surfaces
    assert len(surface.triangles) == 2 * 707**2


@pytest.mark.parametrize(
    "places, edges", [([], []), ([(0.0, 0.0, 3.0), (1.0, 0.0, 3.0)], [(0, 1)])], ids=["empty", "an edge"]
)
def test_meshes_without_faces_are_no_surfaces(addon, scene, tmp_path, places, edges):
    blender_scenes.cloud_scene(scene, tmp_path)
    mesh = bpy.data.meshes.new("bare")
    mesh.from_pydata(places, edges, [])
    blender_scenes.add_object(scene, "bare", mesh)
    assert read(addon).surfaces == []


def told(capfd, word='"Ball"'):
    """Lines of a render on the console that mention the ball, or a word."""
    return [line for line in capfd.readouterr().out.splitlines() if word in line]


def test_f12_tells_of_a_surface_once(addon, scene, tmp_path, capfd):
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.mrpnn.depth_samples = 1
    blender_scenes.cloud_scene(scene, tmp_path)
    shown = ball(scene, (0.0, 0.0, -2.0))
    scene.render.engine = "MRPNN"
    capfd.readouterr()
    blender_scenes.rendered(scene, tmp_path)
    lines = told(capfd)
    assert len(lines) == 1 and "Composite over Cycles renders it, too" in lines[0]
    # One that volumes do not meet either is named as well.
    shown.visible_camera = shown.visible_volume_scatter = False
    blender_scenes.rendered(scene, tmp_path)
    assert len(told(capfd)) == 1


@pytest.mark.parametrize("textured", [False, True])
def test_a_composite_does_not_offer_a_composite(addon, scene, tmp_path, capfd, textured):
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.mrpnn.depth_samples = 1
    blender_scenes.cloud_scene(scene, tmp_path)
    shown = ball(scene, (0.0, 0.0, -2.0))
    if textured:
        tree = shown.data.materials[0].node_tree
        texture = tree.nodes.new("ShaderNodeTexNoise")
        tree.links.new(texture.outputs["Color"], tree.nodes["Principled BSDF"].inputs["Base Color"])
    bpy.ops.mrpnn.composite()
    capfd.readouterr()
    blender_scenes.render_cycles(scene, tmp_path, samples=1)
    lines = told(capfd)
    assert not any("Composite" in line or "ot rendered" in line for line in lines)
    assert len(lines) == textured and all("without textures" in line for line in lines)
    # Blender's bar is full once Cycles is done: the status says what is counted.
    blender_scenes.rendered(scene, tmp_path)
    assert any("%" in line for line in told(capfd, "Volumes of the composite"))
    bpy.ops.mrpnn.composite_remove()
    scene.render.engine = "MRPNN"
    blender_scenes.rendered(scene, tmp_path)
    assert not told(capfd, "Volumes of the composite")
