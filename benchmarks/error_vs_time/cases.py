# SPDX-License-Identifier: GPL-3.0-or-later
"""What `benchmarks.error_vs_time` measures: one scene a case."""

from dataclasses import dataclass, replace
from pathlib import Path

from mathutils import Vector

from training.procedural.volumes import HELD_BACK, make_volume

from ..demo import scene as demo_scene
from ..support.data import volume_file

#: Seeds of procedural volumes that no training uses, and files with Y up.
SEEDS = {"cloud": demo_scene.CLOUD_SEED, "model": HELD_BACK[516], "wisps": HELD_BACK[515]}
FILES = {"smoke": "openvdb_smoke.vdb", "plume": "plume/pbrt_plume_0068.vdb"}
#: Volumes that a clone of the repository lacks: measured where they are present, and in no mean.
EXTRAS = ("plume",)
LIGHTS = ("side", "front", "back")
# Factors by which images are larger where seconds are measured at a size that artists use, and where errors of scenes
# with little noise are measured too.
ENLARGED, DENOISED_ENLARGED = 8, 4


@dataclass(frozen=True)
class Case:
    """One scene.

    volume: of SEEDS or FILES. light: of LIGHTS. anisotropy: G. optical_density: optical thickness of the longest edge
    at the densest. albedo: grey. suns: how many; the first stands at `light`. size: pixels per edge. cells: per edge of
    a procedural volume. growth: what a case shows that is not part of the set, or "".
    """

    volume: str = "cloud"
    light: str = "side"
    anisotropy: float = 0.857
    optical_density: float = 100.0
    albedo: float = 1.0
    suns: int = 1
    size: int = 64
    cells: int = 128
    growth: str = ""

    @property
    def name(self) -> str:
        return (
            f"{self.volume}-{self.light}-g{self.anisotropy:g}-d{self.optical_density:g}-a{self.albedo:g}"
            f"-{self.suns}sun-{self.size}px-{self.cells}"
        )

    @property
    def available(self) -> bool:
        return self.volume in SEEDS or volume_file(FILES[self.volume]).exists()


def cases(size: int) -> list:
    """The set, then what shows how costs grow, without what needs an absent file; size: pixels per edge of the set."""
    base = Case(size=size)
    found = [base]
    found += [replace(base, volume=volume) for volume in (*SEEDS, *FILES)]
    found += [replace(base, light=light) for light in LIGHTS]
    found += [replace(base, anisotropy=g) for g in (0.0, 0.5)]
    found += [replace(base, optical_density=density) for density in (10.0, 1000.0)]
    found += [replace(base, volume=volume, light=light) for volume in ("smoke", "model") for light in LIGHTS[1:]]
    found += [replace(base, volume=volume, light=light) for volume in ("wisps", "plume") for light in LIGHTS[1:]]
    enlarged = [replace(case, size=ENLARGED * size, growth="image") for case in dict.fromkeys(found)]
    enlarged += [replace(base, anisotropy=g, size=DENOISED_ENLARGED * size, growth="filter") for g in (0.0, 0.5)]
    growing = {
        "pixels": [replace(base, size=size // 2), replace(base, size=2 * size)],
        "voxels": [replace(base, cells=64), replace(base, cells=256)],
        "suns": [replace(base, suns=2), replace(base, suns=4)],
        "albedo": [replace(base, albedo=0.5), replace(base, albedo=0.9)],
    }
    found += [replace(case, growth=what) for what, several in growing.items() for case in several]
    return [case for case in dict.fromkeys(found + enlarged) if case.available]


def absent_files() -> list:
    """Paths of the volumes whose cases are left out."""
    return [path for path in map(volume_file, FILES.values()) if not path.exists()]


def make(case: Case, folder: Path, openvdb, read_scene):
    """The case's scene in Blender, in place of the current file."""
    path = _file(case, folder, openvdb)
    scene, volume, shader = demo_scene.make_scene(path, (case.size, case.size), "density", case.volume in FILES)
    shader.inputs["Anisotropy"].default_value = case.anisotropy
    shader.inputs["Color"].default_value = (case.albedo,) * 3 + (1.0,)
    demo_scene.fit(scene, volume, shader, read_scene, case.optical_density)
    sun = scene.objects["Sun"]
    sun.rotation_euler = _towards(case.light).to_track_quat("Z", "Y").to_euler()
    for number in range(1, case.suns):
        other = sun.copy()
        other.rotation_euler = (0.4 + 0.3 * number, 0.0, 1.7 * number)
        scene.collection.objects.link(other)
    return scene


def _towards(light: str) -> Vector:
    """To a sun at the side of, in front of (the camera's side) or behind what the camera sees."""
    backward = demo_scene.VIEW_FROM.normalized()
    right = Vector((0.0, 0.0, 1.0)).cross(backward).normalized()
    above = backward.cross(right)
    across, up, back = {"side": (0.9, 0.4, 0.1), "front": (0.2, 0.35, 0.9), "back": (0.3, 0.4, -0.85)}[light]
    return across * right + up * above + back * backward


def _file(case: Case, folder: Path, openvdb) -> Path:
    if case.volume in FILES:
        return volume_file(FILES[case.volume])
    path = folder / f"{case.volume}-{case.cells}.vdb"
    if not path.exists():
        demo_scene.write_grid(path, make_volume(SEEDS[case.volume], case.cells).density, openvdb)
    return path
