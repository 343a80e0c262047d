# SPDX-License-Identifier: GPL-3.0-or-later
"""The installed extension in whole Blender programs."""

import json
import os
import re
import shutil
import subprocess
import textwrap
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from scipy.ndimage import map_coordinates

from packages import release
from tests.support.programs import BLENDERS, MARKS

pytestmark = MARKS


def test_an_animation_from_the_command_line(program):
    folder = program.folder
    run = program("-b", folder / "scene.blend", "-E", "MRPNN", "-o", folder / "anim_##", "-a")
    assert run.returncode == 0, run.stdout + run.stderr
    assert {path.name for path in folder.glob("anim_*")} == {"anim_01.png", "anim_02.png"}
    # Blender's statistics line, with what is at work and how far it is.
    assert re.search(r"scattering, \d+%\s*$", run.stdout, re.MULTILINE), run.stdout
    assert run.stdout.count("Saved") == 2


TEMPLATES = """
import sys, zipfile
import bpy
packed = sys.argv[-1]
assert bpy.ops.preferences.app_template_install(filepath=packed) == {"FINISHED"}
names = {name.partition("/")[0] for name in zipfile.ZipFile(packed).namelist()}
for name in sorted(names):
    bpy.ops.wm.read_homefile(app_template=name)
    assert bpy.context.scene.render.engine in ("MRPNN", "CYCLES"), (name, bpy.context.scene.render.engine)
    assert bpy.data.volumes or name == "Volumes_Fog_in_a_church", name
    assert all(data.grids.load() for data in bpy.data.volumes), name
bpy.ops.wm.read_homefile(app_template="Volumes_Smoke")
render = bpy.context.scene.render
render.resolution_x, render.resolution_y, render.filepath = 32, 18, packed[:-len(".zip")]
bpy.ops.render.render(write_still=True)
print("opened", len(names), flush=True)
"""


def test_the_gallerys_templates_open_and_render(program, tmp_path):
    pytest.importorskip("bpy")
    names = ["fog", "plume", "milk"]
    packed = release.build_gallery("1.2.3", [*names, "--detail", "0.2"], tmp_path)
    shutil.copy(packed, program.folder / "gallery.zip")
    (program.folder / "templates.py").write_text(TEMPLATES)
    run = program(
        "-b",
        "--python-exit-code",
        "1",
        "--python",
        program.folder / "templates.py",
        "--",
        program.folder / "gallery.zip",
    )
    assert run.returncode == 0 and f"opened {len(names)}" in run.stdout, run.stdout + run.stderr
    with Image.open(program.folder / "gallery.png") as image:
        assert np.asarray(image.convert("L"), float).std() > 5.0


WORKING = """
import bpy, sys, time
name, = [name for name in sys.modules if name.endswith(".mrpnn.mrpnn_addon.runtime.background")]
class Endless(sys.modules[name].Worker):
    def _work(self):
        while not self.stopped:
            time.sleep(0.01)
        print("ended", flush=True)
worker = Endless()
worker._start("mrpnn test", awaited=AWAITED)
"""


@pytest.mark.parametrize("awaited", [True, False])
def test_quitting_ends_all_threads(program, awaited):
    run = program("-b", "--python-expr", WORKING.replace("AWAITED", str(awaited)))
    assert run.returncode == 0 and "ended" in run.stdout.splitlines(), run.stdout + run.stderr


UPDATE = """
import importlib
name = name.replace("mrpnn_addon.runtime.background", "inference.kernels.library")
path = str(importlib.import_module(name).load_kernels().path)
mapped = lambda: path in open("/proc/self/maps").read()
assert mapped()
done = bpy.ops.extensions.package_install_files(
    filepath=sys.argv[-1], repo="user_default", enable_on_install=True, overwrite=True)
assert done == {"FINISHED"} and worker.done and not mapped()
assert str(importlib.import_module(name).load_kernels().path) == path and mapped()
print("updated")
"""


def test_an_update_ends_threads_and_gives_the_kernels_library_back(program):
    """So that Windows can replace it."""
    script = WORKING.replace("AWAITED", "True") + UPDATE
    run = program("-b", "--python-exit-code", "1", "--python-expr", script, "--", program.folder / "mrpnn.zip")
    assert run.returncode == 0 and "updated" in run.stdout, run.stdout + run.stderr


@pytest.mark.parametrize("frames", [("-a",), ("-f", "1..2")])
def test_an_animation_without_its_volume_goes_on_and_says_so(program, frames):
    folder = program.folder
    run = program("-b", folder / "broken.blend", "-E", "MRPNN", "-o", folder / f"broken{len(frames)}_##", *frames)
    said = run.stdout + run.stderr
    assert run.returncode == 0, said
    assert 'volume "Ball": file not found' in said and "frame 2" in said
    assert len(list(folder.glob(f"broken{len(frames)}_*"))) == 2


