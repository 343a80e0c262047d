# SPDX-License-Identifier: GPL-3.0-or-later
"""The cases of docs/trust/scenes.md in which Cycles departs from the absorption law, or from a lamp's power, and this
engine does not.
"""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes

DEPTH = 1.0


@pytest.fixture
def box(scene, tmp_path):
    """Makes a box of edge 2 and optical thickness DEPTH below an orthographic camera, of voxels of about a value."""
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene, ortho_scale=0.5)
    scene.render.resolution_x = scene.render.resolution_y = 8

    def make(value=1.0):
        # Not uniform: OpenVDB stores uniform blocks in another way.
        values = np.random.default_rng(6).uniform(0.95, 1.05, (16, 16, 16)) * value
        path = blender_scenes.write_vdb(tmp_path, values, blender_scenes.centred(16, 2.0))
        return blender_scenes.add_volume(scene, path, Density=0.5 * DEPTH / value, Color=(0.0, 0.0, 0.0, 1.0))[0]

    return make


def alphas(scene, folder):
    """Mean alpha in Cycles and here."""
    scene.mrpnn.depth_samples = 1
    cycles = blender_scenes.render_cycles(scene, folder, samples=16)[..., 3].mean()
    scene.render.engine = "MRPNN"
    return cycles, blender_scenes.rendered(scene, folder)[..., 3].mean()


def opaque(depth):
    return 1.0 - np.exp(-depth)


def test_two_objects_of_one_volume_in_one_place(addon, scene, box, tmp_path):
    cloud = box()
    scene.collection.objects.link(cloud.copy())
    cycles, found = alphas(scene, tmp_path)
    assert found == pytest.approx(opaque(2.0 * DEPTH), abs=0.01)
    assert cycles == pytest.approx(opaque(DEPTH), abs=0.01)


def test_values_below_clipping(addon, scene, box, tmp_path):
    box(value=0.0005)
    cycles, found = alphas(scene, tmp_path)
    assert found == pytest.approx(opaque(DEPTH), abs=0.01) and cycles == 0.0


def test_clip_end_and_clip_start_inside_a_volume(addon, scene, box, tmp_path):
    box()
    scene.camera.data.clip_end = 6.0
    cycles, found = alphas(scene, tmp_path)
    # The box fades to 0 within a voxel.
    assert found == pytest.approx(opaque(0.5 * DEPTH), abs=0.03) and cycles == 0.0
    scene.camera.data.clip_start, scene.camera.data.clip_end = 6.0, 100.0
    cycles, found = alphas(scene, tmp_path)
    assert found == pytest.approx(opaque(0.5 * DEPTH), abs=0.03) and cycles == pytest.approx(found, rel=0.01)
    graph = blender_scenes.depsgraph()
    assert not addon.mrpnn_addon.scene.reader.read_scene(graph).warnings


def mean_light(scene, folder):
    """Mean radiance in Cycles and here, of light that has scattered once in thin fog."""
    scene.mrpnn.depth_samples = 1
    cycles = blender_scenes.render_cycles(scene, folder, samples=64)[..., :3].mean()
    scene.render.engine = "MRPNN"
    return cycles, blender_scenes.rendered(scene, folder)[..., :3].mean()


@pytest.fixture
def thin_box(scene):
    """A mesh of 1 x 1 x 2 with fog of density 0.1, all of the picture."""
    bpy.ops.mesh.primitive_cube_add(size=1.0)
    shape = bpy.context.object.data
    for vertex in shape.vertices:
        vertex.co.z *= 2.0
    blender_scenes.add_fog(shape, "Box", "ShaderNodeVolumePrincipled", Density=0.1, Color=(1.0, 1.0, 1.0, 1.0))
    blender_scenes.add_camera(scene, ortho_scale=0.9)
    scene.render.resolution_x = scene.render.resolution_y = 8
    return shape


def test_fog_between_flat_and_smooth_faces(addon, scene, thin_box, tmp_path):
    """Half of what the sun lights sends it in through the ends, which are flat, and all of it has left by the walls."""
    blender_scenes.add_sun(scene, rotation=(0.0, 1.2, 0.0))
    flat_cycles, flat = mean_light(scene, tmp_path)
    thin_box.polygons.foreach_set("use_smooth", [abs(face.normal.z) < 0.5 for face in thin_box.polygons])
    thin_box.update()
    cycles, found = mean_light(scene, tmp_path)
    # Scattered evenly along 2 units of density 0.1, and a tenth weaker since the fog dims it on its way in and out.
    expected = 0.9 * 0.2 / (4.0 * np.pi)
    assert flat_cycles == pytest.approx(expected, rel=0.1) and flat == pytest.approx(expected, rel=0.1)
    assert found == pytest.approx(flat, rel=1e-3)
    if bpy.app.version < (5, 0, 0):
        assert cycles < 0.7 * expected


def test_a_sheared_area_light(addon, scene, thin_box, tmp_path):
    """From far away it sends its power / pi along its normal, whatever its shape is."""
    lamp = bpy.data.lights.new("Lamp", "AREA")
    lamp.energy, lamp.size = 1000.0, 0.5
    shown, parent = blender_scenes.add_object(scene, "Lamp", lamp), blender_scenes.add_object(scene, "Parent", None)
    shown.location, shown.rotation_euler, shown.parent = (0.0, 0.0, 8.0), (0.0, 0.0, 0.7), parent
    even_cycles, even = mean_light(scene, tmp_path)
    parent.scale.x = 3.0
    cycles, found = mean_light(scene, tmp_path)
    assert even == pytest.approx(even_cycles, rel=0.05)
    assert found == pytest.approx(even, rel=0.05)
    assert cycles > 2.0 * even
