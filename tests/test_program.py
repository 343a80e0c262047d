"""The installed extension in a Blender program, which the bpy module is not: named by MRPNN_BLENDER.

Installs the built zip into a folder of its own and uses it as a farm would.
"""

import json
import os
import shutil
import subprocess
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BLENDER = os.environ.get("MRPNN_BLENDER")

pytestmark = pytest.mark.skipif(not BLENDER, reason="MRPNN_BLENDER names no Blender program")

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
    volume.filepath = str(folder / "gone.vdb")
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "broken.blend"), copy=True)
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """blender(*arguments) -> CompletedProcess, the extension installed; blender.folder holds the scenes."""
    import build_extension

    folder = tmp_path_factory.mktemp("program")
    (package,) = [path for path in build_extension.build() if "linux_x64" in path.name]
    shutil.copy(package, folder / "mrpnn.zip")
    shutil.copy(ROOT / "docs" / "farm" / "mrpnn_script.py", folder)

    def blender(*arguments):
        return subprocess.run(
            [BLENDER, *map(str, arguments)], capture_output=True, text=True, timeout=300, cwd=folder,
            env={**os.environ, "BLENDER_USER_RESOURCES": str(folder / "resources")})

    blender.folder = folder
    installed = blender("--command", "extension", "install-file", "--repo", "user_default", "--enable",
                        folder / "mrpnn.zip")
    assert installed.returncode == 0, installed.stdout + installed.stderr
    (folder / "scene.py").write_text(textwrap.dedent(SCENE))
    made = blender("-b", "--python-exit-code", "1", "--python", folder / "scene.py", "--", folder)
    assert made.returncode == 0, made.stdout + made.stderr
    return blender


def test_an_animation_from_the_command_line(program):
    folder = program.folder
    run = program("-b", folder / "scene.blend", "-E", "MRPNN", "-o", folder / "anim_##", "-a")
    assert run.returncode == 0, run.stdout + run.stderr
    assert {path.name for path in folder.glob("anim_*")} == {"anim_01.png", "anim_02.png"}
    assert "Remaining" in run.stdout or "scattering of Ball" in run.stdout or run.stdout.count("Saved") == 2


@pytest.mark.parametrize("frames", [("-a",), ("-f", "1..2")])
def test_a_mistake_is_exit_status_1_and_no_file(program, frames):
    folder = program.folder
    run = program("-b", folder / "broken.blend", "-E", "MRPNN", "-o", folder / "broken_##", *frames)
    assert run.returncode == 1, run.stdout + run.stderr
    assert "Volume object \"Ball\": file not found" in run.stdout + run.stderr
    assert not list(folder.glob("broken_*"))


@pytest.mark.parametrize("how", ["command", "script"])
def test_the_command_writes_frames_report_and_status(program, how):
    folder = program.folder
    start = {"command": ("--command", "mrpnn"), "script": ("--python", folder / "mrpnn_script.py", "--")}[how]
    run = program("-b", folder / "scene.blend", *start, "render", "--output", f"//{how}/##.exr", "--frames", "1-2",
                  "--json", folder / f"{how}.json", "--progress", "json")
    assert run.returncode == 0, run.stdout + run.stderr
    assert {path.name for path in (folder / how).iterdir()} == {"01.exr", "02.exr"}
    report = json.loads((folder / f"{how}.json").read_text())
    assert [frame["frame"] for frame in report["frames"]] == [1, 2] and report["error"] is None
    events = [json.loads(line) for line in run.stdout.splitlines() if line.startswith("{\"event\"")]
    assert events[-1]["event"] == "end" and events[-1]["status"] == 0

    run = program("-b", folder / "broken.blend", *start, "render", "--output", folder / f"{how}_broken.exr")
    assert run.returncode == 1 and "file not found" in run.stdout + run.stderr, run.stdout + run.stderr
    assert "Traceback" not in run.stderr and not (folder / f"{how}_broken.exr").exists()


# What Flamenco's Manager gives a job type, and what its Worker runs for each command.
COMPILE = """
    const author = {
        Task: name => ({name, commands: [], addCommand(command) { this.commands.push(command); }}),
        Command: (name, parameters) => ({name, parameters}),
    };
    const frameChunker = (frames, size) => ["1", "2"];
    const tasks = [];
    eval(require("fs").readFileSync(process.argv[2], "utf8") + ";compileJob(job);JOB_TYPE");
"""


@pytest.mark.skipif(not shutil.which("node"), reason="needs node to run the job type")
def test_the_flamenco_job_type_s_tasks_render_their_chunks(program):
    folder = program.folder
    settings = {"frames": "1-2", "chunk_size": 1, "output": str(folder / "farm" / "######.exr"),
                "skip_existing": True, "blendfile": str(folder / "scene.blend")}
    job = "const job = {settings: %s, addTask(task) { tasks.push(task); }};" % json.dumps(settings)
    (folder / "compile.js").write_text(job + textwrap.dedent(COMPILE) + "console.log(JSON.stringify(tasks));")
    compiled = subprocess.run(
        ["node", folder / "compile.js", ROOT / "docs" / "farm" / "mrpnn_render.js"], capture_output=True, text=True)
    assert compiled.returncode == 0, compiled.stderr
    tasks = json.loads(compiled.stdout)
    assert [task["name"] for task in tasks] == ["render-1", "render-2"]
    for task in tasks:
        (command,) = task["commands"]
        given = command["parameters"]
        assert command["name"] == "blender-render" and given["exe"] == "{blender}"
        run = program("-b", "-y", *given["argsBefore"], given["blendfile"], *given["args"])
        assert run.returncode == 0 and "Saved: '" in run.stdout, run.stdout + run.stderr
    assert {path.name for path in (folder / "farm").iterdir()} == {"000001.exr", "000002.exr"}
    again = program("-b", "-y", given["blendfile"], *given["args"])
    assert again.returncode == 0 and "is there already" in again.stdout


def test_a_killed_render_leaves_no_half_file(program):
    folder = program.folder
    process = subprocess.Popen(
        [BLENDER, "-b", folder / "scene.blend", "--command", "mrpnn", "render", "--output", folder / "killed.exr",
         "--depth-samples", "256", "--resolution-percentage", "3000", "--memory-limit", "64", "--threads", "1"],
        stdout=subprocess.PIPE, text=True, env={**os.environ, "BLENDER_USER_RESOURCES": str(folder / "resources")})
    for line in process.stdout:
        if line.startswith("mrpnn:"):
            break
    process.kill()
    process.wait()
    process.stdout.close()
    assert not list(folder.glob("killed*"))
