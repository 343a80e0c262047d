# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur as in Cycles."""

import importlib

import bpy
import numpy as np
import pytest

from tests.support import blender_scenes as make

# Noise of an error falls with the samples, and with the root of the pixels: few pixels tell most for their time.
SIZE, SAMPLES = 24, 128
# Of edges, of surfaces and of colours, which fewer of more pixels hold.
FINE_SIZE, FEWER_SAMPLES = 48, 64
FRAME = 10


def keyed(animated, path, values):
    """Straight lines through values in frames around FRAME, and beyond."""
    for frame, value in values.items():
        setattr(animated, path, value)
        animated.keyframe_insert(path, frame=frame)
    action = animated.animation_data.action
    curves = action.fcurves if hasattr(action, "fcurves") else action.layers[0].strips[0].channelbags[0].fcurves
    for curve in curves:
        for point in curve.keyframe_points:
            point.interpolation = "LINEAR"


def moving_camera(scene):
    """It moves and turns, such that both show."""
    keyed(scene.camera, "location", {FRAME - 2: (-0.8, 0.0, 4.5), FRAME + 2: (0.8, 0.0, 4.5)})
    keyed(scene.camera, "rotation_euler", {FRAME - 2: (0.0, -0.1, 0.0), FRAME + 2: (0.0, 0.05, 0.3)})


def zoom(scene):
    keyed(scene.camera.data, "lens", {FRAME - 1: 35.0, FRAME + 1: 70.0})


def moving_cloud(scene):
    """Along the picture and in depth; it turns and grows."""
    cloud = scene.objects["Cloud"]
    keyed(cloud, "location", {FRAME - 2: (-0.6, -0.2, -0.3), FRAME + 2: (0.6, 0.2, 0.3)})
    keyed(cloud, "rotation_euler", {FRAME - 2: (0.0, 0.0, -0.4), FRAME + 2: (0.2, 0.0, 0.4)})
    keyed(cloud, "scale", {FRAME - 2: (0.9, 0.9, 0.9), FRAME + 2: (1.1, 1.1, 1.1)})


@pytest.fixture
def motion_scene(scene, tmp_path):
    """A thin cloud, a sun, and a camera with motion blur."""
    make.add_volume(
        scene,
        make.write_vdb(tmp_path, make.blob(16, 3), make.centred(16, 1.2)),
        Density=2.0,
        Color=(0.5, 0.5, 0.5, 1.0),
        Anisotropy=0.0,
    )
    make.add_sun(scene, strength=3.0)
    make.add_camera(scene, location=(0.0, 0.0, 4.5)).data.angle = 0.5
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.engine = "MRPNN"
    scene.render.use_motion_blur, scene.render.motion_blur_shutter = True, 1.0
    scene.mrpnn.blur_rays = 16
    scene.frame_set(FRAME)
    return scene


def error(layer, halves):
    """Relative RMSE of a layer against two independent halves, without their noise."""
    a, b = (half.astype(np.float64) for half in halves)
    mean = 0.5 * (a + b).mean()
    return np.sqrt(max(((layer - a) * (layer - b)).mean(), 0.0)) / mean


def errors_against_cycles(scene, folder, samples=SAMPLES):
    """Relative RMSE of colours and alpha, without and with motion blur, and how much it changes the picture."""
    reference = importlib.import_module("mrpnn.mrpnn_addon.cycles.reference")
    objects = [shown for shown in scene.objects if shown.type != "CAMERA"]
    errors, pictures = {}, {}
    for blurred in (False, True):
        scene.render.use_motion_blur = blurred
        layer = pictures[blurred] = make.rendered(scene, folder)
        tracing = reference.PathTracing(samples=samples, box_filter=True)
        found = reference.render_reference(scene, objects, tracing)
        errors[blurred] = [
            error(layer[..., some], (found.a[..., some], found.b[..., some])) for some in (slice(0, 3), slice(3, 4))
        ]
    change = np.sqrt(((pictures[True] - pictures[False]) ** 2).mean()) / pictures[False].mean()
    print(errors, change)
    return errors, change


def read(scene, check=lambda: None):
    package = importlib.import_module("mrpnn.mrpnn_addon.scene.reader")
    kept = importlib.import_module("mrpnn.mrpnn_addon.scene.kept_frame")
    return package.read_frame(make.depsgraph(), check=check, go_to=kept.goes_to(scene))


def where(scene):
    return scene.frame_current, scene.frame_subframe


