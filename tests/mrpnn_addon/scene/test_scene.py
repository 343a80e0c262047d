# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene description read from Blender: volumes, transforms, suns, camera, and clear refusals."""

import importlib
import math
import shutil

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from bpy_extras.object_utils import world_to_camera_view
from mathutils import Euler, Matrix, Vector

from inference import SceneError, Settings, render
from inference.scene.camera_rays import camera_rays
from tests.support import blender_scenes


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


def refusal(addon) -> str:
    with pytest.raises(SceneError) as caught:
        read(addon)
    return str(caught.value)


def lit(scene):
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene)


def only_volume(addon):
    ((volume, _),) = read(addon).volumes
    return volume


# Volumes: placement


def voxel_in_image(scene, world):
    """Pixel coordinates (x, y), rows from the top, of a world position."""
    x, y, _ = world_to_camera_view(scene, scene.camera, Vector(world))
    return x * scene.render.resolution_x, (1.0 - y) * scene.render.resolution_y


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_a_voxel_is_where_cycles_draws_it(addon, scene, tmp_path, seed):
    """With a rotated, scaled and parented object and a rotated, anisotropic grid transform."""
    random = np.random.default_rng(seed)
    turn = np.array(Euler(random.uniform(-3, 3, 3)).to_matrix())
    transform = np.eye(4)
    transform[:3, :3] = turn @ np.diag(random.uniform(0.3, 0.8, 3))
    transform[:3, 3] = random.uniform(-1, 1, 3)
    density = np.zeros((4, 4, 4))
    density[2, 1, 2] = 1.0
    path = blender_scenes.write_vdb(tmp_path, density, transform, low=(-3, 2, -1))
    cloud, _ = blender_scenes.add_volume(scene, path, Density=2.0)
    cloud.rotation_euler, cloud.scale = random.uniform(-3, 3, 3), random.uniform(0.6, 1.6, 3)
    parent = blender_scenes.add_object(scene, "Parent", None)
    parent.rotation_euler, parent.location = random.uniform(-3, 3, 3), random.uniform(-1, 1, 3)
    cloud.parent = parent
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene, location=(0.0, 0.0, 50.0), ortho_scale=14.0)

    volume = only_volume(addon)
    index = np.argwhere(volume.density == 1.0)[0]
    expected = voxel_in_image(scene, (volume.world_from_index @ [*index, 1.0])[:3])
    alpha = blender_scenes.render_cycles(scene, tmp_path, samples=64)[..., 3].astype(float)
    depth = -np.log1p(-np.minimum(alpha, 0.999))
    rows, columns = np.mgrid[:64, :64] + 0.5
    found = (depth * columns).sum() / depth.sum(), (depth * rows).sum() / depth.sum()
    np.testing.assert_allclose(found, expected, atol=0.25)  # a pixel is half a voxel or less


def test_only_the_active_voxels_are_read(addon, scene, tmp_path):
    density = np.random.default_rng(0).uniform(0.5, 1.0, (3, 5, 4)).astype(np.float32)
    blender_scenes.add_volume(scene, blender_scenes.write_vdb(tmp_path, density, low=(100, -50, 7)))
    lit(scene)
    volume = only_volume(addon)
    np.testing.assert_array_equal(volume.density, density)
    half = 0.5 if bpy.app.version < (5, 0, 0) else 0.0
    np.testing.assert_allclose(volume.world_from_index[:3, 3], np.array((100, -50, 7)) + half)


def test_the_real_rotated_dragon(addon, scene, real_volumes):
    """Every active voxel of a grid with a rotated affine transform, at its position."""
    path = str(real_volumes / "dragon_rotated.vdb")
    cloud, _ = blender_scenes.add_volume(scene, path)
    cloud.matrix_world = Matrix.LocRotScale((1, 2, 3), Euler((0.3, 0.2, 0.1)), (2, 1, 0.5))
    lit(scene)
    volume = only_volume(addon)
    grid = blender_scenes.openvdb().read(path, "density")
    centre = 0.5 if bpy.app.version < (5, 0, 0) else 0.0
    picked = [item for number, item in enumerate(grid.iterOnValues()) if number % 20000 == 0 and item.count == 1]
    assert len(picked) > 3
    low = np.array(grid.evalActiveVoxelBoundingBox()[0])
    for item in picked:
        index = np.array(item.min)
        assert volume.density[tuple(index - low)] == np.float32(item.value)
        in_object = grid.transform.indexToWorld(tuple(float(i) + centre for i in index))
        expected = cloud.matrix_world @ Vector(in_object)
        np.testing.assert_allclose((volume.world_from_index @ [*(index - low), 1.0])[:3], expected, atol=1e-4)


