# SPDX-License-Identifier: GPL-3.0-or-later
"""Grids of a fluid domain, against integrals in closed form. The bpy module cannot simulate: see test_programs.py."""

import numpy as np
import pytest

bpy = pytest.importorskip("bpy")

from tests.support import blender_scenes


def test_a_texture_on_a_coarse_domain_is_evaluated_on_finer_voxels(addon, scene):
    """Smoke of density 1 in the domain, whose Generated coordinates beyond a plane let it through."""
    volumes = addon.mrpnn_addon.volumes
    data = bpy.data.volumes.new("Holder")
    shader = blender_scenes.add_fog(data, "Smoke", "ShaderNodeVolumePrincipled")
    tree = shader.id_data
    coordinates, split = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeSeparateXYZ")
    beyond = tree.nodes.new("ShaderNodeMath")
    beyond.operation = "GREATER_THAN"
    tree.links.new(coordinates.outputs["Generated"], split.inputs[0])
    tree.links.new(split.outputs["X"], beyond.inputs[0])
    tree.links.new(beyond.outputs[0], shader.inputs["Density"])
    # One voxel in each direction from the walls, where the smoke ends, as in every domain.
    smoke = np.zeros((10, 10, 10), np.float32)
    smoke[1:-1, 1:-1, 1:-1] = 1.0
    errors = []
    for plane in np.linspace(0.2, 0.8, 13):
        beyond.inputs[1].default_value = plane
        material = addon.mrpnn_addon.nodes.material.VolumeMaterial(data.materials[0], "Domain")
        probe = volumes.fluid_domain.probe_grids(material, {"density": smoke})
        source = volumes.fluid_domain.FluidSource(
            ("key",), "Domain", material, np.eye(4), {"density": smoke}, np.eye(4), probe
        )
        shaded, object_from_index, _ = source.read()
        found = shaded.density.sum() * abs(np.linalg.det(object_from_index[:3, :3]))
        # The smoke ends in the middle between the walls' voxels and their neighbours.
        errors.append(abs(found - (0.9 - plane) * 0.8**2) / 0.8**2)
    # A voxel is a tenth, and half as much where it is refined.
    assert max(errors) < 0.026
    np.testing.assert_allclose(object_from_index[:3, :3], 0.05 * np.eye(3))


def test_smoke_in_a_part_of_its_domain_keeps_its_place(addon, scene):
    """Amount and centre of smoke and of flames, which lie elsewhere, against sums over the domain's voxels."""
    volumes = addon.mrpnn_addon.volumes
    data = bpy.data.volumes.new("Holder")
    shader = blender_scenes.add_fog(data, "Fire", "ShaderNodeVolumePrincipled")
    shader.inputs["Density"].default_value, shader.inputs["Blackbody Intensity"].default_value = 2.0, 0.0
    shader.inputs["Emission Color"].default_value = (1.0, 0.5, 0.25, 1.0)
    tree = shader.id_data
    flames = tree.nodes.new("ShaderNodeAttribute")
    flames.attribute_name = "flame"
    tree.links.new(flames.outputs["Fac"], shader.inputs["Emission Strength"])
    rng = np.random.default_rng(7)
    smoke, flame = np.zeros((2, 12, 14, 16), np.float32)
    smoke[2:5, 3:6, 7:9], flame[6:8, 3:4, 1:3] = rng.uniform(0.1, 1.0, (3, 3, 2)), 1.0
    material = addon.mrpnn_addon.nodes.material.VolumeMaterial(data.materials[0], "Domain")
    grids, matrix = {"density": smoke, "flame": flame}, np.diag([1.0, 2.0, 3.0, 1.0])
    probe = volumes.fluid_domain.probe_grids(material, grids)
    source = volumes.fluid_domain.FluidSource(("key",), "Domain", material, np.eye(4), grids, matrix, probe)
    shaded, object_from_index, _ = source.read()
    assert shaded.density.size < smoke.size / 4

    def moments(values, matrix):
        index = np.argwhere(values > 0.0)
        centres = index @ matrix[:3, :3].T + matrix[:3, 3]
        amounts = values[values > 0.0] * abs(np.linalg.det(matrix[:3, :3]))
        return np.array([amounts.sum(), *(amounts @ centres)])

    texture_from_index = np.diag([*(1.0 / np.array(smoke.shape)), 1.0])
    texture_from_index[:3, 3] = 0.5 / np.array(smoke.shape)
    whole = np.linalg.inv(matrix) @ texture_from_index
    scale = shaded.sigma_t[0]
    np.testing.assert_allclose(scale * moments(shaded.density, object_from_index), 2.0 * moments(smoke, whole), 1e-3)
    np.testing.assert_allclose(moments(shaded.emission[..., 1], object_from_index), 0.5 * moments(flame, whole), 1e-3)
