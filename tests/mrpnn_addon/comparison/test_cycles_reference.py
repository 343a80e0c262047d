# SPDX-License-Identifier: GPL-3.0-or-later
"""The Cycles reference: closed forms, and the user's file left as it was."""

import importlib

import bpy
import numpy as np
import pytest

from inference import SceneError
from tests.support import blender_scenes as make
from tests.support.file_state import state_of_file

CELLS = 32


@pytest.fixture
def reference(addon):
    return importlib.import_module("mrpnn.mrpnn_addon.cycles.reference")


@pytest.fixture
def box_scene(scene, tmp_path):
    """A box of edge 1, density 1, seen from above by a small orthographic camera; gives (scene, shader, objects)."""
    path = make.write_vdb(tmp_path, np.ones((CELLS,) * 3), make.centred(CELLS, 1.0))
    box, shader = make.add_volume(scene, path, Density=1.5, Color=(0.01, 0.01, 0.01, 1.0), Anisotropy=0.3)
    sun = make.add_sun(scene, strength=2.0, rotation=(0.0, 0.0, 0.0))
    make.add_camera(scene, location=(0.0, 0.0, 3.0), ortho_scale=0.5)
    scene.render.resolution_x = scene.render.resolution_y = 8
    return scene, shader, [box, sun]


@pytest.mark.parametrize("anisotropy", [*(pytest.param(g, marks=pytest.mark.slow) for g in (-0.4, 0.0, 0.7)), 0.3])
def test_single_scattering_of_a_slab_lit_from_the_camera_is_the_closed_form(reference, box_scene, anisotropy):
    scene, shader, objects = box_scene
    density, albedo, irradiance = 1.5, 0.01, 2.0
    shader.inputs["Anisotropy"].default_value = anisotropy
    rendered = reference.render_reference(scene, objects, reference.PathTracing(samples=64))
    # Backscattering: the cosine between camera ray and direction to the sun is -1.
    phase = (1 - anisotropy**2) / (4 * np.pi * (1 + anisotropy**2 + 2 * anisotropy) ** 1.5)
    expected = albedo * phase * irradiance * (1 - np.exp(-2 * density)) / 2
    for half in (rendered.a, rendered.b):
        # Light scattered twice adds at most about the albedo, 1 %.
        assert half[..., :3].mean() == pytest.approx(expected, rel=0.02)
        assert half[..., 3].mean() == pytest.approx(1 - np.exp(-density), abs=0.01)


def test_the_halves_are_independent_and_a_third_seed_differs(reference, box_scene):
    scene, shader, objects = box_scene
    shader.inputs["Color"].default_value = (0.95, 0.95, 0.95, 1.0)
    scene.render.resolution_x = scene.render.resolution_y = 32
    rendered = reference.render_reference(scene, objects, reference.PathTracing(samples=4))
    other = reference.render_reference(scene, objects, reference.PathTracing(samples=4), seed=1)
    again = reference.render_reference(scene, objects, reference.PathTracing(samples=4))
    assert np.array_equal(rendered.a, again.a) and np.array_equal(rendered.b, again.b)
    images = [image[..., 0].ravel() for image in (rendered.a, rendered.b, other.a, other.b)]
    # The view is uniform, so whatever varies is noise; independent noise does not correlate.
    correlation = np.corrcoef(images)
    assert np.abs(correlation[~np.eye(4, dtype=bool)]).max() < 4 / np.sqrt(images[0].size)


@pytest.mark.slow
def test_bright_multiple_scattering_is_neither_truncated_nor_clamped(reference, box_scene):
    """A dense white box under the sun returns most of its light only after many bounces."""
    scene, shader, objects = box_scene
    shader.inputs["Density"].default_value = 60.0
    shader.inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
    shader.inputs["Anisotropy"].default_value = 0.0
    objects[1].data.energy = 100.0
    scene.cycles.max_bounces = scene.cycles.volume_bounces = 0
    full = reference.render_reference(scene, objects, reference.PathTracing(samples=8))
    short = reference.render_reference(scene, objects, reference.PathTracing(samples=8, bounces=4))
    # A half space of this kind reflects all light; a Lambertian one would show E / pi.
    assert full.a[..., :3].mean() > 0.7 * 100.0 / np.pi
    assert short.a[..., :3].mean() < 0.7 * full.a[..., :3].mean()


