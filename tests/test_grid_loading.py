"""Volume files read on a thread before the scene is."""

import time
from pathlib import Path

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from . import blender_scenes


@pytest.fixture
def loading(addon):
    return addon.mrpnn_addon.grid_loading.GridLoading


@pytest.fixture
def wanted(addon):
    """The grids that a new reader would have to read."""
    return lambda: addon.mrpnn_addon.volumes.VolumeReader().wanted(blender_scenes.depsgraph())


@pytest.fixture
def cloud(scene, tmp_path):
    return blender_scenes.cloud_scene(scene, tmp_path)


def finished(found):
    found.wait(60)
    assert found.done
    return found


def test_a_loaded_grid_is_read_no_more_while_it_is_in_use(addon, loading, wanted, cloud):
    (one,) = wanted()
    assert (one.grid, one.owner) == ("density", cloud.name)
    found = finished(loading([one]))
    assert found.error is None and found.fraction == 1.0 and wanted() == []
    volume, _ = addon.mrpnn_addon.scene.read_scene(blender_scenes.depsgraph()).volumes[0]
    expected = addon.mrpnn_addon.density_grid.read_density_grid(one.path, one.grid, one.owner).density
    assert np.shares_memory(volume.density, expected) and expected.max() > 0.0
    # Nobody holds it any more.
    del found, volume, expected
    assert wanted() == [one]


def test_a_file_that_has_changed_is_read_anew(addon, loading, wanted, cloud):
    found = finished(loading(wanted()))
    (path,) = {one.path for one in found.wanted}
    content = Path(path).read_bytes()
    time.sleep(0.01)
    Path(path).write_bytes(content)
    assert wanted() == found.wanted


def test_what_cannot_be_read_is_its_error(addon, loading, cloud):
    missing = addon.mrpnn_addon.grid_loading.Wanted("/nowhere/at all.vdb", "density", "Cloud")
    found = finished(loading([missing]))
    assert isinstance(found.error, addon.inference.SceneError) and "\"Cloud\": file not found" in str(found.error)


def test_a_stopped_reading_ends_at_once(addon, loading, tmp_path):
    """Of a file that takes longer: noise in two hundred million voxels' box."""
    vdb = blender_scenes.openvdb()
    grid = vdb.FloatGrid()
    for low in ((0, 0, 0), (500, 500, 500)):
        grid.copyFromArray(np.random.default_rng(0).random((100,) * 3, np.float32), ijk=low)
    grid.name, path = "density", str(tmp_path / "large.vdb")
    vdb.write(path, grids=[grid])
    found = loading([addon.mrpnn_addon.grid_loading.Wanted(path, "density", "Cloud")])
    time.sleep(0.2)
    start = time.monotonic()
    found.stop()
    finished(found)
    assert found.cancelled and time.monotonic() - start < 1.0