def test_a_scene_is_back_in_its_frame_whatever_happens(addon, motion_scene):
    moving_cloud(motion_scene)
    motion_scene.frame_set(FRAME, subframe=0.25)
    found = read(motion_scene)
    (volume, _), place = found.volumes[0], motion_scene.objects["Cloud"].matrix_world
    assert where(motion_scene) == (FRAME, 0.25)
    assert np.allclose(volume.motion.world_matrix, place)
    # The shutter is open half a frame before and after.
    assert [matrix[0, 3] for matrix in volume.motion.world_matrices] == pytest.approx([-0.075, 0.075, 0.225])

    def stop(calls=[]):  # noqa: B006
        calls.append(where(motion_scene))
        if calls[-1] != calls[0]:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        read(motion_scene, stop)
    assert where(motion_scene) == (FRAME, 0.25)


@pytest.mark.parametrize("position, opens", [("START", 0.0), ("CENTER", -0.4), ("END", -0.8)])
def test_the_shutter_opens_where_its_position_says(addon, motion_scene, position, opens):
    moving_camera(motion_scene)
    motion_scene.render.motion_blur_position, motion_scene.render.motion_blur_shutter = position, 0.8
    matrices = read(motion_scene).camera.shutter.world_matrices
    assert np.allclose(matrices[[0, 2], 0, 3], 0.4 * np.array([opens, opens + 0.8]), atol=1e-6)
    motion_scene.objects["Camera"].cycles.motion_steps = 2
    assert len(read(motion_scene).camera.shutter.world_matrices) == 5
    motion_scene.objects["Camera"].cycles.use_motion_blur = False
    assert read(motion_scene).camera.shutter is None


def test_what_stands_still_is_not_blurred(addon, motion_scene):
    found = read(motion_scene)
    assert found.camera.shutter is None and found.volumes[0][0].motion is None
    moving_cloud(motion_scene)
    motion_scene.objects["Cloud"].cycles.use_motion_blur = False
    assert read(motion_scene).volumes[0][0].motion is None
    motion_scene.objects["Cloud"].cycles.use_motion_blur = True
    motion_scene.view_layers[0].use_motion_blur = False
    assert read(motion_scene).camera.shutter is None


def test_a_camera_that_a_marker_binds_at_the_frame_is_the_one_that_moves(addon, motion_scene):
    moving_camera(motion_scene)
    other = motion_scene.camera.copy()
    motion_scene.collection.objects.link(other)
    other.animation_data_clear()
    other.location.x = 5.0
    for name, frame, camera in (("Before", 1, other), ("Cut", FRAME, motion_scene.camera)):
        motion_scene.timeline_markers.new(name, frame=frame).camera = camera
    motion_scene.frame_set(FRAME)
    assert np.abs(read(motion_scene).camera.shutter.world_matrices[:, 0, 3]).max() < 0.3
    assert motion_scene.camera.name == "Camera"


def add_velocity(scene, folder, values, edge=1.2, parts=False):
    """Give the cloud's file velocities (3, n, n, n) over a centred cube."""
    cloud = scene.objects["Cloud"].data
    frame = make.centred(values.shape[1], edge)
    cloud.filepath = make.with_velocity(folder, cloud.filepath, values, frame, parts)


def whirl(cells=12, edge=1.4):
    """Velocities that turn about z, rise, and differ along x; in object units per frame."""
    axis = ((np.arange(cells) + 0.5) / cells - 0.5) * edge
    x, y, _ = np.meshgrid(axis, axis, axis, indexing="ij")
    return np.stack([-1.2 * y + 0.3, 1.2 * x, 0.4 + x])


def flowing(scene, folder, unit="FRAME"):
    add_velocity(scene, folder, whirl(), 1.4)
    data = scene.objects["Cloud"].data
    data.velocity_unit, data.velocity_scale = unit, 1.0 if unit == "FRAME" else 24.0
    scene.objects["Cloud"].rotation_euler = 0.2, -0.3, 0.4
    scene.frame_set(FRAME)


def add_wall(scene, width=0.2):
    """A wall in front of the middle of the cloud, which hides it and throws no shadow."""
    mesh, x = bpy.data.meshes.new("Wall"), 0.5 * width
    mesh.from_pydata([(-x, -0.7, 0), (x, -0.7, 0), (x, 0.7, 0), (-x, 0.7, 0)], [], [(0, 1, 2, 3)])
    wall = make.add_object(scene, "Wall", mesh)
    wall.location.z, wall.is_holdout = 0.8, True
    wall.visible_shadow = wall.visible_volume_scatter = False
    return wall


