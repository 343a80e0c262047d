# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole Blender programs with the built extension installed, each in a folder of its own."""

import os
import shutil
import subprocess
import textwrap
from pathlib import Path

import pytest

from tests.support.paths import ROOT
from tests.support.programs import BLENDERS

SCENE = """
    import bpy, numpy, pathlib, sys
    folder = pathlib.Path(sys.argv[-1])
    try:
        import openvdb
    except ImportError:
        import pyopenvdb as openvdb
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    grid = openvdb.FloatGrid()
    axis = numpy.linspace(-1, 1, 16)
    radius = numpy.sqrt(sum(a**2 for a in numpy.meshgrid(axis, axis, axis)))
    grid.copyFromArray(numpy.clip(1 - radius, 0, None).astype(numpy.float32), ijk=(-8, -8, -8))
    grid.name, grid.transform = "density", openvdb.createLinearTransform(1 / 8)
    openvdb.write(str(folder / "ball.vdb"), grids=[grid])
    volume = bpy.data.volumes.new("Ball")
    volume.filepath = str(folder / "ball.vdb")
    lens = bpy.data.cameras.new("Camera")
    for name, data in (("Ball", volume), ("Sun", bpy.data.lights.new("Sun", "SUN")), ("Camera", lens)):
        scene.collection.objects.link(bpy.data.objects.new(name, data))
    scene.camera = bpy.data.objects["Camera"]
    scene.camera.location.z = 5
    scene.render.resolution_x = scene.render.resolution_y = 16
    scene.frame_start, scene.frame_end = 1, 2
    scene.mrpnn.depth_samples = 1
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    # Absorbs alone, so that its frames need no network and are there at once.
    absorbing = bpy.data.materials.new("Absorbing")
    absorbing.use_nodes = True
    absorbing.node_tree.nodes.clear()
    output = absorbing.node_tree.nodes.new("ShaderNodeOutputMaterial")
    principled = absorbing.node_tree.nodes.new("ShaderNodeVolumePrincipled")
    principled.inputs["Color"].default_value = (0.0, 0.0, 0.0, 1.0)
    absorbing.node_tree.links.new(principled.outputs["Volume"], output.inputs["Volume"])
    volume.materials.append(absorbing)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "absorbing.blend"), copy=True)
    volume.filepath = str(folder / "gone.vdb")
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "broken.blend"), copy=True)
"""


@pytest.fixture(scope="module", params=BLENDERS, ids=lambda path: Path(path).name)
def program(request, zip_of, tmp_path_factory):
    """blender(*arguments) -> CompletedProcess, the extension installed; blender.folder holds the scenes.

    blender.start(*arguments) gives the running process instead; blender.path and blender.environment are what it runs.
    """
    folder = tmp_path_factory.mktemp("program")
    shutil.copy(zip_of(request.param), folder / "mrpnn.zip")
    shutil.copy(ROOT / "docs" / "use" / "farm" / "mrpnn_script.py", folder)
    # A matrix library's threads that wait for each other take long on a busy machine.
    environment = {**os.environ, "BLENDER_USER_RESOURCES": str(folder / "resources"), "OPENBLAS_NUM_THREADS": "1"}

    def start(*arguments):
        return subprocess.Popen(
            [request.param, *map(str, arguments)],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=folder,
            env=environment,
        )

    def blender(*arguments):
        process = start(*arguments)
        out, error = process.communicate(timeout=300)
        return subprocess.CompletedProcess(arguments, process.returncode, out, error)

    blender.folder, blender.start, blender.path, blender.environment = folder, start, request.param, environment
    installed = blender(
        "--command", "extension", "install-file", "--repo", "user_default", "--enable", folder / "mrpnn.zip"
    )
    assert installed.returncode == 0, installed.stdout + installed.stderr
    (folder / "scene.py").write_text(textwrap.dedent(SCENE))
    made = blender("-b", "--python-exit-code", "1", "--python", folder / "scene.py", "--", folder)
    assert made.returncode == 0, made.stdout + made.stderr
    return blender
