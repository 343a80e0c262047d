# SPDX-License-Identifier: GPL-3.0-or-later
"""Where volumes come from: sequences of files, modifiers, geometry nodes and instances."""

import shutil

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from inference import Medium, SceneError, Settings, render
from tests.support import blender_scenes


def read(addon):
    return addon.mrpnn_addon.scene.reader.read_scene(blender_scenes.depsgraph())


def lit(scene):
    blender_scenes.add_sun(scene)
    blender_scenes.add_camera(scene)


def sequence(scene, folder, numbers):
    """A Volume object of files 1 to 3, of which `numbers` are there; file n holds n slices."""
    for number in numbers:
        shutil.move(blender_scenes.write_vdb(folder, np.ones((number, 3, 3))), folder / f"fog_{number:03}.vdb")
    cloud, _ = blender_scenes.add_volume(scene, folder / "fog_001.vdb")
    cloud.data.is_sequence, cloud.data.frame_start, cloud.data.frame_duration = True, 10, 3
    return cloud


def shown_files(addon, scene, frames):
    """The number of the file that each frame shows, 0 for none."""
    found = []
    for frame in frames:
        scene.frame_set(frame)
        described = read(addon)
        cloud = [volume for volume, _ in described.volumes if volume.name == "Cloud"]
        assert cloud or any("Cloud" in warning and f"frame {frame}" in warning for warning in described.warnings)
        found.append(cloud[0].density.shape[0] if cloud else 0)
    return found


@pytest.mark.parametrize(
    "mode, offset, expected",
    [
        ("CLIP", 0, [0, 1, 2, 3, 0, 0]),
        ("EXTEND", 0, [1, 1, 2, 3, 3, 3]),
        ("REPEAT", 0, [3, 1, 2, 3, 1, 2]),
        ("PING_PONG", 0, [2, 1, 2, 3, 2, 1]),
        ("EXTEND", 1, [2, 2, 3, 3, 3, 3]),
    ],
)
def test_sequence_modes(addon, scene, tmp_path, mode, offset, expected):
    cloud = sequence(scene, tmp_path, (1, 2, 3, 4))
    cloud.data.sequence_mode, cloud.data.frame_offset = mode, offset
    blender_scenes.add_volume(scene, blender_scenes.write_vdb(tmp_path, np.ones((5, 5, 5))), name="Still")
    lit(scene)
    found = shown_files(addon, scene, range(9, 15))
    if offset:
        # An offset may reach a file beyond the sequence's end.
        assert found[1] == expected[1]
    else:
        assert found == expected


def test_frames_before_a_sequence_begins_are_empty(addon, scene, tmp_path):
    """As in Cycles, so that an animation does not end there."""
    sequence(scene, tmp_path, (1, 2, 3)).data.sequence_mode = "CLIP"
    lit(scene)
    scene.frame_set(9)
    described = read(addon)
    assert described.warnings == ['volume "Cloud" has no file for frame 9 (left out)']
    finished = addon.mrpnn_addon.engine.render_job.render_scene(described, Settings(), str(tmp_path / "9.exr"))
    assert (tmp_path / "9.exr").is_file() and finished.warnings[:1] == described.warnings
    width, height = described.camera.resolution
    assert finished.layer.rgb.shape == (height, width, 3) and not finished.layer.alpha.any()
    checked = addon.mrpnn_addon.status.scene_check.check_scene(blender_scenes.depsgraph())
    assert not checked.error and checked.warnings[:1] == described.warnings
    # Hidden, it is an error.
    scene.frame_set(10)
    assert read(addon).volumes
    scene.objects["Cloud"].visible_camera = False
    with pytest.raises(SceneError, match='no volume is left to render: volume "Cloud" is hidden'):
        read(addon)


def test_a_missing_file_of_a_sequence_is_named(addon, scene, tmp_path):
    sequence(scene, tmp_path, (1, 3))
    lit(scene)
    scene.frame_set(11)
    message = '"Cloud": this frame.s file of its sequence cannot be read .*fog_002.vdb'
    with pytest.raises(SceneError, match=message):
        read(addon)


