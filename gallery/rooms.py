# SPDX-License-Identifier: GPL-3.0-or-later
"""Fog in a church, a stage with lamps, milk in water, and a nebula."""

from pathlib import Path

import numpy as np

from training.procedural.noise import Fractal, Swirl

from . import stage
from .fields import ramp, sample
from .smoke import column

STONE = dict(Color=(0.25, 0.21, 0.17))


def arch(name: str, x: float, half: float, spring: float, top: float, y: tuple[float, float]) -> list:
    """What closes a wall above a window with a pointed arch: prisms from y[0] to y[1], up to the height `top`.

    x: the window's middle; half: half its width; spring: height at which the arch begins.
    """
    angles = np.linspace(0, np.pi / 3, 7)
    # Each side is an arc around the foot of the other side.
    side = np.stack([half - 2 * half * np.cos(angles), spring + 2 * half * np.sin(angles)], axis=1)
    outline = np.concatenate([side, side[-2::-1] * (-1, 1)])
    faces = ((0, 1, 2, 3), (7, 6, 5, 4), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0))
    made = []
    for number, ((u, z), (v, w)) in enumerate(zip(outline, outline[1:])):
        section = ((u, z), (v, w), (v, top), (u, top))
        vertices = [(x + across, depth, height) for depth in y for across, height in section]
        made.append(stage.mesh(f"{name} {number}", vertices, faces))
    return made


def fog(folder: Path, detail: float):
    """A nave in fog, with the sun behind three windows at its end."""
    scene = stage.new_scene()
    top, end = 6.5, (9.0, 9.25)
    built = [
        stage.box("Floor", (-3.2, -7.2, -0.2), (3.2, 9.25, 0.0)),
        stage.box("Ceiling", (-3.2, -7.2, top), (3.2, 9.25, top + 0.2)),
        stage.box("Left wall", (-3.2, -7.2, 0.0), (-3.0, 9.25, top)),
        stage.box("Right wall", (3.0, -7.2, 0.0), (3.2, 9.25, top)),
        stage.box("Front wall", (-3.2, -7.2, -0.2), (3.2, -7.0, top)),
        stage.box("Parapet", (-3.0, end[0], 0.0), (3.0, end[1], 1.7)),
        stage.box("Steps", (-1.6, 5.6, 0.0), (1.6, 8.4, 0.16)),
        stage.box("Altar", (-0.65, 6.6, 0.16), (0.65, 7.2, 1.0)),
    ]
    # The windows: middle, half the width, height at which the arch begins.
    windows, left = ((-1.35, 0.36, 3.6), (0.0, 0.46, 4.4), (1.35, 0.36, 3.6)), -3.0
    for number, (x, half, spring) in enumerate(windows):
        built.append(stage.box(f"Pier {number}", (left, end[0], 1.7), (x - half, end[1], top)))
        built += arch(f"Arch {number}", x, half, spring, top, end)
        left = x + half
    built.append(stage.box("Pier", (left, end[0], 1.7), (3.0, end[1], top)))
    for y in np.arange(-4.0, 8.0, 2.4):
        for side in (-2.1, 2.1):
            built.append(stage.pillar(f"Column {side} {y:.1f}", (side, y, 0.0), 0.2, top))
            built.append(stage.box(f"Base {side} {y:.1f}", (side - 0.3, y - 0.3, 0.0), (side + 0.3, y + 0.3, 0.3)))
    for item in built:
        stage.material(item.data, "BsdfDiffuse", **STONE)
    air = stage.box("Fog", (-2.99, -6.99, 0.005), (2.99, 8.99, top - 0.01))
    stage.material(air.data, "VolumePrincipled", "Volume", Density=0.048, Color=(0.97, 0.97, 0.97), Anisotropy=0.6)
    stage.sun((0.2, 1.0, 0.52), 130.0, (1.0, 0.62, 0.32), angle=0.03)
    stage.backdrop((0.35, 0.5, 0.8), 1.5)
    stage.camera((-0.7, -4.8, 1.3), (0.0, 3.0, 2.25), 56.0)
    return scene


