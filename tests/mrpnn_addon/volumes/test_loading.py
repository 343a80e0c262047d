"""Volumes read on a thread before the scene is."""

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
    """Begins to read what the scene's volumes are read from."""
    return lambda: addon.mrpnn_addon.volumes.loading.VolumeLoading(reader, reader.wanted(blender_scenes.depsgraph()))


@pytest.fixture
def cloud(scene, tmp_path):
    return blender_scenes.cloud_scene(scene, tmp_path)


def finished(found):
    found.wait(60)
    assert found.done
    return found


def noisy(scene, cloud):
    """A cube of fog beside the cloud, shaped by a noise that takes its time at 128^3 voxels."""
    bpy.ops.mesh.primitive_cube_add(size=1.0, location=(3.0, 0.0, 0.0))
    fog = bpy.context.object
    principled = blender_scenes.add_fog(fog.data, "Fog", "ShaderNodeVolumePrincipled")
    tree = principled.id_data
    noise = tree.nodes.new("ShaderNodeTexNoise")
    noise.inputs["Detail"].default_value = 3.0
    tree.links.new(noise.outputs[0], principled.inputs["Density"])
    return fog, noise


def test_what_a_thread_has_read_is_what_the_scene_reads_itself(addon, scene, cloud, reader, loading):
    """Files, meshes with textures and instances alike; nothing is left to be read on the main thread."""
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


def test_blender_s_main_thread_is_free_while_volumes_are_shaded(scene, cloud, reader, loading):
    """0.2 processor seconds at most from looking at the scene to having read it; the shader takes seconds."""
    fog, _ = noisy(scene, cloud)
    depsgraph = blender_scenes.depsgraph()
    start = time.thread_time()
    found = loading()
    assert time.thread_time() - start < 0.2
    # Nodes were copied: what happens to them now is another scene's.
    fog.data.materials[0].node_tree.nodes.clear()
    finished(found)
    assert found.error is None
    (volume,) = [grid.density for grid, *_ in found.reader.known.values() if grid.density.shape == (128,) * 3]
    assert volume.std() > 0.1 * volume.mean() > 0.0


def test_a_loaded_file_is_read_no_more_while_it_is_in_use_and_the_same(addon, scene, cloud, reader, loading):
    first = finished(loading())
    again = addon.mrpnn_addon.volumes.reader.VolumeReader()
    (source,) = again.wanted(blender_scenes.depsgraph())
    ((known, *_),) = first.reader.known.values()
    assert np.shares_memory(source.read()[0].density, known.density) and known.density.max() > 0.0
    # Written again, it is another.
    time.sleep(0.01)
    Path(source.path).write_bytes(Path(source.path).read_bytes())
    assert not np.shares_memory(source.read()[0].density, known.density)


def test_what_cannot_be_read_is_known_to_the_reader_beside_what_can(addon, scene, cloud, reader, loading):
    blender_scenes.add_volume(scene, cloud.data.filepath, name="Odd one", Density_Attribute="temperature")
    found = finished(loading())
    assert found.error is None and reader.wanted(blender_scenes.depsgraph()) == []
    described = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph(), reader)
    assert [volume.name for volume, _ in described.volumes] == ["Cloud"]
    (problem,) = described.refused
    assert "\"Odd one\": " in problem


@pytest.mark.parametrize("kind", ["file", "mesh"])
def test_a_stopped_reading_ends_at_once(scene, cloud, tmp_path, loading, kind):
    """Within a second of this process's work: of a large file, and in the middle of a mesh's shader."""
    if kind == "file":
        vdb = blender_scenes.openvdb()
        grid = vdb.FloatGrid()
        for low in ((0, 0, 0), (500, 500, 500)):
            grid.copyFromArray(np.random.default_rng(0).random((100,) * 3, np.float32), ijk=low)
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