def passing_wall(scene):
    """It crosses the cloud, and turns."""
    wall = add_wall(scene)
    keyed(wall, "location", {FRAME - 2: (-0.5, 0.0, 0.8), FRAME + 2: (0.5, 0.0, 0.8)})
    keyed(wall, "rotation_euler", {FRAME - 2: (0.0, 0.0, -0.4), FRAME + 2: (0.0, 0.1, 0.4)})


def growing_wall(scene):
    """It changes its shape: its right side moves."""
    wall = add_wall(scene)
    wall.shape_key_add(name="Basis")
    key = wall.shape_key_add(name="Wide")
    for number in (1, 2):
        key.data[number].co.x += 0.6
    for frame, value in ((FRAME - 1, 0.0), (FRAME + 1, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)


def test_meshes_move_and_change_their_shape_in_the_shutter(addon, motion_scene):
    passing_wall(motion_scene)
    motion_scene.frame_set(FRAME, subframe=0.25)
    [surface] = read(motion_scene).surfaces
    assert where(motion_scene) == (FRAME, 0.25) and surface.deformed is None
    assert [matrix[0, 3] for matrix in surface.motion.world_matrices] == pytest.approx([-0.0625, 0.0625, 0.1875])
    motion_scene.objects["Wall"].cycles.use_motion_blur = False
    assert not read(motion_scene).surfaces[0].moves
    bpy.data.objects.remove(motion_scene.objects["Wall"])
    growing_wall(motion_scene)
    motion_scene.frame_set(FRAME)
    [surface] = read(motion_scene).surfaces
    right = surface.deformed[..., 0].max(axis=(1, 2))
    assert surface.motion is None and right[1] == pytest.approx(surface.triangles[..., 0].max())
    assert (np.diff(right) > 0.1).all()
    motion_scene.objects["Wall"].cycles.use_deform_motion = False
    assert not read(motion_scene).surfaces[0].moves
    motion_scene.render.use_motion_blur = False
    assert not read(motion_scene).surfaces[0].moves


def growing_fog(scene):
    """A ball of fog in place of the cloud, whose right half grows."""
    bpy.data.objects.remove(scene.objects["Cloud"])
    bpy.ops.mesh.primitive_ico_sphere_add(radius=0.5, subdivisions=3)
    ball = bpy.context.object
    make.add_fog(ball.data, "Fog", "ShaderNodeVolumePrincipled", Density=3.0, Color=(0.5, 0.5, 0.5, 1.0))
    ball.shape_key_add(name="Basis")
    key = ball.shape_key_add(name="Wide")
    for point in key.data:
        point.co.x *= 2.2 if point.co.x > 0.0 else 1.0
    for frame, value in ((FRAME - 1, 0.0), (FRAME + 1, 1.0)):
        key.value = value
        key.keyframe_insert("value", frame=frame)


@pytest.mark.parametrize("position, frame, part", [("START", 0.0, 0.5), ("CENTER", 0.5, 0.6875), ("END", 1.0, 0.5)])
def test_fog_is_carried_by_the_surface_of_its_mesh(addon, motion_scene, position, frame, part):
    """part: of the whole growth, which begins and ends slowly, in the shutter."""
    growing_fog(motion_scene)
    ball = bpy.context.object
    ball.rotation_euler.z, ball.location.y = 0.5 * np.pi, 2.0
    motion_scene.render.motion_blur_position = position
    motion_scene.frame_set(FRAME)
    found = read(motion_scene)
    velocity = found.volumes[0][0].velocity
    assert not found.warnings and velocity.times == pytest.approx((-frame, 1.0 - frame))
    # By how much the right end of the ball, turned to +Y, moves in a shutter of one frame.
    along = velocity.world_from_velocity @ np.array([grid.max() for grid in velocity.components])
    assert along[1] == pytest.approx(0.5 * 1.2 * part, rel=0.05)
    assert max(np.abs(grid[:3]).max() for grid in velocity.components) < 1e-5
    middle = velocity.world_from_index @ [*(0.5 * (np.array(velocity.components[0].shape) - 1.0)), 1.0]
    assert np.allclose(middle[[0, 2]], 0.0, atol=1e-5) and 2.0 < middle[1] < 2.4
    ball.cycles.use_deform_motion = False
    assert read(motion_scene).volumes[0][0].velocity is None


@pytest.mark.parametrize("parts", [False, True])
def test_velocities_of_a_file_are_read(addon, motion_scene, tmp_path, parts):
    values = np.random.default_rng(5).normal(size=(3, 6, 7, 8)).astype(np.float32)
    add_velocity(motion_scene, tmp_path, values, parts=parts)
    cloud = motion_scene.objects["Cloud"]
    cloud.rotation_euler, cloud.scale = (0.3, 0.2, 0.1), (2.0, 1.0, 0.5)
    motion_scene.frame_set(FRAME)
    found = read(motion_scene)
    velocity = found.volumes[0][0].velocity
    assert found.camera.shutter is not None and not found.warnings
    assert all(np.array_equal(part, expected) for part, expected in zip(velocity.components, values))
    matrix = np.array(cloud.matrix_world)
    assert np.allclose(velocity.world_from_velocity, matrix[:3, :3])
    # The middle of the grid lies half a voxel off before Blender 5.0.
    middle = velocity.world_from_index @ [2.5, 2.5, 2.5, 1.0]
    centre = 0.5 * 1.2 / 6 if bpy.app.version < (5, 0, 0) else 0.0
    assert np.allclose(middle, matrix @ [centre, centre, centre, 1.0], atol=1e-6)


@pytest.mark.parametrize(
    "position, unit, times",
    [
        ("CENTER", "FRAME", (-1.0, 1.0)),
        ("START", "FRAME", (0.0, 2.0)),
        ("END", "FRAME", (1.0, 3.0)),
        ("CENTER", "SECOND", (-0.025, 0.025)),
    ],
)
def test_the_times_of_velocities_are_those_of_cycles(addon, motion_scene, tmp_path, position, unit, times):
    flowing(motion_scene, tmp_path, unit)
    render, data = motion_scene.render, motion_scene.objects["Cloud"].data
    render.motion_blur_position, render.motion_blur_shutter, render.fps, render.fps_base = position, 0.5, 30, 1.5
    data.velocity_scale = 2.0
    data.update_tag()
    assert read(motion_scene).volumes[0][0].velocity.times == pytest.approx(times)


def test_velocities_that_are_not_to_be_shown_are_not(addon, motion_scene, tmp_path):
    flowing(motion_scene, tmp_path)
    data = motion_scene.objects["Cloud"].data
    data.velocity_scale = 0.0
    data.update_tag()
    assert read(motion_scene).camera.shutter is None
    data.velocity_scale = 1.0
    data.update_tag()
    motion_scene.objects["Cloud"].cycles.use_motion_blur = False
    assert read(motion_scene).volumes[0][0].velocity is None
    motion_scene.objects["Cloud"].cycles.use_motion_blur = True
    motion_scene.render.use_motion_blur = False
    assert read(motion_scene).volumes[0][0].velocity is None


def test_fog_in_a_mesh_has_no_velocities_to_read_ahead(addon, motion_scene):
    reader = importlib.import_module("mrpnn.mrpnn_addon.volumes.reader").VolumeReader()
    before = len(reader.wanted(make.depsgraph()))
    bpy.ops.mesh.primitive_cube_add(size=0.5)
    make.add_fog(bpy.context.object.data, "Fog", "ShaderNodeVolumePrincipled", Density=1.0)
    assert len(reader.wanted(make.depsgraph())) == before + 1


def test_spoiled_velocities_leave_a_picture(addon, motion_scene, tmp_path):
    values = np.full((3, 8, 8, 8), 1e30)
    values[:, ::2] = np.nan
    add_velocity(motion_scene, tmp_path, values)
    layer = make.rendered(motion_scene, tmp_path)
    assert np.isfinite(layer).all() and layer.max() > 0.01


@pytest.mark.slow(seconds=15)
@pytest.mark.parametrize("move", [moving_camera, zoom, moving_cloud])
def test_pictures_are_as_blurred_as_in_cycles(addon, motion_scene, tmp_path, move):
    move(motion_scene)
    errors, change = errors_against_cycles(motion_scene, tmp_path)
    assert change > 0.15
    for sharp, blurred in zip(errors[False], errors[True]):
        assert blurred < sharp + 0.04
    assert (motion_scene.frame_current, motion_scene.frame_subframe) == (FRAME, 0.0)


@pytest.mark.slow(seconds=20)
@pytest.mark.parametrize("move, most", [(passing_wall, 0.12), (growing_wall, 0.05), (growing_fog, 0.05)])
def test_meshes_that_hide_or_hold_fog_blur_as_in_cycles(addon, motion_scene, tmp_path, move, most):
    move(motion_scene)
    motion_scene.render.resolution_x = motion_scene.render.resolution_y = FINE_SIZE
    motion_scene.frame_set(FRAME)
    errors, change = errors_against_cycles(motion_scene, tmp_path, FEWER_SAMPLES)
    assert change > 0.3
    for sharp, blurred in zip(errors[False], errors[True]):
        assert blurred < sharp + most


def colour(scene):
    """The cloud's colour varies along x."""
    tree = scene.objects["Cloud"].data.materials[0].node_tree
    [shader] = [node for node in tree.nodes if node.type == "PRINCIPLED_VOLUME"]
    place, along, ramp = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("TexCoord", "SeparateXYZ", "ValToRGB"))
    tree.links.new(place.outputs["Generated"], along.inputs[0])
    tree.links.new(along.outputs["X"], ramp.inputs[0])
    tree.links.new(ramp.outputs[0], shader.inputs["Color"])
    for element, values in zip(ramp.color_ramp.elements, ((0.9, 0.1, 0.1, 1.0), (0.1, 0.2, 0.9, 1.0))):
        element.color = values


