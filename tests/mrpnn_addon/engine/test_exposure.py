# SPDX-License-Identifier: GPL-3.0-or-later
"""*Film > Exposure* scales what it scales in Cycles, once, through every door."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes
from tests.support.exr_files import channels

EXPOSURE = 2.5


@pytest.fixture
def lit(scene, tmp_path):
    """A glowing cloud with a light group, before a grey World."""
    scene.render.resolution_x, scene.render.resolution_y = 16, 12
    scene.mrpnn.depth_samples = 1
    cloud = blender_scenes.cloud_scene(scene, tmp_path)
    shader = cloud.data.materials[0].node_tree.nodes["Principled Volume"]
    shader.inputs["Emission Strength"].default_value = 0.2
    scene.world.node_tree.nodes["Background"].inputs["Strength"].default_value = 0.3
    layer = scene.view_layers[0]
    layer.lightgroups.add(name="key")
    scene.objects["Sun"].lightgroup = "key"
    layer.use_pass_z = layer.use_pass_emit = True
    layer.cycles.use_pass_volume_direct = layer.cycles.use_pass_volume_indirect = True
    for name in ("volume_direct", "volume_indirect", "emission", "uncertainty"):
        setattr(layer.mrpnn, f"use_pass_{name}", True)
    blender_scenes.set_up_cycles(scene, samples=4, bounces=2)
    blender_scenes.write_multilayer(scene)
    return scene


def passes(scene, folder, engine, exposure, transparent=False):
    """Means of the passes that an engine's render writes, by name."""
    scene.render.engine, scene.cycles.film_exposure = engine, exposure
    scene.render.film_transparent = transparent
    scene.render.filepath = str(folder / f"{engine}{exposure}.exr")
    bpy.ops.render.render(write_still=True)
    return {
        name.removeprefix("ViewLayer."): np.mean(pixels, dtype=float)
        for name, pixels in channels(scene.render.filepath).items()
    }


def test_it_scales_the_passes_that_it_scales_in_cycles(addon, lit, tmp_path):
    scaled = {}
    for engine in ("CYCLES", "MRPNN"):
        before, after = (passes(lit, tmp_path, engine, exposure) for exposure in (1.0, EXPOSURE))
        scaled[engine] = {name: after[name] / value for name, value in before.items() if value}
    shared = scaled["CYCLES"].keys() & scaled["MRPNN"].keys()
    assert len(shared) >= 16 and {"Combined.R", "Combined.A", "Combined_key.R", "Depth.Z"} <= shared
    for name in shared:
        assert scaled["MRPNN"][name] == pytest.approx(scaled["CYCLES"][name], rel=1e-3), name
    assert scaled["MRPNN"]["Uncertainty.X"] == pytest.approx(EXPOSURE, rel=1e-3)


@pytest.mark.slow
def test_render_volumes_the_composite_and_reference_have_it_and_baked_light_has_not(addon, lit, tmp_path):
    reader, layers, baked = addon.mrpnn_addon.scene.reader, [], []
    for exposure in (1.0, EXPOSURE):
        lit.cycles.film_exposure = exposure
        description = reader.read_scene(blender_scenes.depsgraph())
        baked += addon.inference.bake(description.volumes, description.lights, description.camera, lit.mrpnn.settings())
        bpy.ops.mrpnn.render()
        layers.append(np.array(bpy.data.images["MRPNN"].pixels).reshape(12, 16, 4))
    np.testing.assert_allclose(layers[1][..., :3], EXPOSURE * layers[0][..., :3], rtol=1e-5)
    np.testing.assert_array_equal(layers[1][..., 3], layers[0][..., 3])
    np.testing.assert_array_equal(baked[1].scattered, baked[0].scattered)
    with addon.mrpnn_addon.cycles.reference_scene.view_scene(
        lit, [], addon.mrpnn_addon.cycles.reference_scene.PathTracing(1)
    ) as reference:
        assert reference.cycles.film_exposure == EXPOSURE
    bpy.ops.mrpnn.composite(shadows=False)
    lit.cycles.film_exposure = 0.5
    addon.mrpnn_addon.output.composite.synchronize(lit)
    assert lit.mrpnn_composite.volumes.cycles.film_exposure == 0.5


def test_it_scales_a_world_that_cycles_renders(addon, lit, tmp_path):
    """Behind the volumes and in rendered viewports."""
    tree = lit.world.node_tree
    checker = tree.nodes.new("ShaderNodeTexChecker")
    tree.links.new(checker.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    film, pictures = addon.mrpnn_addon.scene.film, []
    for exposure in (1.0, EXPOSURE):
        lit.cycles.film_exposure = exposure
        graph = blender_scenes.depsgraph()
        camera = addon.mrpnn_addon.objects.camera.read_camera(graph)[0]
        pictures.append(film.read_background(graph, camera).pixels())
    assert np.ptp(pictures[0]) > 0.0
    np.testing.assert_allclose(pictures[1], EXPOSURE * pictures[0], rtol=1e-5)
