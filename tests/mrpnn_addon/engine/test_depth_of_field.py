# SPDX-License-Identifier: GPL-3.0-or-later
"""Depth of field as in Cycles."""

import importlib

import bpy
import numpy as np
import pytest

from tests.support import blender_scenes as make

SIZE = 48


def thin_cloud(scene, folder, place=(0.0, 0.0, 0.0), seed=3):
    cloud, _ = make.add_volume(
        scene,
        make.write_vdb(folder, make.blob(16, seed), make.centred(16, 1.2)),
        Density=2.0,
        Color=(0.5, 0.5, 0.5, 1.0),
        Anisotropy=0.0,
    )
    cloud.location = place
    return cloud


def out_of_focus(scene, folder):
    """One cloud behind what is sharp."""
    return [thin_cloud(scene, folder)]


def orthographic(scene, folder):
    scene.camera.data.type, scene.camera.data.ortho_scale = "ORTHO", 2.0
    scene.camera.data.dof.aperture_fstop = 1.0
    return out_of_focus(scene, folder)


@pytest.fixture
def lens_scene(scene):
    """A scene with a sun and a camera that has blades and a ratio, and focuses on an object 3 units away."""
    make.add_sun(scene, strength=3.0)
    camera = make.add_camera(scene, location=(0.0, 0.0, 4.5))
    camera.data.angle = 0.5
    dof = camera.data.dof
    dof.use_dof, dof.aperture_fstop = True, 0.05
    dof.aperture_blades, dof.aperture_rotation, dof.aperture_ratio = 5, 0.3, 1.5
    dof.focus_object = make.add_object(scene, "Focus", None)
    dof.focus_object.location = (1.0, 0.0, 1.5)
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.engine = "MRPNN"
    # The aperture is so wide that fewer rays leave noise.
    scene.mrpnn.blur_rays = 16
    return scene


def error(layer, halves):
    """Relative RMSE of a layer against two independent halves, without their noise."""
    a, b = (half.astype(np.float64) for half in halves)
    mean = 0.5 * (a + b).mean()
    return np.sqrt(max(((layer - a) * (layer - b)).mean(), 0.0)) / mean


@pytest.mark.slow(seconds=60)
@pytest.mark.parametrize("build", [out_of_focus, orthographic])
def test_clouds_are_as_blurred_as_in_cycles(addon, lens_scene, tmp_path, build):
    reference = importlib.import_module("mrpnn.mrpnn_addon.cycles.reference")
    objects = [*build(lens_scene, tmp_path), bpy.data.objects["Sun"]]
    errors, pictures = {}, {}
    for blurred in (False, True):
        lens_scene.camera.data.dof.use_dof = blurred
        layer = make.rendered(lens_scene, tmp_path)
        found = reference.render_reference(lens_scene, objects, reference.PathTracing(samples=128, box_filter=True))
        errors[blurred] = [
            error(layer[..., some], (found.a[..., some], found.b[..., some])) for some in (slice(0, 3), slice(3, 4))
        ]
        pictures[blurred] = layer
    # The lens does something.
    assert np.sqrt(((pictures[True] - pictures[False]) ** 2).mean()) > 0.2 * pictures[False].mean()
    for sharp, blurred in zip(errors[False], errors[True]):
        assert blurred < sharp + 0.06