def test_rows_start_at_the_top_and_rays_pass_through_pixel_centres(reference, box_scene):
    scene, _, objects = box_scene
    scene.camera.data.ortho_scale = 4.0
    # The box spans world y 0.6 to 1.6 of a view from -2 to 2 in 8 rows: it covers the upper four
    # fifths of row 2 (counted from the top), all of row 1 and the lowest fifth of row 0.
    objects[0].location.y = 1.1
    alpha = reference.render_reference(scene, objects, reference.PathTracing(samples=64)).a[..., 3]
    inside = np.zeros((8, 8), bool)
    inside[1:3, 3:5] = True
    assert alpha[inside] == pytest.approx(1 - np.exp(-1.5), abs=0.05)
    assert (alpha[~inside] == 0.0).all()


def test_region_gives_an_image_of_the_region(reference, box_scene):
    scene, _, objects = box_scene
    render = scene.render
    scene.camera.data.ortho_scale = 4.0
    objects[0].location.y = 1.0
    render.use_border, render.use_crop_to_border = True, False
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.75, 0.5, 1.0
    alpha = reference.render_reference(scene, objects, reference.PathTracing(samples=4)).a[..., 3]
    assert alpha.shape == (4, 4)
    assert (alpha[1:3, 1:3] > 0.3).all() and (alpha[0] == 0.0).all() and (alpha[3] == 0.0).all()


def test_only_the_given_objects_are_shown(reference, box_scene):
    scene, _, objects = box_scene
    wall = make.add_object(scene, "wall", bpy.data.meshes.new("wall"))
    wall.data.from_pydata([(-9, -9, 1), (9, -9, 1), (9, 9, 1), (-9, 9, 1)], [], [(0, 1, 2, 3)])
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 5.0
    alpha = reference.render_reference(scene, objects, reference.PathTracing(samples=64)).a[..., 3]
    assert alpha.mean() == pytest.approx(1 - np.exp(-1.5), abs=0.02)


@pytest.mark.slow
def test_depth_of_field_is_that_of_the_scene(reference, box_scene):
    scene, _, objects = box_scene
    scene.camera.data.type = "PERSP"
    scene.camera.data.lens = 200.0
    scene.camera.data.dof.use_dof = True
    scene.camera.data.dof.focus_distance = 0.1
    scene.camera.data.dof.aperture_fstop = 0.01
    blurred = reference.render_reference(scene, objects, reference.PathTracing(samples=16)).a
    scene.camera.data.dof.use_dof = False
    sharp = reference.render_reference(scene, objects, reference.PathTracing(samples=16)).a
    # The sharp box fills the frame; with so wide an aperture most rays pass beside it.
    assert sharp[..., 3].mean() == pytest.approx(1 - np.exp(-1.5), abs=0.03)
    assert blurred[..., 3].mean() < 0.5 * sharp[..., 3].mean()


def test_the_file_is_left_as_it_was(reference, box_scene):
    scene, _, objects = box_scene
    scene.world = None
    scene.cycles.samples, scene.cycles.seed = 7, 99
    scene.render.engine = "BLENDER_WORKBENCH"
    before = state_of_file()
    reference.render_reference(scene, objects, reference.PathTracing(samples=1))
    assert state_of_file() == before


def test_the_file_is_left_as_it_was_after_cancelling(reference, box_scene):
    scene, _, objects = box_scene
    before = state_of_file()

    def stop(fraction, text):
        if fraction > 0.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        reference.render_reference(scene, objects, reference.PathTracing(samples=1), progress=stop)
    assert state_of_file() == before


def test_a_scene_without_camera_is_refused_by_name(reference, box_scene):
    scene, _, objects = box_scene
    scene.camera = None
    before = state_of_file()
    with pytest.raises(SceneError, match="no active camera"):
        reference.render_reference(scene, objects)
    assert state_of_file() == before


def test_this_blender_renders_the_test_box_and_a_wrong_alpha_would_be_refused(reference, addon):
    assert reference.check_homogeneous_box() == pytest.approx(1 - np.exp(-1.5), abs=0.005)
    with pytest.raises(SceneError, match="does not render volumes correctly"):
        reference.require_box_alpha(0.05)
    with pytest.raises(SceneError, match="does not render volumes correctly"):
        reference.require_box_alpha(float("nan"))


def test_a_library_that_blender_lacks_is_named(addon, scene, tmp_path):
    """As OpenImageDenoise in builds of some distributions; no text of Python's reaches the comparison."""
    worker = importlib.import_module("mrpnn.mrpnn_addon.cycles.worker")
    ask = {"scene": scene.name, "settings": {"denoiser": "NONESUCH"}}
    with pytest.raises(RuntimeError, match="^this Blender was built without NONESUCH$"):
        worker.render(ask, str(tmp_path / "none.exr"))