@pytest.mark.parametrize("how", ["command", "script"])
def test_the_command_writes_frames_report_and_status(program, how):
    folder = program.folder
    start = {"command": ("--command", "mrpnn"), "script": ("--python", folder / "mrpnn_script.py", "--")}[how]
    run = program(
        "-b",
        folder / "absorbing.blend",
        *start,
        "render",
        "--output",
        f"//{how}/##.exr",
        "--frames",
        "1-2",
        "--json",
        folder / f"{how}.json",
        "--progress",
        "json",
    )
    assert run.returncode == 0, run.stdout + run.stderr
    assert {path.name for path in (folder / how).iterdir()} == {"01.exr", "02.exr"}
    report = json.loads((folder / f"{how}.json").read_text())
    assert [frame["frame"] for frame in report["frames"]] == [1, 2] and report["error"] is None
    events = [json.loads(line) for line in run.stdout.splitlines() if line.startswith('{"event"')]
    assert events[-1]["event"] == "end" and events[-1]["status"] == 0

    run = program("-b", folder / "broken.blend", *start, "render", "--output", folder / f"{how}_broken.exr")
    assert run.returncode == 1 and "file not found" in run.stdout + run.stderr, run.stdout + run.stderr
    assert "Traceback" not in run.stderr and not (folder / f"{how}_broken.exr").exists()


COMPOSITE = """
    import bpy, numpy, sys
    folder = sys.argv[-1]
    scene = bpy.context.scene
    output = scene.render.image_settings
    if hasattr(output, "media_type"):
        output.media_type = 'IMAGE'
    output.file_format, output.color_depth, output.color_mode = 'OPEN_EXR', '32', 'RGBA'
    scene.view_layers[0].update()
    assert bpy.ops.mrpnn.composite(shadows=False) == {'FINISHED'}
    scene.cycles.samples, scene.cycles.use_denoising = 1, False
    # The scene of the volumes follows, though nothing updates in between.
    scene.render.resolution_x, scene.render.resolution_y = 20, 12

    def rendered(scene, name):
        scene.render.filepath = f"{folder}/{name}.exr"
        bpy.ops.render.render(scene=scene.name, write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        pixels = numpy.empty(20 * 12 * 4, numpy.float32)
        image.pixels.foreach_get(pixels)
        return pixels.reshape(-1, 4)[:, :3]

    over, alone = rendered(scene, "composite"), rendered(bpy.data.scenes["Scene MRPNN"], "layer")
    assert alone.max() > 0.01
    # Over nothing, in a scene without a World.
    numpy.testing.assert_allclose(over, alone, rtol=1e-3, atol=1e-5)
    print("composed")
"""


def test_composite_over_cycles_works_in_this_versions_compositor(program):
    folder = program.folder
    (folder / "composite.py").write_text(textwrap.dedent(COMPOSITE))
    run = program(
        "-b", folder / "scene.blend", "--python-exit-code", "1", "--python", folder / "composite.py", "--", folder
    )
    assert run.returncode == 0 and "composed" in run.stdout, run.stdout + run.stderr


def test_a_killed_render_leaves_no_half_file(program):
    folder = program.folder
    process = program.start(
        "-b",
        folder / "scene.blend",
        "--command",
        "mrpnn",
        "render",
        "--output",
        folder / "killed.exr",
        "--depth-samples",
        "256",
        "--resolution-percentage",
        "3000",
        "--memory-limit",
        "64",
        "--threads",
        "1",
    )
    for line in process.stdout:
        if line.startswith("mrpnn:"):
            break
    process.kill()
    process.communicate()
    assert not list(folder.glob("killed*"))