def test_modifiers_are_applied(addon, scene, tmp_path):
    """A volume that exists in no file: Mesh to Volume."""
    cloud = blender_scenes.add_object(scene, "Made", bpy.data.volumes.new("Made"))
    mesh = bpy.data.meshes.new("Cube")
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    mesh.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    cube = blender_scenes.add_object(scene, "Cube", mesh)
    cube.hide_render = True
    modifier = cloud.modifiers.new("Fill", "MESH_TO_VOLUME")
    modifier.object, modifier.resolution_mode, modifier.voxel_size = cube, "VOXEL_SIZE", 0.1
    lit(scene)
    volume = only_volume(addon)
    size = np.linalg.norm(volume.world_from_index[:3, :3], axis=0) * volume.density.shape
    np.testing.assert_allclose(size, 2.0, atol=0.2)


def test_instances_are_volumes_of_their_own(addon, scene, tmp_path):
    cloud = blender_scenes.cloud_scene(scene, tmp_path)
    scene.collection.objects.unlink(cloud)
    group = bpy.data.collections.new("Group")
    group.objects.link(cloud)
    for x in (-2.0, 2.0):
        empty = blender_scenes.add_object(scene, f"At {x:g}", None)
        empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", group, (x, 0.0, 0.0)
    volumes = [volume for volume, _ in read(addon).volumes]
    assert [volume.name for volume in volumes] == ["Cloud in At -2", "Cloud in At 2"]
    np.testing.assert_allclose(
        volumes[1].world_from_index[:3, 3] - volumes[0].world_from_index[:3, 3], (4.0, 0.0, 0.0), atol=1e-6
    )
    # A reference needs what makes the instances.
    reference = importlib.import_module("mrpnn.mrpnn_addon.cycles.reference")
    shown = reference.volumes_and_lights(blender_scenes.depsgraph())
    assert {item.name for item in shown} == {"At -2", "At 2", "Sun"}


def test_approximations_where_volumes_overlap_are_named(addon, scene, tmp_path):
    cloud = blender_scenes.cloud_scene(scene, tmp_path)
    other = cloud.copy()
    scene.collection.objects.link(other)
    other.location.x = 1.5
    # The network sees them as one.
    assert not read(addon).warnings
    other.scale = (0.05, 0.05, 0.05)
    other.location.x = 0.0
    (warning,) = read(addon).warnings
    assert '"Cloud" and "Cloud.001" overlap' in warning and "as if each were alone" in warning
    other.location.x = 2.5
    assert not read(addon).warnings
    other.scale, other.location.x = (1.0, 1.0, 1.0), 1.5
    material = cloud.data.materials[0].copy()
    other.data = cloud.data.copy()
    other.data.materials[0] = material
    next(node for node in material.node_tree.nodes if "Anisotropy" in node.inputs).inputs[
        "Anisotropy"
    ].default_value = 0.9
    (warning,) = read(addon).warnings
    assert '"Cloud" and "Cloud.001" overlap' in warning and "mean Anisotropy" in warning