def geometry_nodes(owner, *kinds):
    """A modifier that makes geometry by a chain of nodes; gives the last node."""
    group = bpy.data.node_groups.new("Make", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    entry, leave = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    last, nodes = entry.outputs[0], []
    for kind in kinds:
        node = group.nodes.new(f"GeometryNode{kind}")
        geometry = next((socket for socket in node.inputs if socket.type == "GEOMETRY"), None)
        if geometry is not None:
            group.links.new(last, geometry)
        last = node.outputs[0]
        nodes.append(node)
    group.links.new(last, leave.inputs[0])
    owner.modifiers.new("Make", "NODES").node_group = group
    return nodes


def test_a_mesh_that_nodes_turn_into_a_volume_is_only_that_volume(addon, scene):
    """Its material is the volume's, as that of the mesh's interior would be."""
    source = cube(scene)
    points, volume, material = geometry_nodes(source, "MeshToPoints", "PointsToVolume", "SetMaterial")
    volume.inputs["Radius"].default_value = 0.5
    blender_scenes.add_fog(source.data, "Fog", "ShaderNodeVolumePrincipled")
    material.inputs["Material"].default_value = source.data.materials[0]
    lit(scene)
    described = read(addon)
    assert len(described.volumes) == 1 and not described.warnings
    # Eight balls around the corners.
    grid, _ = described.volumes[0]
    edges = np.linalg.norm(grid.world_from_index[:3, :3], axis=0) * grid.density.shape
    np.testing.assert_allclose(edges, 3.0, rtol=0.2)
    # A comparison's reference shows the same.
    shown = addon.mrpnn_addon.cycles.reference.volumes_and_lights(blender_scenes.depsgraph())
    assert {item.name for item in shown} == {"Cube", "Sun"}


def cube(scene, name="Cube"):
    mesh = bpy.data.meshes.new(name)
    corners = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    mesh.from_pydata(corners, [], [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)])
    return blender_scenes.add_object(scene, name, mesh)


