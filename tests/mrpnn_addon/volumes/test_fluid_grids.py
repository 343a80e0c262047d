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
    assert shaded.density.shape == (21, 21, 21)
