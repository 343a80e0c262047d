# SPDX-License-Identifier: GPL-3.0-or-later
"""Volume files read block by block, against OpenVDB's dense copies and dense renders."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import SceneError
from tests.support import blender_scenes


@pytest.fixture
def density_grid(addon):
    return addon.mrpnn_addon.vdb.density_grid


@pytest.fixture
def everything_sparse(density_grid, monkeypatch):
    """Grids of any size are kept in blocks."""
    monkeypatch.setattr(density_grid, "DENSE_SPAN", 0)
    monkeypatch.setattr(density_grid, "DENSE_SHARE", 1.1)


def uneven_grid():
    """Noise, tiles of one value from 8 to 128 voxels, negative places, and an inactive value that Cycles hides."""
    grid = blender_scenes.openvdb().FloatGrid()
    random = np.random.default_rng(0)
    grid.copyFromArray(random.random((31, 17, 45), np.float32), ijk=(-20, 5, 130))
    grid.fill((-128, -128, 0), (-1, -1, 127), 0.7)
    grid.fill((40, 8, 16), (47, 31, 39), 0.3)
    grid.fill((200, 100, -90), (203, 180, -80), 2.0)
    accessor = grid.getAccessor()
    accessor.setValueOff((0, 0, 0), 0.9)
    accessor.setValueOn((2, 1, 3), 0.0)
    grid.prune()
    return grid


def write(grid, path, name="density"):
    grid.name = name
    blender_scenes.openvdb().write(str(path), grids=[grid])
    return str(path)


def copied(grid):
    """All voxels in the active box, and its lowest index."""
    low, high = grid.evalActiveVoxelBoundingBox()
    values = np.empty([b - a + 1 for a, b in zip(low, high)], np.float32)
    grid.copyToArray(values, ijk=low)
    if (value := grid.getConstAccessor().getValue((0, 0, 0))) and not grid.getConstAccessor().isValueOn((0, 0, 0)):
        assert value == values[tuple(-n for n in low)]
        values[tuple(-n for n in low)] = 0.0
    return values, np.array(low)


def test_blocks_equal_openvdbs_dense_copy(density_grid, everything_sparse, tmp_path):
    grid = uneven_grid()
    found = density_grid.read_density_grid(write(grid, tmp_path / "uneven.vdb"), "density", "Cloud")
    expected, low = copied(grid)
    assert found.density.values.size < 0.5 * expected.size
    np.testing.assert_array_equal(found.density.dense(), expected)
    np.testing.assert_array_equal(found.low, low)


def test_arrays_equal_openvdbs_dense_copy(density_grid, monkeypatch, tmp_path):
    monkeypatch.setattr(density_grid, "DENSE_SPAN", 1 << 30)
    grid = uneven_grid()
    found = density_grid.read_density_grid(write(grid, tmp_path / "whole.vdb"), "density", "Cloud")
    np.testing.assert_array_equal(found.density, copied(grid)[0])


def test_real_files_equal_openvdbs_dense_copy(density_grid, everything_sparse, real_volumes):
    names = {"openvdb_smoke.vdb": "density", "blender_smoke_wind.vdb": "density", "torus_max100.vdb": None}
    for name, grid_name in names.items():
        path = str(real_volumes / name)
        grid_name = grid_name or blender_scenes.openvdb().readAllGridMetadata(path)[0].name
        found = density_grid.read_density_grid(path, grid_name, "Cloud")
        expected, _ = copied(blender_scenes.openvdb().read(path, grid_name))
        np.testing.assert_array_equal(found.density.dense(), expected)


def test_nan_voxels_become_0_in_blocks_and_negative_ones_stay(density_grid, everything_sparse, tmp_path):
    grid = blender_scenes.openvdb().FloatGrid()
    values = np.ones((20, 20, 20), np.float32)
    grid.copyFromArray(values)
    grid.getAccessor().setValueOn((3, 4, 5), -1.0)
    grid.getAccessor().setValueOn((10, 11, 12), np.nan)
    found = density_grid.read_density_grid(write(grid, tmp_path / "wrong.vdb"), "density", "Cloud")
    values[3, 4, 5], values[10, 11, 12] = -1.0, 0.0
    np.testing.assert_array_equal(found.density.dense(), values)
    assert "1 negative" in found.warnings[0] and "1 NaN" in found.warnings[0]


def test_too_many_voxels_are_refused(addon, density_grid, everything_sparse, monkeypatch, tmp_path):
    path = write(uneven_grid(), tmp_path / "many.vdb")
    monkeypatch.setattr(density_grid, "MAX_VOXELS", 1 << 20)
    with pytest.raises(SceneError, match="holds more than the 1048576 voxels"):
        density_grid.read_density_grid(path, "density", "Cloud")


# Materials


@pytest.fixture(scope="module")
def fire(tmp_path_factory):
    """Density, a flame beside it, and a temperature of another extent."""
    vdb, grids = blender_scenes.openvdb(), []
    blob = blender_scenes.blob(20)
    for name, values, low in (
        ("density", blob, (3, 5, -7)),
        ("flame", blob, (30, 5, -7)),
        ("heat", blob[:9], (0, 2, -3)),
    ):
        grid = vdb.FloatGrid()
        grid.copyFromArray(np.ascontiguousarray(values, np.float32), ijk=low)
        grid.name, grid.gridClass = name, "fog volume"
        grids.append(grid)
    path = tmp_path_factory.mktemp("fire") / "fire.vdb"
    vdb.write(str(path), grids=grids)
    return path


def linked(shader, kind, output, socket, **values):
    node = shader.id_data.nodes.new(kind)
    for name, value in values.items():
        setattr(node, name, value)
    shader.id_data.links.new(node.outputs[output], shader.inputs[socket])
    return node


def plain(shader):
    pass


def two_grids(shader):
    product = linked(shader, "ShaderNodeMath", 0, "Density", operation="MULTIPLY_ADD")
    for socket, name in enumerate(("density", "flame", "heat")):
        attribute = shader.id_data.nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = name
        shader.id_data.links.new(attribute.outputs["Fac"], product.inputs[socket])


def of_places(shader):
    texture = linked(shader, "ShaderNodeTexGradient", "Color", "Emission Color")
    coordinates = shader.id_data.nodes.new("ShaderNodeTexCoord")
    shader.id_data.links.new(coordinates.outputs["Object"], texture.inputs[0])
    linked(shader, "ShaderNodeAttribute", "Fac", "Emission Strength", attribute_name="flame")


@pytest.mark.parametrize("material", [plain, two_grids, of_places])
def test_materials_read_the_same_voxels(addon, density_grid, scene, fire, monkeypatch, material):
    _, shader = blender_scenes.add_volume(scene, fire, Density=2.0)
    material(shader)
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene)
    # Shaders that are not linear in the grids are refined between an array's voxels; here only at the voxels.
    monkeypatch.setattr(addon.mrpnn_addon.volumes.source, "MAX_REFINED", 0)

    def read():
        density_grid._in_use.clear()
        (found,) = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph()).volumes
        return found

    expected, medium = read()
    monkeypatch.setattr(density_grid, "DENSE_SPAN", 0)
    monkeypatch.setattr(density_grid, "DENSE_SHARE", 1.1)
    found, same = read()
    assert not hasattr(expected.density, "dense") and expected.density.max() > 0.0
    np.testing.assert_array_equal(found.density.dense(), expected.density)
    np.testing.assert_allclose(found.world_from_index, expected.world_from_index)
    np.testing.assert_array_equal(same.sigma_t, medium.sigma_t)
    assert (expected.emission is None) == (material is not of_places)
    for channel, values in zip(found.emission_channels(), expected.emission_channels()):
        assert values.max() > 0.0
        np.testing.assert_array_equal(channel.dense(), values)


@pytest.mark.parametrize("sparse", [False, True])
def test_a_grid_of_vectors_is_a_colour(addon, density_grid, scene, monkeypatch, tmp_path, sparse):
    vdb, blob = blender_scenes.openvdb(), blender_scenes.blob(20).astype(np.float32)
    colour = np.random.default_rng(4).uniform(0.1, 0.9, (*blob.shape, 3)).astype(np.float32) * (blob > 0.0)[..., None]
    density, vectors = vdb.FloatGrid(), vdb.Vec3SGrid()
    density.copyFromArray(np.ascontiguousarray(blob), ijk=(3, 5, -7))
    vectors.copyFromArray(np.ascontiguousarray(colour), ijk=(3, 5, -7))
    density.name, density.gridClass, vectors.name = "density", "fog volume", "Cd"
    vdb.write(str(tmp_path / "dyed.vdb"), grids=[density, vectors])
    _, shader = blender_scenes.add_volume(scene, tmp_path / "dyed.vdb", Density=2.0)
    shader.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    shader.inputs["Color Attribute"].default_value = "Cd"
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene)
    monkeypatch.setattr(addon.mrpnn_addon.volumes.source, "MAX_REFINED", 0)
    if sparse:
        monkeypatch.setattr(density_grid, "DENSE_SPAN", 0)
        monkeypatch.setattr(density_grid, "DENSE_SHARE", 1.1)
    ((volume, medium),) = addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph()).volumes
    found = [volume.density, *medium.albedo]
    found = [grid.dense() if sparse else grid for grid in found]
    inside = found[0] > 0.0
    assert inside.any() and len(medium.albedo) == 3
    for c in range(3):
        np.testing.assert_allclose(found[1 + c][inside], colour[..., c][colour[..., c] > 0.0].reshape(-1), rtol=1e-5)
