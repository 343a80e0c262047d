# SPDX-License-Identifier: GPL-3.0-or-later
"""How well the panel knows what a render of a new scene will take.

    python -m benchmarks.cost.forecast [--bake] [--size 480 270] [--samples 4] [--scenes NAME ...]

Sets up each scene, notes the panel's estimate for one thread before anything is read or rendered, and compares it with
the processor seconds, of this process and of those that it starts, of reading and rendering it as F12 does in a window,
with a coarse picture first and the World behind it. Processor time, since an estimate is of a machine that does nothing
else. --bake compares the estimates of bakes, once the volumes have been read, with and without other directions. No
fluid domain: the bpy module cannot simulate.
"""

import argparse
import math
import os
import resource
import tempfile
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import bpy
import numpy as np

from ..support.data import VOLUMES
from ..support.extension import load_extension
from ..support.provenance import made_by

PROGRAM = "benchmarks.cost.forecast"
SMOKE, WIND, FIRE = "openvdb_smoke.vdb", "blender_smoke_wind.vdb", "fire_density_heat.vdb"


def used() -> float:
    """Processor seconds of this process and of those that it has started, Cycles' among them, which goes on running."""
    found = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in found) + used_by_children()


def used_by_children() -> float:
    """Processor seconds of processes that this one has started and that run; 0 where there is no /proc."""
    ticks = 0
    for path in Path("/proc").glob("[0-9]*/stat"):
        try:
            # After the name, which may hold anything.
            fields = path.read_text().rpartition(")")[2].split()
        except OSError:
            # It has just ended.
            continue
        if int(fields[1]) == os.getpid():
            ticks += sum(map(int, fields[11:15]))
    return ticks / os.sysconf("SC_CLK_TCK")


def file(scene: "bpy.types.Scene", name: str, size: float = 3.0, **inputs: object) -> "bpy.types.Object":
    """A volume of a file around the origin, its longest edge of some size."""
    from tests.support import blender_scenes as scenes

    shown, _ = scenes.add_volume(scene, VOLUMES / name, name, **inputs)
    bpy.context.view_layer.update()
    shown.data.grids.load()
    low, high = ([end(corner[axis] for corner in shown.bound_box) for axis in range(3)] for end in (min, max))
    scale = size / max(b - a for a, b in zip(low, high))
    shown.scale = (scale,) * 3
    shown.location = [-0.5 * scale * (a + b) for a, b in zip(low, high)]
    return shown


def box(scene: "bpy.types.Scene", density: float) -> None:
    """A cube of fog."""
    from tests.support import blender_scenes as scenes

    bpy.ops.mesh.primitive_cube_add(size=3.0)
    scenes.add_fog(bpy.context.object.data, "Fog", "ShaderNodeVolumePrincipled", Density=density)


def lamps(scene: "bpy.types.Scene", kind: str, number: int) -> None:
    """Lamps in a row above the origin."""
    from tests.support import blender_scenes as scenes

    for n in range(number):
        light = bpy.data.lights.new(f"{kind} {n}", kind)
        light.energy = 500.0
        scenes.add_object(scene, light.name, light).location = (n - 0.5 * (number - 1), 0.0, 3.0)


def grey(scene: "bpy.types.Scene") -> None:
    """The World of a new file."""
    background = scene.world.node_tree.nodes["Background"].inputs
    background["Color"].default_value, background["Strength"].default_value = (0.05, 0.05, 0.05, 1.0), 1.0


def image(scene: "bpy.types.Scene") -> None:
    """A World of a picture, which Cycles renders."""
    path = Path(tempfile.mkdtemp()) / "surroundings.exr"
    picture = bpy.data.images.new("Surroundings", 256, 128, float_buffer=True)
    values = np.random.default_rng(0).uniform(0.0, 1.0, (128, 256, 4)).astype(np.float32)
    picture.pixels.foreach_set(values.ravel())
    picture.filepath_raw, picture.file_format = str(path), "OPEN_EXR"
    picture.save()
    tree = scene.world.node_tree
    node = tree.nodes.new("ShaderNodeTexEnvironment")
    node.image = bpy.data.images.load(str(path))
    tree.links.new(node.outputs["Color"], tree.nodes["Background"].inputs["Color"])
    tree.nodes["Background"].inputs["Strength"].default_value = 0.5


def smoke_around_the_camera(scene: "bpy.types.Scene") -> None:
    file(scene, SMOKE, 12.0, Density=2.0)
    scene.camera.location = (0.0, 0.0, 0.5)
    grey(scene)


def floor(scene: "bpy.types.Scene") -> None:
    file(scene, WIND, Density=20.0)
    bpy.ops.mesh.primitive_plane_add(size=10.0, location=(0.0, -1.6, 0.0), rotation=(math.pi / 2.0, 0.0, 0.0))
    grey(scene)


def ground(scene: "bpy.types.Scene") -> None:
    """A plane that cuts off the lowest part of the smoke's box."""
    file(scene, SMOKE, Density=5.0)
    bpy.ops.mesh.primitive_plane_add(size=10.0, location=(0.0, -1.4, 0.0), rotation=(math.pi / 2.0, 0.0, 0.0))
    grey(scene)


def cube_in_smoke(scene: "bpy.types.Scene") -> None:
    """As Quick Smoke makes it, on which the cube is what gives off smoke."""
    file(scene, SMOKE, Density=5.0)
    bpy.ops.mesh.primitive_cube_add(size=0.8)
    lamps(scene, "POINT", 1)
    grey(scene)