@pytest.mark.slow(seconds=130)
def test_velocities_carry_colours_as_in_cycles(addon, motion_scene, tmp_path):
    motion_scene.render.resolution_x = motion_scene.render.resolution_y = FINE_SIZE
    flowing(motion_scene, tmp_path)
    colour(motion_scene)
    errors, change = errors_against_cycles(motion_scene, tmp_path)
    assert change > 0.05
    for sharp, blurred in zip(errors[False], errors[True]):
        assert blurred < sharp + 0.05


def test_what_glows_within_the_bounds_of_a_file_stays_there(addon, motion_scene, tmp_path):
    """Cycles lets it glow in the bounds that the cloud may be carried to, which are four times as bright here."""
    flowing(motion_scene, tmp_path)
    tree = motion_scene.objects["Cloud"].data.materials[0].node_tree
    [shader] = [node for node in tree.nodes if node.type == "PRINCIPLED_VOLUME"]
    shader.inputs["Emission Strength"].default_value = 1.0
    light = {}
    for blurred in (False, True):
        motion_scene.render.use_motion_blur = blurred
        light[blurred] = make.rendered(motion_scene, tmp_path)[..., :3].mean()
    assert light[True] == pytest.approx(light[False], rel=0.02) and light[False] > 1.0


@pytest.mark.slow(seconds=70)
def test_velocities_blur_as_in_cycles_for_every_shutter_and_unit(addon, motion_scene, tmp_path):
    """Each picture is nearest to Cycles' own picture of it.

    What moves by its own size is lit less alike than it is shown: light is that of the frame.
    """
    reference = importlib.import_module("mrpnn.mrpnn_addon.cycles.reference")
    flowing(motion_scene, tmp_path)
    scene, data = motion_scene, motion_scene.objects["Cloud"].data
    scene.render.resolution_x, scene.render.resolution_y = 24, 18
    scene.render.motion_blur_shutter, scene.mrpnn.depth_samples = 0.6, 2
    objects = [shown for shown in scene.objects if shown.type != "CAMERA"]
    cases, found, tracing = [], [], reference.PathTracing(samples=96, box_filter=True)
    for position in ("START", "CENTER", "END"):
        for unit in ("FRAME", "SECOND"):
            cases.append((position, unit))
            scene.render.motion_blur_position, data.velocity_unit = cases[-1]
            data.velocity_scale = 1.0 if unit == "FRAME" else 24.0
            data.update_tag()
            halves = reference.render_reference(scene, objects, tracing)
            found.append((make.rendered(scene, tmp_path), halves.a, halves.b))
    colours, alpha = (
        np.array([[error(layer[..., c], (a[..., c], b[..., c])) for _, a, b in found] for layer, *_ in found])
        for c in (slice(0, 3), slice(3, 4))
    )
    # Other cases' alpha differs by 0.12 and more.
    assert alpha.diagonal().max() < 0.08 and colours.diagonal().max() < 0.18
    assert (alpha.argmin(axis=1) == np.arange(len(cases))).all()
