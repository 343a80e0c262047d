# SPDX-License-Identifier: GPL-3.0-or-later
"""What grids hold besides active positive floats on common voxels, against Cycles' renders of the same files."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from mathutils import Matrix

from inference import SceneError, Settings, render
from tests.support import blender_scenes

CELLS = 8
BLACK = {"Color": (0.0, 0.0, 0.0, 1.0)}


def uneven(cells=CELLS, seed=0):
    """Values around 1, which no tile can hold."""
    return np.random.default_rng(seed).uniform(0.8, 1.2, (cells,) * 3).astype(np.float32)


def grid_of(values, name="density", transform=None, low=(0, 0, 0), background=0.0, kind="FloatGrid"):
    vdb = blender_scenes.openvdb()
    grid = getattr(vdb, kind)(background) if background else getattr(vdb, kind)()
    grid.copyFromArray(np.ascontiguousarray(values), ijk=low)
    grid.name = name
    matrix = blender_scenes.centred(CELLS, 2.0) if transform is None else transform
    grid.transform = vdb.createLinearTransform(np.asarray(matrix, float).T.tolist())
    return grid


def write(folder, *grids):
    path = folder / f"grids{len(list(folder.glob('grids*.vdb')))}.vdb"
    blender_scenes.openvdb().write(str(path), grids=list(grids))
    return path


def show(scene, path, **inputs):
    """A volume seen by a camera of 24 x 24 pixels from aslant; gives its shader."""
    cloud, node = blender_scenes.add_volume(scene, path, **{"Density": 1.5, **BLACK, **inputs})
    blender_scenes.add_sun(scene)
    camera = blender_scenes.add_camera(scene, ortho_scale=4.5)
    camera.matrix_world = Matrix.Rotation(0.3, 4, "Y") @ Matrix.Rotation(-0.2, 4, "X") @ Matrix.Translation((0, 0, 8))
    scene.render.resolution_x = scene.render.resolution_y = 24
    return node


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


def pictures(addon, scene, folder, samples=32):
    """(this engine's layer, Cycles' picture)."""
    described = read(addon)
    layer = render(described.volumes, described.suns, described.camera, Settings(depth_samples=1))
    return layer, blender_scenes.render_cycles(scene, folder, samples=samples)


def assert_alike(addon, scene, folder, rmse=0.03, bias=0.02):
    layer, seen = pictures(addon, scene, folder)
    assert seen[..., 3].mean() > 0.03
    assert np.sqrt(((layer.alpha - seen[..., 3]) ** 2).mean()) < rmse
    assert layer.alpha.mean() == pytest.approx(seen[..., 3].mean(), rel=bias)


def turn_off(grid, low, high, value):
    accessor = grid.getAccessor()
    for index in np.ndindex(*np.subtract(high, low)):
        accessor.setValueOff(tuple(np.add(low, index).tolist()), value)


def inside(grid):
    turn_off(grid, (3, 0, 0), (6, 8, 8), 0.7)


def a_leaf_beside(grid):
    turn_off(grid, (-8, 0, 0), (0, 8, 8), 0.7)


def a_leaf_beside_inactive_voxels(grid):
    turn_off(grid, (-8, 0, 0), (2, 8, 8), 0.7)


def a_tile_beside(grid):
    grid.fill((8, 0, 0), (15, 7, 7), 0.7, False)


def a_leaf_that_touches_none(grid):
    turn_off(grid, (10, 0, 0), (14, 8, 8), 0.7)


@pytest.mark.parametrize(
    "change", [inside, a_leaf_beside, a_leaf_beside_inactive_voxels, a_tile_beside, a_leaf_that_touches_none]
)
def test_voxels_that_are_not_active_are_shown_where_cycles_shows_them(addon, scene, tmp_path, change):
    grid = grid_of(uneven())
    change(grid)
    show(scene, write(tmp_path, grid))
    scene.camera.data.ortho_scale = 7.0
    # Cycles cuts off the half voxel over which the outermost voxels fade.
    assert_alike(addon, scene, tmp_path, rmse=0.04, bias=0.05)


def doubled_minus(node, operation, value):
    tree = node.id_data
    attribute, change = tree.nodes.new("ShaderNodeAttribute"), tree.nodes.new("ShaderNodeMath")
    attribute.attribute_name = "density"
    change.operation, change.inputs[1].default_value = operation, value
    tree.links.new(attribute.outputs["Fac"], change.inputs[0])
    tree.links.new(change.outputs[0], node.inputs["Density"])
    node.inputs["Density Attribute"].default_value = ""


@pytest.mark.parametrize("operation, value", [(None, 0.0), ("MULTIPLY", -2.0), ("ABSOLUTE", 0.0)])
def test_negative_voxels_are_interpolated_as_in_cycles(addon, scene, tmp_path, operation, value):
    values = uneven()
    values[1:5, 2:6, 2:7] *= -1.0
    node = show(scene, write(tmp_path, grid_of(values)))
    if operation:
        doubled_minus(node, operation, value)
    assert_alike(addon, scene, tmp_path, bias=0.05)


def test_a_negative_background_is_no_fog(addon, scene, tmp_path):
    show(scene, write(tmp_path, grid_of(uneven(), background=-1.0)))
    assert_alike(addon, scene, tmp_path)


@pytest.mark.parametrize("kind", ["BoolGrid", "Int32Grid", "Int64Grid", "DoubleGrid", "Vec3IGrid"])
def test_grids_of_other_numbers_are_read(addon, scene, tmp_path, kind):
    """Of vectors, the mean."""
    values = np.random.default_rng(1).integers(0, 2, (CELLS,) * 3)
    grid = getattr(blender_scenes.openvdb(), kind)()
    accessor = grid.getAccessor()
    for index in np.argwhere(values).tolist():
        accessor.setValueOn(tuple(index), (1, 2, 0) if "Vec" in kind else True if kind == "BoolGrid" else 1)
    plain = grid_of(values)
    grid.name, grid.transform = "density", plain.transform
    show(scene, write(tmp_path, grid))
    ((volume, _),) = read(addon).volumes
    low, high = np.argwhere(values).min(axis=0), np.argwhere(values).max(axis=0) + 1
    np.testing.assert_allclose(volume.density, values[tuple(map(slice, low, high))])


def test_masks_points_and_unnamed_grids_are_no_density(addon, scene, tmp_path):
    vdb = blender_scenes.openvdb()
    unnamed = grid_of(uneven(), name="")
    points, mask = vdb.PointDataGrid(), vdb.BoolGrid()
    points.name = "points"
    mask.fill((0, 0, 0), (7, 7, 7), True)
    mask.name = "mask"
    path = write(tmp_path, unnamed, points, mask, grid_of(uneven(), name="smoke"))
    # OpenVDB's module makes no masks. A tile of one is stored as that of a Boolean grid.
    path.write_bytes(path.read_bytes().replace(b"Tree_bool_5_4_3", b"Tree_mask_5_4_3"))
    node = show(scene, path)
    for name in ("density", "mask", "points"):
        node.inputs["Density Attribute"].default_value = name
        described = read(addon)
        assert not described.volumes and f'"{name}", which is not among its grids of numbers ("smoke")' in str(
            described.empty
        )
        assert not blender_scenes.render_cycles(scene, tmp_path, samples=4).any()
    node.inputs["Density Attribute"].default_value = "smoke"
    assert_alike(addon, scene, tmp_path)


def missing_factor(node):
    doubled_minus(node, "ADD", 0.7)
    attribute = node.id_data.nodes["Attribute"]
    attribute.attribute_name = "absent"
    node.inputs["Density Attribute"].default_value = "density"


def missing_colour(node):
    node.inputs["Color Attribute"].default_value = "absent"


def missing_flame(node):
    node.inputs["Emission Strength"].default_value = 0.0
    node.inputs["Emission Color"].default_value = (1.0, 0.5, 0.2, 1.0)
    info = node.id_data.nodes.new("ShaderNodeVolumeInfo")
    node.id_data.links.new(info.outputs["Flame"], node.inputs["Emission Strength"])


@pytest.mark.parametrize(
    "change, name", [(missing_factor, "absent"), (missing_colour, "absent"), (missing_flame, "flame")]
)
def test_a_grid_that_a_file_lacks_is_0_and_named(addon, scene, tmp_path, change, name):
    node = show(scene, write(tmp_path, grid_of(uneven())))
    change(node)
    (said,) = [warning for warning in read(addon).warnings if name in warning]
    assert f'"{name}", which is not among its grids of numbers ("density")' in said and '"Cloud"' in said
    layer, seen = pictures(addon, scene, tmp_path)
    assert layer.alpha.mean() == pytest.approx(seen[..., 3].mean(), rel=0.01)
    assert seen[..., :3].max() < 1e-3 and not any(volume.emission is not None for volume, _ in read(addon).volumes)


def test_a_density_that_a_file_lacks_beside_a_grid_that_is_read_is_named(addon, scene, tmp_path):
    """Cycles fills boxes around the other grid, which nobody wants."""
    node = show(scene, write(tmp_path, grid_of(uneven(), "flame")))
    attribute = node.id_data.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "flame"
    node.id_data.links.new(attribute.outputs["Fac"], node.inputs["Emission Strength"])
    (said,) = read(addon).warnings
    assert 'reads "density"' in said and "Cycles fills boxes" in said and "as in Cycles" not in said
    layer, seen = pictures(addon, scene, tmp_path)
    assert not layer.alpha.any() and layer.rgb.max() > 0.1 and seen[..., 3].max() > 0.5


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_voxels_that_are_no_numbers_are_told_wherever_they_are(addon, scene, tmp_path, value):
    def some(name="density", count=1, background=0.0):
        # One by one: arrays lose voxels that are no numbers, or all of them beside such a background.
        grid = grid_of(uneven(), name, background=background)
        accessor = grid.getAccessor()
        for number, (index, usual) in enumerate(np.ndenumerate(uneven())):
            accessor.setValueOn(index, float(value) if number < count else float(usual))
        return grid

    everything = CELLS**3
    node = show(scene, write(tmp_path, grid_of(uneven())))
    volume = scene.objects["Cloud"].data

    def told(*grids):
        volume.filepath = str(write(tmp_path, *grids))
        return read(addon).warnings

    (said,) = told(some())
    assert '"Cloud"' in said and "1 NaN or infinite voxels" in said
    said = told(some(count=0, background=float(value)))
    assert any('"density" has a background that is NaN or infinite' in text for text in said)
    with pytest.raises(SceneError, match="all its voxels are 0, NaN or infinite"):
        told(some(count=everything))
    # The same file a second time, as for another object.
    with pytest.raises(SceneError, match="all its voxels are 0, NaN or infinite"):
        read(addon)
    attribute = node.id_data.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "flame"
    node.id_data.links.new(attribute.outputs["Fac"], node.inputs["Emission Strength"])
    (said,) = told(grid_of(uneven()), some("flame", count=everything))
    assert 'grid "flame" is empty (all its voxels are 0, NaN or infinite)' in said


def turned(cells, size, angle=0.0, shift=0.0):
    matrix = blender_scenes.centred(cells, size)
    matrix[:3, 3] += shift
    return np.array(Matrix.Rotation(angle, 4, (1.0, 2.0, 3.0))) @ matrix


OTHER_VOXELS = {
    "coarser": (5, turned(5, 2.0)),
    "finer": (15, turned(15, 2.0)),
    "shifted": (8, turned(8, 2.0, shift=0.11)),
    "turned": (9, turned(9, 2.0, angle=0.7)),
    "far beyond": (8, turned(8, 4.5)),
}


def two_grids(scene, tmp_path, kind):
    """A density times another grid on other voxels."""
    cells, transform = OTHER_VOXELS[kind]
    smooth = blender_scenes.blob(cells, seed=4) + np.float32(0.2)
    path = write(tmp_path, grid_of(blender_scenes.blob(CELLS) + 0.5), grid_of(smooth, "heat", transform))
    node = show(scene, path, Density=4.0)
    tree = node.id_data
    attribute = tree.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "heat"
    scaled = tree.nodes.new("ShaderNodeMath")
    scaled.operation, scaled.inputs[1].default_value = "MULTIPLY", 4.0
    tree.links.new(attribute.outputs["Fac"], scaled.inputs[0])
    tree.links.new(scaled.outputs[0], node.inputs["Density"])


@pytest.mark.parametrize("kind", OTHER_VOXELS)
def test_grids_on_other_voxels_are_sampled_as_in_cycles(addon, scene, tmp_path, kind):
    two_grids(scene, tmp_path, kind)
    assert_alike(addon, scene, tmp_path)


def test_temperatures_half_a_voxel_beside_the_density_glow_as_in_cycles(addon, scene, tmp_path):
    """Between them, the mean of eight uneven ones, it would glow less."""
    hot = 2000.0 * uneven(seed=1)
    heat = grid_of(hot.astype(np.float32), "temperature", turned(CELLS, 2.0, shift=1.0 / CELLS))
    show(scene, write(tmp_path, grid_of(uneven()), heat), Blackbody_Intensity=1.0)
    layer, seen = pictures(addon, scene, tmp_path)
    assert seen[..., 0].mean() > 0.1
    bright = layer.rgb.mean(axis=(0, 1)) / seen[..., :3].mean(axis=(0, 1))
    np.testing.assert_allclose(bright[0], 1.0, atol=0.1)


def test_a_grid_too_fine_for_the_memory_is_named(addon, scene, tmp_path, monkeypatch):
    """Here of a light that no density needs."""
    heat = grid_of(blender_scenes.blob(15) + 0.2, "heat", turned(15, 2.0))
    node = show(scene, write(tmp_path, grid_of(uneven()), heat))
    attribute = node.id_data.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "heat"
    node.id_data.links.new(attribute.outputs["Fac"], node.inputs["Emission Strength"])
    assert read(addon).warnings == []
    monkeypatch.setattr(addon.mrpnn_addon.volumes.common_voxels, "DENSE_SPAN", 1000)
    node.inputs["Density"].default_value = 1.4
    node.id_data.update_tag()
    (said,) = [warning for warning in read(addon).warnings if "heat" in warning]
    assert '"heat" has smaller voxels than grid "density"' in said


@pytest.mark.parametrize("kind", ["finer", "shifted", "turned"])
def test_blocks_on_other_voxels_hold_what_arrays_hold(addon, scene, tmp_path, monkeypatch, kind):
    two_grids(scene, tmp_path, kind)
    monkeypatch.setattr(addon.mrpnn_addon.volumes.source, "MAX_REFINED", 0)
    ((dense, medium),) = read(addon).volumes
    module = addon.mrpnn_addon.vdb.density_grid
    module._in_use.clear()
    monkeypatch.setattr(module, "DENSE_SPAN", 0)
    monkeypatch.setattr(module, "DENSE_SHARE", 1.1)
    ((sparse, same),) = read(addon).volumes
    assert hasattr(sparse.density, "dense")
    found = sparse.density.dense()
    np.testing.assert_array_equal(same.sigma_t, medium.sigma_t)
    offset = np.linalg.inv(sparse.world_from_index) @ dense.world_from_index
    low = np.round(offset[:3, 3]).astype(int)
    placed = np.zeros(np.maximum(found.shape, low + dense.density.shape), np.float32)
    placed[tuple(slice(o, o + n) for o, n in zip(low, dense.density.shape))] = dense.density
    np.testing.assert_allclose(
        np.pad(found, [(0, a - b) for a, b in zip(placed.shape, found.shape)]), placed, atol=1e-5
    )


def test_a_background_of_a_temperature_is_no_fog(addon, scene, tmp_path):
    """Density is 0 outside: only what density multiplies is seen."""
    path = write(tmp_path, grid_of(uneven()), grid_of(uneven(4, 1), "heat", low=(2, 2, 2), background=0.5))
    node = show(scene, path)
    attribute = node.id_data.nodes.new("ShaderNodeAttribute")
    attribute.attribute_name = "heat"
    node.id_data.links.new(attribute.outputs["Fac"], node.inputs["Density"])
    assert_alike(addon, scene, tmp_path)
    node.inputs["Density Attribute"].default_value = ""
    with pytest.raises(SceneError, match='"heat" has background 0.5'):
        read(addon)
