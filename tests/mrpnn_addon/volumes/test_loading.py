# SPDX-License-Identifier: GPL-3.0-or-later
"""Volumes read on a thread, ahead of the scene."""

import threading
import time
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes


@pytest.fixture
def reader(addon):
    return addon.mrpnn_addon.volumes.reader.VolumeReader()


@pytest.fixture
def loading(addon, reader):
    """Starts to read the scene's volumes."""
    return lambda: addon.mrpnn_addon.volumes.loading.VolumeLoading(reader, reader.wanted(blender_scenes.depsgraph()))


@pytest.fixture
def cloud(scene, tmp_path):
    return blender_scenes.cloud_scene(scene, tmp_path)


def finished(found):
    found.wait(60)
    assert found.done
    return found


def noisy(scene, cloud):
    """A cube of fog beside the cloud, shaped by a noise that is slow at 128^3 voxels."""
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(3.0, 0.0, 0.0))
    fog = bpy.context.object
    principled = blender_scenes.add_fog(fog.data, "Fog", "ShaderNodeVolumePrincipled")
    tree = principled.id_data
    noise = tree.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Detail"].default_value = 3.0
    tree.links.new(noise.outputs[0], principled.inputs["Density"])
    return fog, noise


@pytest.mark.slow
def test_a_thread_reads_what_the_scene_reads_itself(addon, scene, cloud, reader, loading):
    """Files, textured meshes and instances; nothing is left to read on the main thread."""
    noisy(scene, cloud)
    twin = bpy.data.objects.new("Twin", cloud.data)
    twin.location.x = -3.0
    scene.collection.objects.link(twin)
    read_scene = addon.mrpnn_addon.scene.reader.read_scene
    expected = read_scene(blender_scenes.depsgraph())
    found = finished(loading())
    assert found.error is None and found.fraction == 1.0 and len(found.sources) == 2
    assert reader.wanted(blender_scenes.depsgraph()) == []
    start = time.thread_time()
    described = read_scene(blender_scenes.depsgraph(), reader)
    assert time.thread_time() - start < 0.2
    assert described.warnings == expected.warnings and len(described.volumes) == 3
    for (volume, medium), (own, own_medium) in zip(described.volumes, expected.volumes):
        np.testing.assert_array_equal(volume.density, own.density)
        np.testing.assert_array_equal(volume.world_from_index, own.world_from_index)
        np.testing.assert_array_equal(medium.sigma_t, own_medium.sigma_t)


@pytest.mark.slow
def test_blenders_main_thread_is_free_while_volumes_are_shaded(scene, cloud, reader, loading):
    """At most 0.2 processor seconds for reading the scene; the shader takes seconds."""
    fog, _ = noisy(scene, cloud)
    # Evaluate the scene before the clock starts.
    blender_scenes.depsgraph()
    start = time.thread_time()
    found = loading()
    assert time.thread_time() - start < 0.2
    # Nodes were copied: later edits do not reach them.
    fog.data.materials[0].node_tree.nodes.clear()
    finished(found)
    assert found.error is None
    (volume,) = [grid.density for grid, *_ in found.reader.known.values() if grid.density.shape == (128,) * 3]
    assert volume.std() > 0.1 * volume.mean() > 0.0


def test_a_file_in_use_is_not_read_again_until_it_changes(addon, scene, cloud, reader, loading):
    first = finished(loading())
    again = addon.mrpnn_addon.volumes.reader.VolumeReader()
    (source,) = again.wanted(blender_scenes.depsgraph())
    ((known, *_),) = first.reader.known.values()
    assert np.shares_memory(source.read()[0].density, known.density) and known.density.max() > 0.0
    # Rewritten, it is another file.
    time.sleep(0.01)
    Path(source.path).write_bytes(Path(source.path).read_bytes())
    assert not np.shares_memory(source.read()[0].density, known.density)


def test_unreadable_volumes_are_reported_beside_readable_ones(addon, scene, cloud, reader, loading):
    blender_scenes.add_volume(scene, cloud.data.filepath, name="Odd one", Density_Attribute="temperature")
    found = finished(loading())
    assert found.error is None and reader.wanted(blender_scenes.depsgraph()) == []
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph(), reader)
    assert [volume.name for volume, _ in described.volumes] == ["Cloud"]
    (problem,) = described.empty
    assert 'volume "Odd one" is empty' in problem and '"temperature"' in problem


@pytest.mark.parametrize("kind", ["file", "mesh"])
def test_reading_can_be_cancelled_at_once(scene, cloud, tmp_path, loading, kind):
    """Within a second of processor time: in a large file, and in the middle of a mesh's shader."""
    if kind == "file":
        vdb = blender_scenes.openvdb()
        # Takes over a second to read, so that it is cancelled in the middle.
        noise, grid = np.random.default_rng(0).random((250,) * 3, np.float32), vdb.FloatGrid()
        for low in ((0, 0, 0), (500, 500, 500)):
            grid.copyFromArray(noise, ijk=low)
        grid.name, path = "density", str(tmp_path / "large.vdb")
        vdb.write(path, grids=[grid])
        cloud.data.filepath = path
    else:
        noisy(scene, cloud)
    found = loading()
    time.sleep(0.2)
    start = time.process_time()
    found.stop()
    finished(found)
    assert found.cancelled and time.process_time() - start < 1.0
    assert not [thread for thread in threading.enumerate() if thread.name == "mrpnn reading"]
