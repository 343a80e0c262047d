# SPDX-License-Identifier: GPL-3.0-or-later
"""The cases of docs/trust/scenes.md in which Cycles departs from the absorption law and this engine does not."""

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
