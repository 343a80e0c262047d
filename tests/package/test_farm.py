# SPDX-License-Identifier: GPL-3.0-or-later
"""Jobs of render farms, run by the extension in whole Blender programs."""

import json
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import py_mini_racer
import pytest

from tests.support.exr_files import channels
from tests.support.paths import ROOT
from tests.support.programs import MARKS

pytestmark = MARKS

FARM = ROOT / "docs" / "use" / "farm"

# What Flamenco's Manager gives a job type, which its Worker then runs command by command. Frames are cut into
# chunks as it writes them: 1-3, two as 4,5, one as 6.
MANAGER = """
    const tasks = [];
    const author = {
        Task: (name, type) => ({name, type, commands: [], addCommand(command) { this.commands.push(command); }}),
        Command: (name, parameters) => ({name, parameters}),
    };
    function frameChunker(frames, size) {
        const [first, last] = frames.split("-").map(Number), chunks = [];
        for (let a = first; a <= last; a += size) {
            const b = Math.min(a + size - 1, last);
            chunks.push(a === b ? `${a}` : b === a + 1 ? `${a},${b}` : `${a}-${b}`);
        }
        return chunks;
    }
"""


def compiled_tasks(settings):
    """The tasks that the job type compiles from a job's settings; missing ones take its defaults."""
    engine = py_mini_racer.MiniRacer()
    engine.eval(textwrap.dedent(MANAGER) + (ROOT / "docs" / "use" / "farm" / "mrpnn_render.js").read_text())
    found = json.loads(engine.eval("JSON.stringify(JOB_TYPE.settings)"))
    assert set(settings) <= {setting["key"] for setting in found}
    defaults = {setting["key"]: setting["default"] for setting in found if "default" in setting}
    job = json.dumps({**defaults, **settings})
    return json.loads(
        engine.eval(f"compileJob({{settings: {job}, addTask(task) {{ tasks.push(task); }}}}); JSON.stringify(tasks)")
    )


def test_the_flamenco_job_types_tasks_render_their_chunks(program):
    folder = program.folder
    tasks = compiled_tasks(
        {
            "frames": "1-5",
            "chunk_size": 3,
            "blendfile": str(folder / "absorbing.blend"),
            "output": str(folder / "farm" / "######.exr"),
        }
    )
    assert [(task["name"], task["type"]) for task in tasks] == [("render-1-3", "blender"), ("render-4,5", "blender")]
    for task in tasks:
        (command,) = task["commands"]
        given = command["parameters"]
        # Flamenco's own values of these variables.
        assert (command["name"], given["exe"], given["exeArgs"]) == ("blender-render", "{blender}", "{blenderArgs}")
        run = program("-b", "-y", *given["argsBefore"], given["blendfile"], *given["args"])
        assert run.returncode == 0 and run.stdout.count("Saved: '") in (2, 3), run.stdout + run.stderr
    assert {path.name for path in (folder / "farm").iterdir()} == {f"{frame:06}.exr" for frame in range(1, 6)}
    # A task that is started again has nothing left to do.
    (folder / "farm" / "000005.exr").unlink()
    again = program("-b", "-y", given["blendfile"], *given["args"])
    assert again.returncode == 0 and again.stdout.count("Saved: '") == again.stdout.count("is there already") == 1


# A sun that turns from frame to frame.
SEQUENCE = """
    import bpy, pathlib, sys
    folder = pathlib.Path(sys.argv[-1])
    sun = bpy.data.objects["Sun"]
    for frame in (1, 8):
        sun.rotation_euler = 0.2 * frame, 0.1 * frame, 0.0
        sun.keyframe_insert("rotation_euler", frame=frame)
    bpy.context.scene.frame_end = 8
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "sequence.blend"), copy=True)
"""


@pytest.fixture(scope="module")
def sequence(program):
    """job(template, *options, **parameters) starts `openjd run` on a scene of eight frames; job.folder holds it."""
    script = program.folder / "sequence.py"
    script.write_text(textwrap.dedent(SEQUENCE))
    made = program("-b", program.folder / "scene.blend", "--python-exit-code", "1", "--python", script, "--",
                   program.folder)  # fmt: skip
    assert made.returncode == 0, made.stdout + made.stderr

    def job(template, *options, **parameters):
        values = {"Scene": program.folder / "sequence.blend", "Blender": program.path, **parameters}
        command = [Path(sys.executable).with_name("openjd"), "run", FARM / f"{template}.openjd.yaml"]
        return subprocess.Popen(
            [*command, *(part for name, value in values.items() for part in ("-p", f"{name}={value}")), *options],
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            cwd=program.folder,
            env=program.environment,
        )

    job.folder = program.folder
    return job