def two_clouds(scene: "bpy.types.Scene") -> None:
    file(scene, WIND, Density=20.0)
    file(scene, SMOKE, Density=1.0).location.x += 1.0
    lamps(scene, "POINT", 1)


def fire(scene: "bpy.types.Scene") -> None:
    file(scene, FIRE, Density=10.0, Emission_Strength=1.0)
    grey(scene)


#: What each scene has beside a camera and a sun.
SCENES: dict[str, Callable] = {
    "cloud": lambda scene: file(scene, WIND, Density=20.0),
    "cloud, grey World": lambda scene: [file(scene, WIND, Density=20.0), grey(scene)],
    "cloud, World of an image": lambda scene: [file(scene, WIND, Density=20.0), image(scene)],
    "smoke, four point lamps": lambda scene: [file(scene, SMOKE, Density=5.0), lamps(scene, "POINT", 4)],
    "dense smoke, grey World": lambda scene: [file(scene, SMOKE, Density=10.0), grey(scene)],
    "camera in smoke, grey World": smoke_around_the_camera,
    "fog in a cube, three spots": lambda scene: [box(scene, 0.5), lamps(scene, "SPOT", 3)],
    "fog in a cube, grey World": lambda scene: [box(scene, 0.5), grey(scene)],
    "cloud over a floor, grey World": floor,
    "smoke on the ground, grey World": ground,
    "cube in smoke, grey World": cube_in_smoke,
    "two clouds, a point lamp": two_clouds,
    "thick fog in a cube, an area lamp": lambda scene: [box(scene, 8.0), lamps(scene, "AREA", 1)],
    "fire, grey World": fire,
}


class Shown:
    """Takes the pictures, as a window does."""

    def show_coarse(self, layer: object) -> None: ...

    def show_part(self, window: object, layer: object) -> None: ...


def set_up(addon: object, name: str, size: tuple[int, int], samples: int) -> "bpy.types.Scene":
    """One scene, of whose volumes and machine nothing is known."""
    from tests.support import blender_scenes as scenes

    status, scene = addon.mrpnn_addon.status, scenes.empty_scene()
    scene.render.engine, scene.render.film_transparent = "MRPNN", False
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.mrpnn.depth_samples, scene.mrpnn.threads = samples, 1
    scenes.add_camera(scene)
    scenes.add_sun(scene)
    SCENES[name](scene)
    # Compiles the kernels where nothing has before.
    addon.inference.kernels.library.load_kernels()
    status.calibration._known = status.cost_model.Calibration()
    addon.mrpnn_addon.volumes.bounding_boxes.forget_densities()
    return scene


def compare(addon: object, name: str, size: tuple[int, int], samples: int) -> tuple[float, float]:
    """The estimate and the processor seconds of one scene."""
    from tests.support import blender_scenes as scenes

    status, scene = addon.mrpnn_addon.status, set_up(addon, name, size, samples)
    said, before = status.forecast.forecast(scenes.depsgraph()).seconds, used()
    described = addon.mrpnn_addon.scene.reader.read_frame(scenes.depsgraph())
    addon.mrpnn_addon.scene.film.read_background(scenes.depsgraph(), described.camera)
    addon.mrpnn_addon.engine.render_job.render_scene(described, scene.mrpnn.settings(), parts={"": Shown()})
    return said, used() - before


def compare_bake(addon: object, name: str, size: tuple[int, int], directional: bool) -> tuple[object, float]:
    """The estimate and the processor seconds of one scene's bake, files included."""
    from tests.support import blender_scenes as scenes

    scene, job = set_up(addon, name, size, 4), addon.mrpnn_addon.baking.bake_job
    described = addon.mrpnn_addon.scene.reader.read_frame(scenes.depsgraph())
    expected = addon.mrpnn_addon.status.forecast.forecast_bake(scenes.depsgraph(), directional)
    settings = replace(scene.mrpnn.settings(), directional=directional)
    with tempfile.TemporaryDirectory() as folder:
        before = used()
        job.bake_scene(described, settings, job.BakeTarget(folder))
        return expected, used() - before


def main() -> None:
    """The command of the docstring."""
    parser = argparse.ArgumentParser(prog=PROGRAM, description=__doc__.split("\n")[0])
    parser.add_argument("--bake", action="store_true")
    parser.add_argument("--size", type=int, nargs=2, default=(480, 270))
    parser.add_argument("--samples", type=int, default=4)
    parser.add_argument("--scenes", nargs="+", choices=SCENES, default=list(SCENES))
    options = parser.parse_args()
    addon = load_extension()
    print("| scene | estimated | processor seconds | ratio |\n|---|---|---|---|")
    for name in options.scenes if options.bake else ():
        for directional in (True, False):
            expected, took = compare_bake(addon, name, tuple(options.size), directional)
            row = f"{name}{'' if directional else ', without other directions'}"
            print(f"| {row} | {expected.seconds:.1f} | {took:.1f} | {expected.seconds / took:.2f} |", flush=True)
    for name in () if options.bake else options.scenes:
        said, took = compare(addon, name, tuple(options.size), options.samples)
        print(f"| {name} | {said:.1f} | {took:.1f} | {said / took:.2f} |", flush=True)
    print(made_by(PROGRAM))
    addon.unregister()


if __name__ == "__main__":
    main()