def fog_material():
    data = bpy.data.volumes.new("Holder")
    material = bpy.data.materials.new("Thick")
    material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    node = tree.nodes.new("ShaderNodeVolumePrincipled")
    node.inputs["Density"].default_value = 3.0
    tree.links.new(node.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Volume"])
    data.materials.append(material)
    return data, material


@pytest.mark.parametrize("holder", ["volume object", pytest.param("mesh object", marks=pytest.mark.slow)])
def test_geometry_nodes_make_volumes(addon, scene, tmp_path, holder):
    """Volume Cube with a material of its own, in a Volume object and in a mesh's modifier."""
    data, material = fog_material()
    owner = blender_scenes.add_object(scene, "Made", data) if holder == "volume object" else cube(scene, "Made")
    made, coat = geometry_nodes(owner, "VolumeCube", "SetMaterial")
    coat.inputs["Material"].default_value = material
    owner.location = (0.5, 0.2, 0.1)
    lit(scene)
    scene.render.resolution_x = scene.render.resolution_y = 32
    described = read(addon)
    ((volume, medium),) = described.volumes
    assert "Made" in volume.name
    np.testing.assert_allclose(medium.sigma_t, 3.0 * 1.0)
    suns = described.suns
    black = [(volume, Medium(medium.sigma_t, 0.0))]
    layer = render(black, suns, described.camera, Settings(depth_samples=1))
    expected = blender_scenes.render_cycles(scene, tmp_path, samples=32)[..., 3]
    assert expected.mean() > 0.05
    # Cycles 4.5 cuts off the half voxel over which the outermost voxels fade.
    assert layer.alpha.mean() == pytest.approx(expected.mean(), rel=0.04)


def test_points_to_volume(addon, scene, tmp_path):
    data, material = fog_material()
    owner = cube(scene, "Made")
    points, fill, coat = geometry_nodes(owner, "MeshToPoints", "PointsToVolume", "SetMaterial")
    points.inputs["Radius"].default_value = 0.4
    fill.inputs["Radius"].default_value = 0.4
    coat.inputs["Material"].default_value = material
    lit(scene)
    ((volume, _),) = read(addon).volumes
    mass = volume.density.sum() * abs(np.linalg.det(volume.world_from_index[:3, :3]))
    # Eight balls, whose density falls off within their radius.
    assert 0.1 < mass / (8 * 4 / 3 * np.pi * 0.4**3) < 1.2


def test_volumes_instanced_on_points_share_what_was_read(addon, scene, tmp_path):
    cloud = blender_scenes.cloud_scene(scene, tmp_path)
    cloud.hide_render = True
    owner = cube(scene, "Scatterer")
    group_info, on_points = geometry_nodes(owner, "ObjectInfo", "InstanceOnPoints")
    tree = group_info.id_data
    group_info.inputs["Object"].default_value = cloud
    group_info.inputs["As Instance"].default_value = True
    entry = next(node for node in tree.nodes if node.bl_idname == "NodeGroupInput")
    tree.links.new(entry.outputs[0], on_points.inputs["Points"])
    tree.links.new(group_info.outputs["Geometry"], on_points.inputs["Instance"])
    volumes = [volume for volume, _ in read(addon).volumes]
    assert len(volumes) == 8
    places = np.array([volume.world_from_index[:3, 3] for volume in volumes])
    assert len(np.unique(places.round(4), axis=0)) == 8
    assert all(volume.density is volumes[0].density for volume in volumes)
    # Instances of a hidden object show in Cycles too.
    scene.camera.location.z = 12.0
    assert blender_scenes.render_cycles(scene, tmp_path, samples=4)[..., 3].max() > 0.5


def test_an_animation_reads_the_next_frames_file_while_it_renders(addon, scene, tmp_path):
    sequence(scene, tmp_path, (1, 2, 3))
    lit(scene)
    scene.render.engine = "MRPNN"
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.frame_start, scene.frame_end = 10, 11
    in_use, seen = addon.mrpnn_addon.vdb.density_grid.density_grid_in_use, []

    def after_a_frame(*_):
        ahead = addon.mrpnn_addon.engine.engine.MRPNNRenderEngine._ahead
        if ahead is not None:
            ahead.wait(60)
        seen.append([in_use(str(tmp_path / f"fog_{number:03}.vdb"), "density", "") is not None for number in (2, 3)])

    bpy.app.handlers.render_write.append(after_a_frame)
    try:
        scene.render.filepath = str(tmp_path / "frame_##")
        bpy.ops.render.render(animation=True)
    finally:
        bpy.app.handlers.render_write.remove(after_a_frame)
    # After frame 10 its next file is there; after the last frame nothing is read that no frame will show.
    assert seen[0] == [True, False] and not seen[1][1]
    assert {path.name for path in tmp_path.glob("frame_*")} == {"frame_10.png", "frame_11.png"}


def test_reading_ahead_leaves_missing_and_damaged_files_to_their_frames(addon, scene, tmp_path):
    sequence(scene, tmp_path, (1, 2))
    lit(scene)
    scene.frame_set(10)
    read_ahead = addon.mrpnn_addon.volumes.read_ahead
    sources = addon.mrpnn_addon.volumes.reader.VolumeReader().wanted(blender_scenes.depsgraph())
    (path,) = [source.path for source in sources]
    assert read_ahead.following_file(path, 1) == str(tmp_path / "fog_002.vdb")
    assert read_ahead.following_file(path, 2) is None
    (tmp_path / "fog_002.vdb").write_bytes(b"no volume")
    ahead = read_ahead.ReadAhead(sources, 1)
    ahead.wait(60)
    assert ahead.done and ahead.error is None and not ahead.held
    scene.frame_set(11)
    with pytest.raises(SceneError, match="file of its sequence cannot be read"):
        read(addon)