def finished(process):
    out, _ = process.communicate(timeout=300)
    assert process.returncode == 0, out
    return out


@pytest.fixture(scope="module")
def frames(sequence):
    """Folder of the eight frames, rendered by two tasks at once with chunks of their own."""
    folder = sequence.folder / "together"
    tasks = [
        sequence("render", "--task-param", f"Frame={chunk}", Frames="1-8", ChunkSize=4, OutputFolder=folder)
        for chunk in ("1-4", "5-8")
    ]
    for task in tasks:
        assert finished(task).count("Saved: '") == 4
    assert {path.name for path in folder.iterdir()} == {f"{frame:04}.exr" for frame in range(1, 9)}
    return folder


def assert_same_picture(path, other):
    found, expected = channels(path), channels(other)
    assert found.keys() == expected.keys()
    for name, values in found.items():
        np.testing.assert_array_equal(values, expected[name], err_msg=f"{path.name}, {name}")


def test_frames_of_an_open_job_description_task_are_those_rendered_alone(sequence, frames):
    folder = sequence.folder / "alone"
    # Every third frame, each a task of its own.
    out = finished(sequence("render", Frames="1-8:3", ChunkSize=1, OutputFolder=folder))
    assert out.count("Saved: '") == len(list(folder.iterdir())) == 3
    for path in folder.iterdir():
        assert_same_picture(path, frames / path.name)
    first, last = (channels(frames / f"000{n}.exr") for n in (1, 8))
    assert any(not np.array_equal(values, last[name]) for name, values in first.items())


def test_a_killed_open_job_description_task_makes_its_frames_again(sequence, frames):
    folder = sequence.folder / "killed"
    # One chunk of all frames, at a pace at which the first is there long before the last.
    task = sequence("render", Frames="1-8", ChunkSize=8, OutputFolder=folder)
    while not (folder / "0002.exr").exists():
        assert task.poll() is None, task.communicate()[0]
        time.sleep(0.01)
    # The worker and all that it started.
    for process in Path("/proc").iterdir():
        if process.name.isdigit() and int(process.name) != os.getpid() and str(folder) in command_line(process):
            os.kill(int(process.name), signal.SIGKILL)
    task.communicate(timeout=60)
    left = {path.name for path in folder.iterdir()}
    assert "0008.exr" not in left
    for name in left:
        assert_same_picture(folder / name, frames / name)
    out = finished(sequence("render", Frames="1-8", ChunkSize=8, OutputFolder=folder))
    assert out.count("is there already") == len(left) and out.count("Saved: '") == 8 - len(left)
    for path in frames.iterdir():
        assert_same_picture(folder / path.name, path)


def command_line(process):
    try:
        return (process / "cmdline").read_text()
    except OSError:
        return ""


def test_an_open_job_description_bakes_chunks_into_files_of_their_own(sequence):
    folder = sequence.folder / "baked"
    out = finished(sequence("bake", Frames="1-3", ChunkSize=2, OutputFolder=folder))
    assert out.count("baked frame") == 3
    assert {path.name for path in folder.iterdir()} == {"light", "lit.1-2.blend", "lit.3-3.blend"}
    assert len(list((folder / "light").iterdir())) == 3


def test_an_open_job_description_compares_with_cycles_frame_by_frame(sequence):
    folder = sequence.folder / "compared"
    job = sequence("compare", Frames="1,8", OutputFolder=folder, Samples=4, Scale=100)
    out, _ = job.communicate(timeout=300)
    if "does not render volumes correctly here" in out:
        # So it is in Debian's build of 5.2, and nothing may be reported then.
        figures = json.loads((folder / "1" / "figures.json").read_text())
        assert job.returncode != 0 and "comparison" not in figures
        return
    assert job.returncode == 0, out
    for frame in (1, 8):
        figures = json.loads((folder / str(frame) / "figures.json").read_text())
        assert 0.0 <= figures["comparison"]["rmse"]["value"] < 1.0
