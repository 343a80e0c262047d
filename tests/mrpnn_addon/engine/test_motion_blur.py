# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion blur as in Cycles."""

import importlib

import numpy as np
import pytest

from tests.support import blender_scenes as make

SIZE = 48
FRAME = 10


def keyed(animated, path, values, index=-1):
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


def errors_against_cycles(scene, folder):
    """Relative RMSE of colours and alpha, without and with motion blur, and how much it changes the picture."""
    reference = importlib.import_module("mrpnn.mrpnn_addon.cycles.reference")
    objects = [shown for shown in scene.objects if shown.type != "CAMERA"]
    errors, pictures = {}, {}
    for blurred in (False, True):
        scene.render.use_motion_blur = blurred
        layer = pictures[blurred] = make.rendered(scene, folder)
        tracing = reference.PathTracing(samples=128, box_filter=True)
        found = reference.render_reference(scene, objects, tracing)
        errors[blurred] = [
            error(layer[..., some], (found.a[..., some], found.b[..., some])) for some in (slice(0, 3), slice(3, 4))
        ]
    change = np.sqrt(((pictures[True] - pictures[False]) ** 2).mean()) / pictures[False].mean()
    print(errors, change)
    return errors, change


@pytest.mark.slow(seconds=60)
@pytest.mark.parametrize("move", [moving_camera, zoom])
def test_pictures_are_as_blurred_as_in_cycles(addon, motion_scene, tmp_path, move):
    move(motion_scene)
    errors, change = errors_against_cycles(motion_scene, tmp_path)
    assert change > 0.15
    for sharp, blurred in zip(errors[False], errors[True]):
        assert blurred < sharp + 0.04
    assert (motion_scene.frame_current, motion_scene.frame_subframe) == (FRAME, 0.0)