FLUID = """
    import importlib, json, pathlib, sys, tempfile
    import bpy, numpy
    folder = pathlib.Path(sys.argv[-1])
    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.mesh.primitive_cube_add(size=2, location=(1, 2, 3), scale=(1, 0.75, 1.5))
    domain = bpy.context.object
    domain.name = "Domain"
    modifier = domain.modifiers.new("Fluid", 'FLUID')
    modifier.fluid_type = 'DOMAIN'
    settings = modifier.domain_settings
    settings.domain_type, settings.resolution_max = 'GAS', 32
    settings.cache_type, settings.cache_directory = 'REPLAY', tempfile.mkdtemp(dir=folder)
    settings.cache_frame_start, settings.cache_frame_end = 1, 12
    # Low, to the right and in front: nothing about where the smoke is can be mistaken.
    bpy.ops.mesh.primitive_ico_sphere_add(radius=0.25, location=(1.4, 1.7, 2.2))
    source = bpy.context.object
    source.hide_render = True
    flow = source.modifiers.new("Fluid", 'FLUID')
    flow.fluid_type = 'FLOW'
    flow.flow_settings.flow_type, flow.flow_settings.flow_behavior = 'SMOKE', 'INFLOW'
    material = bpy.data.materials.new("Smoke")
    material.use_nodes = True
    material.node_tree.nodes.clear()
    shader = material.node_tree.nodes.new("ShaderNodeVolumePrincipled")
    output = material.node_tree.nodes.new("ShaderNodeOutputMaterial")
    material.node_tree.links.new(shader.outputs[0], output.inputs["Volume"])
    shader.inputs["Density"].default_value = 2.0
    domain.data.materials.append(material)
    camera = bpy.data.cameras.new("Camera")
    camera.type, camera.ortho_scale = 'ORTHO', 4.0
    for name, data in (("Sun", bpy.data.lights.new("Sun", 'SUN')), ("Camera", camera)):
        scene.collection.objects.link(bpy.data.objects.new(name, data))
    scene.camera = bpy.data.objects["Camera"]
    scene.camera.location, scene.camera.rotation_euler = (1, -5, 3), (numpy.pi / 2, 0, 0)
    scene.render.resolution_x = scene.render.resolution_y = 48
    scene.mrpnn.depth_samples = 1
    extension = next(name for name in bpy.context.preferences.addons.keys() if name.endswith(".mrpnn"))
    read_scene = importlib.import_module(extension + ".mrpnn_addon.scene.reader").read_scene
    inference = importlib.import_module(extension + ".inference")
    found = {}
    for frame in range(1, 11):
        scene.frame_set(frame)
        depsgraph = bpy.context.evaluated_depsgraph_get()
        if frame in (6, 10):
            described = read_scene(depsgraph)
            settings = inference.Settings(multiple=False)
            layer = inference.render(described.volumes, described.suns, described.camera, settings)
            evaluated = domain.evaluated_get(depsgraph).modifiers["Fluid"].domain_settings
            x, y, z = evaluated.domain_resolution
            density = numpy.array(evaluated.density_grid).reshape(z, y, x)
            # Along y, through voxels whose edges the domain's give.
            depth = 2.0 * density.sum(axis=1) * 1.5 / y
            numpy.savez(folder / f"smoke{frame}.npz", alpha=layer.alpha, depth=depth)
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "smoke.blend"))
"""


@pytest.fixture(scope="module")
def smoke(zip_of, tmp_path_factory):
    """Folder with a fluid simulation baked by the first Blender that can; some builds crash."""
    folder, said = tmp_path_factory.mktemp("smoke"), []
    (folder / "smoke.py").write_text(textwrap.dedent(FLUID))
    for path in BLENDERS:
        shutil.copy(zip_of(path), folder / "mrpnn.zip")
        environment = {
            **os.environ,
            "BLENDER_USER_RESOURCES": str(folder / Path(path).name),
            "OPENBLAS_NUM_THREADS": "1",
        }
        for arguments in (
            ("--command", "extension", "install-file", "--repo", "user_default", "--enable", folder / "mrpnn.zip"),
            ("-b", "--python-exit-code", "1", "--python", folder / "smoke.py", "--", folder),
        ):
            run = subprocess.run(
                [path, *map(str, arguments)], capture_output=True, text=True, env=environment, timeout=300
            )
        if run.returncode == 0 and "Fatal" not in run.stderr:
            return folder
        said.append(run.stdout[-2000:] + run.stderr[-2000:])
    pytest.fail("no Blender can simulate smoke:\n" + "\n".join(said))


@pytest.mark.parametrize("frame", [6, 10])
def test_simulated_smoke_matches_its_domain(smoke, frame):
    """Seen along an axis of the domain, against sums over its voxels: position, scale, density and frame."""
    with np.load(smoke / f"smoke{frame}.npz") as found:
        alpha, depth = found["alpha"], found["depth"]
    # The view shows 4 x 4 units; the domain is 2 wide and 3 high in its middle.
    place = (np.arange(48) + 0.5) / 12.0
    x, z = (place - 1.0) / 2.0 * depth.shape[1] - 0.5, (3.5 - place) / 3.0 * depth.shape[0] - 0.5
    beside = -np.expm1(-map_coordinates(depth, np.meshgrid(z, x, indexing="ij"), order=1, mode="constant"))
    assert beside.max() > 0.3
    np.testing.assert_allclose(alpha, beside, atol=0.02)
    assert alpha.mean() == pytest.approx(beside.mean(), rel=0.01)


def test_smoke_is_not_kept_from_the_previous_frame(smoke):
    first, second = (np.load(smoke / f"smoke{frame}.npz")["alpha"] for frame in (6, 10))
    assert np.abs(first - second).max() > 0.1


def test_the_command_bakes_light_that_a_saved_file_shows(program):
    folder = program.folder
    run = program("-b", folder / "scene.blend", "--command", "mrpnn", "bake", "--save", folder / "lit.blend")
    assert run.returncode == 0, run.stdout + run.stderr
    check = folder / "check.py"
    check.write_text(
        textwrap.dedent("""
        import bpy
        [light] = [shown for shown in bpy.data.objects if "mrpnn_light" in shown]
        assert light.data.grids.load(), light.data.grids.error_message
        assert {grid.name for grid in light.data.grids} >= {"light", "light_smooth0"}
        assert bpy.context.scene.cycles.volume_bounces == 0
        assert bpy.ops.mrpnn.bake_light_remove() == {"FINISHED"}
        print("removed")
        """)
    )
    run = program("-b", folder / "lit.blend", "--python-exit-code", "1", "--python", check)
    assert run.returncode == 0 and "removed" in run.stdout, run.stdout + run.stderr