def lights(folder: Path, detail: float):
    """A stage in haze, with coloured spots, seen from among the audience."""
    scene = stage.new_scene()
    floor = stage.box("Stage", (-5.0, -4.0, -0.3), (5.0, 3.0, 0.0))
    stage.material(floor.data, "BsdfPrincipled", Base_Color=(0.02, 0.02, 0.022), Roughness=0.25)
    wall = stage.box("Curtain", (-5.0, 3.0, -0.3), (5.0, 3.2, 4.6))
    stage.material(wall.data, "BsdfDiffuse", Color=(0.03, 0.012, 0.02))
    parts = [
        stage.box("Riser", (-0.9, 0.1, 0.0), (0.9, 1.5, 0.22)),
        stage.box("Stand", (-0.02, 0.78, 0.22), (0.02, 0.82, 1.62)),
        stage.box("Microphone", (-0.05, 0.62, 1.6), (0.05, 0.84, 1.7)),
        stage.box("Truss", (-4.5, 1.6, 4.0), (4.5, 1.75, 4.15)),
        stage.box("Speaker left", (-4.2, 0.4, 0.0), (-3.3, 1.2, 2.1)),
        stage.box("Speaker right", (3.3, 0.4, 0.0), (4.2, 1.2, 2.1)),
    ]
    rng = np.random.default_rng(4)
    for number, x in enumerate(np.arange(-2.1, 2.2, 0.42)):
        x, y, z = x + rng.uniform(-0.08, 0.08), rng.uniform(-5.2, -4.5), rng.uniform(0.72, 0.86)
        parts.append(stage.ball(f"Head {number}", (x, y, z), (0.085, 0.1, 0.12)))
        parts.append(stage.ball(f"Shoulders {number}", (x, y, z - 0.33), (0.24, 0.13, 0.2)))
    for part in parts:
        stage.material(part.data, "BsdfPrincipled", Base_Color=(0.03, 0.03, 0.03), Roughness=0.4)
    air = stage.box("Haze", (-4.9, -3.9, 0.005), (4.9, 2.99, 4.5))
    stage.material(air.data, "VolumePrincipled", "Volume", Density=0.06, Color=(1.0, 1.0, 1.0), Anisotropy=0.5)
    colours = ((0.1, 0.25, 1.0), (0.9, 0.08, 0.6), (0.15, 0.8, 0.9), (1.0, 0.75, 0.5))
    cone = dict(spot_size=np.radians(15), spot_blend=0.35, shadow_soft_size=0.03)
    for x, target, colour in (
        (-3.6, (-1.6, 0.4, 0.0), 0),
        (-2.2, (-3.0, -0.6, 0.0), 1),
        (-1.1, (0.9, 0.0, 0.0), 2),
        (1.1, (-0.9, 0.0, 0.0), 2),
        (2.2, (3.0, -0.6, 0.0), 1),
        (3.6, (1.6, 0.4, 0.0), 0),
        (0.0, (0.0, 0.8, 0.5), 3),
    ):
        spot = stage.lamp("SPOT", (x, 1.4, 3.95), 5200.0, colours[colour], **cone)
        stage.aim(spot, target)
    stage.even_world((0.002, 0.002, 0.004))
    stage.camera((0.0, -7.5, 1.3), (0.0, 0.5, 1.85), 56.0)
    return scene


def clear(item, ior: float, colour=(1.0, 1.0, 1.0)) -> None:
    """Water that light passes straight on its way to what is inside."""
    glass = stage.material(item.data, "BsdfGlass", IOR=ior, Color=colour)
    tree = glass.id_data
    rays, straight, mix = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("LightPath", "BsdfTransparent", "MixShader")
    )
    out = next(node for node in tree.nodes if node.type == "OUTPUT_MATERIAL")
    tree.links.new(rays.outputs["Is Shadow Ray"], mix.inputs[0])
    tree.links.new(glass.outputs[0], mix.inputs[1])
    tree.links.new(straight.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], out.inputs["Surface"])