def test_a_sequence_reads_the_frames_file(addon, scene, tmp_path):
    for number in (1, 2):
        shutil.move(blender_scenes.write_vdb(tmp_path, np.ones((number, 3, 3))), tmp_path / f"fog_{number:03}.vdb")
    cloud, _ = blender_scenes.add_volume(scene, tmp_path / "fog_001.vdb")
    cloud.data.is_sequence, cloud.data.frame_start, cloud.data.frame_duration = True, 1, 2
    lit(scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    cloud.data.filepath = "//fog_001.vdb"
    for frame in (2, 1):
        scene.frame_set(frame)
        assert only_volume(addon).density.shape == (frame, 3, 3)
    blender_scenes.add_volume(scene, blender_scenes.write_vdb(tmp_path, np.ones((5, 5, 5))), name="Still")
    scene.frame_set(9)
    described = read(addon)
    assert [volume.name for volume, _ in described.volumes] == ["Still"]
    assert any("Cloud" in warning and "frame 9" in warning for warning in described.warnings)


# Volumes: odd files


@pytest.mark.parametrize(
    "file, grid, said",
    [
        ("odd/empty_grids_mat4_metadata.vdb", "density", "empty"),
        ("odd/eight_grids_four_empty.vdb", "flame", "empty"),
        ("odd/eight_grids_four_empty.vdb", "shadow", "empty"),
        ("odd/background_one.vdb", "density", "background 1"),
        ("odd/vector_grid_only.vdb", "Cd", "background 1"),
        ("odd/git_lfs_pointer.vdb", "density", "git lfs pull"),
        ("odd/damaged/truncated.vdb", "density", "cannot read"),
        ("odd/damaged/bad-bbox-huge.vdb", "huge", "empty"),
        ("odd/damaged/bad-bbox-bomb.vdb", "bomb", "empty"),
        ("odd/damaged/bad-bbox-inverted.vdb", "inverted", "empty"),
        ("odd/damaged/bad-bbox-overflow.vdb", "overflow", "empty"),
        ("odd/damaged/bad-bbox-roundup.vdb", "roundup", "empty"),
        ("odd/damaged/bad-bbox-empty.vdb", "empty", "empty"),
    ],
)
def test_odd_files_are_refused_by_object_and_reason(addon, scene, shared_volumes, file, grid, said):
    assert_refused(addon, scene, shared_volumes / file, grid, said)


@pytest.mark.parametrize(
    "file, grid, said",
    [
        ("icosahedron_levelset.vdb", "ls_icosahedron", "level set"),
        ("no_such_file.vdb", "density", "file not found"),
    ],
)
def test_files_without_such_a_density_are_refused(addon, scene, real_volumes, file, grid, said):
    assert_refused(addon, scene, real_volumes / file, grid, said)


def assert_refused(addon, scene, path, grid, said):
    blender_scenes.add_volume(scene, path, name="Odd one", Density_Attribute=grid)
    lit(scene)
    message = refusal(addon)
    assert '"Odd one"' in message and said in message


@pytest.mark.parametrize(
    "file, grid, known",
    [
        ("torus_max100.vdb", "density", '("voxel_fog_density")'),
        ("odd/vector_grid_only.vdb", "density", '("Cd")'),
        ("odd/points_only.vdb", "points", "(none)"),
    ],
)
def test_a_volume_whose_density_does_not_exist_is_empty(addon, scene, real_volumes, shared_volumes, file, grid, known):
    """As in Cycles. Points hold no numbers."""
    folder = real_volumes if (real_volumes / file).is_file() else shared_volumes
    blender_scenes.add_volume(scene, folder / file, name="Odd one", Density_Attribute=grid)
    lit(scene)
    described = read(addon)
    (said,) = described.empty
    assert not described.volumes and said in described.warnings[0]
    for part in ('"Odd one"', "Principled Volume", f'"{grid}", which is not among its grids', known):
        assert part in said


def test_negative_and_nan_voxels_are_taken_as_0_and_counted(addon, scene, shared_volumes):
    blender_scenes.add_volume(
        scene, shared_volumes / "odd/nan_and_negative.vdb", name="Odd one", Density_Attribute="posdensity"
    )
    lit(scene)
    described = read(addon)
    assert described.volumes[0][0].density.min() == 0.0
    (warning,) = [text for text in described.warnings if "Odd one" in text]
    assert "265260 negative" in warning and "1 NaN" in warning


def test_of_grids_of_one_name_the_first_is_read_with_a_warning(addon, scene, shared_volumes):
    blender_scenes.add_volume(scene, shared_volumes / "odd/three_grids_named_density.vdb")
    lit(scene)
    described = read(addon)
    assert np.count_nonzero(described.volumes[0][0].density) == 491
    assert '3 grids are named "density"' in described.warnings[0]


def two_voxels(scene, folder, far):
    vdb = blender_scenes.openvdb()
    grid = vdb.FloatGrid()
    grid.name = "density"
    accessor = grid.getAccessor()
    for corner in ((0, 0, 0), (far, far, far)):
        accessor.setValueOn(corner, 1.0)
    path = folder / "two_voxels.vdb"
    vdb.write(str(path), grids=[grid])
    blender_scenes.add_volume(scene, path)
    lit(scene)


def test_a_large_sparse_grid_takes_the_memory_of_its_blocks(addon, scene, tmp_path):
    two_voxels(scene, tmp_path, 2000)
    density = only_volume(addon).density
    assert density.shape == (2001, 2001, 2001) and density.nbytes < 1e8
    ends = np.array([[0.0, 2000.0, 1000.0]] * 3, np.float32)
    np.testing.assert_array_equal(density.sample(ends), [1.0, 1.0, 0.0])


def test_a_grid_too_large_is_refused_with_its_size(addon, scene, tmp_path):
    two_voxels(scene, tmp_path, 4000)
    assert "4001 x 4001 x 4001 = 64048012001 voxels" in refusal(addon)


def test_real_volumes_are_read_completely(addon, scene, real_volumes):
    grids = {"openvdb_smoke.vdb": (111, 222, 112), "blender_smoke_wind.vdb": (51, 49, 96)}
    for number, name in enumerate(grids):
        volume, _ = blender_scenes.add_volume(scene, real_volumes / name, name=name)
        volume.location.x = 1000.0 * number
    lit(scene)
    described = read(addon)
    assert {volume.name: volume.density.shape for volume, _ in described.volumes} == grids
    assert described.warnings == []


# Scene


def test_missing_parts_are_named(addon, scene, tmp_path):
    assert "camera" in refusal(addon)
    blender_scenes.add_camera(scene)
    assert "Volume object" in refusal(addon)
    blender_scenes.add_volume(scene, blender_scenes.write_vdb(tmp_path, np.ones((2, 2, 2))))
    assert "no sun" in refusal(addon)
    blender_scenes.add_sun(scene)
    assert read(addon).warnings == []


def test_a_volume_without_a_file_says_so(addon, scene):
    blender_scenes.add_object(scene, "Blank", bpy.data.volumes.new("Blank"))
    lit(scene)
    assert '"Blank": it loads no file' in refusal(addon)


def test_what_is_not_rendered_is_named(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    lamp = blender_scenes.add_object(scene, "Lamp", bpy.data.lights.new("Lamp", "POINT"))
    lamp.visible_volume_scatter = False
    ground = bpy.data.meshes.new("Ground")
    ground.from_pydata([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [], [(0, 1, 2)])
    blender_scenes.add_object(scene, "Ground", ground)
    linked = blender_scenes.add_sun(scene, "Linked")
    linked.light_linking.receiver_collection = bpy.data.collections.new("Some")
    bare = blender_scenes.add_sun(scene, "Bare")
    bare.data.use_shadow = bare.data.cycles.cast_shadow = False
    blind = blender_scenes.add_sun(scene, "Blind")
    blind.visible_volume_scatter = False
    described = read(addon)
    text = "\n".join(described.warnings)
    for named in ("Ground", "Bare"):
        assert named in text
    assert len(described.warnings) == 2
    # A collection without objects links to all; what volumes do not see lights the ground alone.
    receivers = {light.name: light.receivers for light in (*described.suns, *described.lamps)}
    ground = frozenset({'mesh object "Ground"'})
    seen = {f'sun "{name}"': None for name in ("Sun", "Linked", "Bare")}
    assert receivers == seen | {'sun "Blind"': ground, 'point light "Lamp"': ground}


@pytest.mark.parametrize("hide", ["hide_render", "collection", "exclude"])
def test_objects_hidden_in_renders_are_left_out(addon, scene, tmp_path, hide):
    blender_scenes.cloud_scene(scene, tmp_path)
    second = blender_scenes.add_sun(scene, "Second")
    group = bpy.data.collections.new("Group")
    scene.collection.children.link(group)
    scene.collection.objects.unlink(second)
    group.objects.link(second)
    assert len(read(addon).suns) == 2
    if hide == "hide_render":
        second.hide_render = True
    elif hide == "collection":
        group.hide_render = True
    else:
        bpy.context.view_layer.layer_collection.children["Group"].exclude = True
    assert [sun.name for sun in read(addon).suns] == ['sun "Sun"']


def test_hidden_in_the_viewport_alone_is_refused(addon, scene, tmp_path):
    cloud = blender_scenes.cloud_scene(scene, tmp_path)
    cloud.hide_set(True)
    message = refusal(addon)
    assert 'volume "Cloud" is hidden in the viewport' in message
    cloud.hide_render = True
    assert "no Volume object" in refusal(addon)


def test_sun_direction_and_irradiance(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    parent = blender_scenes.add_object(scene, "Parent", None)
    parent.rotation_euler, parent.scale = (0.4, 1.2, -0.5), (3.0, 3.0, 3.0)
    sun = blender_scenes.add_sun(scene, "Other", strength=3.0, colour=(0.2, 0.5, 1.0), rotation=(-1.0, 0.2, 2.0))
    sun.parent = parent
    (found,) = [sun for sun in read(addon).suns if "Other" in sun.name]
    # A sun shines along its -Z.
    shines = sun.matrix_world.to_quaternion() @ Vector((0.0, 0.0, -1.0))
    np.testing.assert_allclose(found.direction, -np.array(shines), atol=1e-6)
    # Half a degree across: a volume receives a little more than a surface.
    np.testing.assert_allclose(found.irradiance, (0.6, 1.5, 3.0), rtol=1e-5)


# Camera


def random_camera(scene, random):
    """Set a random camera of any supported kind."""
    camera = blender_scenes.add_camera(scene, random.uniform(-5, 5, 3), random.uniform(-3, 3, 3))
    camera.scale = random.uniform(0.5, 2.0, 3)
    lens = camera.data
    lens.type = random.choice(["PERSP", "ORTHO"])
    lens.lens, lens.ortho_scale = random.uniform(15, 90), random.uniform(2, 9)
    lens.sensor_fit = random.choice(["AUTO", "HORIZONTAL", "VERTICAL"])
    lens.sensor_width, lens.sensor_height = random.uniform(10, 40, 2)
    lens.shift_x, lens.shift_y = random.uniform(-0.5, 0.5, 2)
    scene.render.resolution_x, scene.render.resolution_y = (int(n) for n in random.integers(20, 200, 2))
    scene.render.resolution_percentage = int(random.integers(30, 150))
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = random.uniform(1, 2, 2)


@pytest.mark.parametrize("seed", range(12))
def test_rays_pass_through_the_pixels_that_blender_projects_to(addon, scene, tmp_path, seed):
    random = np.random.default_rng(seed)
    blender_scenes.cloud_scene(scene, tmp_path)
    random_camera(scene, random)
    camera = read(addon).camera
    width, height = camera.resolution
    assert camera.resolution == (
        scene.render.resolution_x * scene.render.resolution_percentage // 100,
        scene.render.resolution_y * scene.render.resolution_percentage // 100,
    )
    # Blender's projection in full-size pixels of the same aspect.
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    origins, directions, *_ = camera_rays(camera)
    bpy.context.view_layer.update()
    for pixel in random.integers(0, width * height, 20):
        point = Vector(origins[pixel] + random.uniform(2, 9) * directions[pixel])
        x, y, depth = world_to_camera_view(scene, scene.camera, point)
        assert depth > 0.0
        np.testing.assert_allclose(
            (x * width, (1.0 - y) * height), (pixel % width + 0.5, pixel // width + 0.5), atol=2e-3
        )


def test_the_render_region_counts_rows_from_the_top(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    render = scene.render
    render.use_border = True
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.7, 0.1, 0.6
    # As Blender cuts it: 0.7 * 64 = 44.8 -> 44, 0.1 * 64 = 6.4 -> 6, 0.6 * 64 = 38.4 -> 38.
    assert read(addon).camera.region == (16, 64 - 38, 44, 64 - 6)
    render.border_max_x = render.border_min_x
    assert "region" in refusal(addon)


def test_cameras_that_cannot_be_rendered_are_refused(addon, scene, tmp_path):
    blender_scenes.cloud_scene(scene, tmp_path)
    lens = scene.camera.data
    lens.clip_start, lens.clip_end = 10.0, 1.0
    assert '"Camera": its Clip Start is not below its Clip End' in refusal(addon)
    lens.clip_start, lens.clip_end = 0.1, 100.0
    lens.type = "PANO"
    lens.panorama_type = "FISHEYE_EQUIDISTANT"
    assert '"Camera" is of type Fisheye Equidistant' in refusal(addon)


@pytest.mark.parametrize("ends", [(-math.pi, math.pi, -math.pi / 2, math.pi / 2), (-0.3, 1.5, -1.2, 0.7)])
def test_a_panorama_shows_a_volume_where_cycles_does(addon, scene, tmp_path, ends):
    cloud = blender_scenes.cloud_scene(scene, tmp_path)
    cloud.location, cloud.scale = (1.1, 0.4, -0.5), (0.5, 0.5, 0.5)
    # Purely absorbing: nothing to predict.
    shader = cloud.data.materials[0].node_tree.nodes["Principled Volume"]
    shader.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    camera = scene.camera
    camera.location, camera.rotation_euler = (0.0, -2.0, 0.0), (1.4, 0.2, 0.3)
    lens = camera.data
    lens.type, lens.panorama_type = "PANO", "EQUIRECTANGULAR"
    lens.longitude_min, lens.longitude_max, lens.latitude_min, lens.latitude_max = ends
    scene.render.resolution_x, scene.render.resolution_y = 64, 32
    bpy.context.view_layer.update()
    described = read(addon)
    layer = render(described.volumes, described.suns, described.camera, Settings(depth_samples=1))
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=128)[..., 3]
    assert expected.sum() > 5.0
    assert np.abs(layer.alpha - expected).max() < 0.15
    assert layer.alpha.sum() == pytest.approx(expected.sum(), rel=0.03)