def milk(folder: Path, detail: float):
    """Milk that sinks into a glass of water."""
    scene = stage.new_scene("CYCLES")
    rising = column(4, round(56 * detail), round(62 * detail))
    low, high, voxel = (-0.5, -0.5, 0.0), (0.5, 0.5, 2.0), 0.01 / detail
    path = folder / "milk.vdb"
    stage.write_grids(path, {"density": sample(rising, low, high, voxel)}, low, voxel)
    cloud, _ = stage.volume(path, (0.0, 0.0, 1.98), Density=60.0, Color=(0.99, 0.98, 0.95), Anisotropy=0.7)
    cloud.rotation_euler.x, cloud.scale = np.pi, (1.0, 1.0, 0.95)
    clear(stage.pillar("Water", (0.0, 0.0, 0.01), 0.85, 2.0, 96), 1.33, (0.92, 0.97, 1.0))
    table = stage.plane("Table", 30.0)
    stage.material(table.data, "BsdfPrincipled", Base_Color=(0.006, 0.007, 0.009), Roughness=0.35)
    for location, power, colour in (
        ((-2.9, 2.2, 3.0), 420.0, (1.0, 0.84, 0.66)),
        ((3.1, 1.8, 2.6), 180.0, (0.5, 0.72, 1.0)),
    ):
        strip = stage.lamp("AREA", location, power, colour, shape="RECTANGLE", size=0.8, size_y=2.4)
        stage.aim(strip, (0.0, 0.0, 1.0))
    stage.sky((0.0, (0.03, 0.045, 0.07)), (0.25, (0.012, 0.02, 0.04)), (1.0, (0.004, 0.006, 0.012)))
    stage.camera((0.0, -7.4, 2.2), (0.0, 0.0, 0.98), 31.0)
    return scene


def nebula(folder: Path, detail: float):
    """Dust and glowing gas around young stars."""
    scene = stage.new_scene()
    rng = np.random.default_rng(17)
    shape, fine, swirl = Fractal(rng, 0.55, 6, 0.55), Fractal(rng, 1.4, 5, 0.6, billow=True), Swirl(rng, 0.7, 3, 0.6)
    low, high, voxel = (-2.2, -1.2, -1.3), (2.2, 1.2, 1.3), 0.021 / detail
    half = np.array([2.1, 1.15, 1.25], np.float32)

    def dust(points):
        moved = swirl(points, 0.3)
        inside = ramp(1 - np.linalg.norm(points / half, axis=1), 0.0, 0.5)
        hollow = ramp(np.linalg.norm((moved - np.array([0.25, 0.0, 0.1], np.float32)) / 0.6, axis=1), 0.4, 1.3)
        return inside * hollow * np.exp(1.6 * np.minimum(shape(moved) + 0.4 * fine(moved), 2.2)) / 12

    def gas(points):
        moved = swirl(points, 0.35)
        inside = ramp(1 - np.linalg.norm(points / half, axis=1), 0.0, 0.6)
        return inside * ramp(0.9 - np.abs(shape(moved * 1.3)), 0.0, 1.0) ** 2

    path = folder / "nebula.vdb"
    grids = {
        "density": np.where((d := sample(dust, low, high, voxel)) > 0.02, d, 0),
        "gas": sample(gas, low, high, voxel),
    }
    stage.write_grids(path, grids, low, voxel)
    item, shader = stage.volume(path, Density=4.0, Color=(0.75, 0.8, 0.95), Anisotropy=0.5)
    tree = shader.id_data
    gas_grid, strength = tree.nodes.new("ShaderNodeAttribute"), tree.nodes.new("ShaderNodeMath")
    gas_grid.attribute_name, strength.operation = "gas", "MULTIPLY"
    strength.inputs[1].default_value = 0.45
    tree.links.new(gas_grid.outputs["Fac"], strength.inputs[0])
    tree.links.new(strength.outputs[0], shader.inputs["Emission Strength"])
    shader.inputs["Emission Color"].default_value = (1.0, 0.12, 0.2, 1.0)
    for place, power, colour in (
        ((0.25, 0.0, 0.1), 22.0, (0.55, 0.75, 1.0)),
        ((-0.9, -0.3, 0.35), 7.0, (0.5, 0.7, 1.0)),
        ((1.1, -0.2, -0.3), 6.0, (1.0, 0.65, 0.4)),
    ):
        stage.lamp("POINT", place, power, colour, shadow_soft_size=0.02)
    stage.stars()
    stage.camera((0.0, -4.2, 0.0), (0.0, 0.0, 0.0), 48.0)
    return scene
