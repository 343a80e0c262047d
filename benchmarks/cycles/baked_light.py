# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles with baked light against independent references.

    python -m benchmarks.cycles.baked_light [VIEW ...]

Writes docs/tables/baked-light.csv, a row per view as soon as it is measured; views that it holds of the present commit
and weights are not measured again. Needs bpy.
"""

import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from evaluation.error import relative_bias, relative_rmse
from inference import Settings, render
from inference.scene.optimizations import ALL

from ..fidelity.views import MASK_ALPHA, View, independent_views, look_at
from ..support.pages import csv_text, read_csv, replace
from ..support.provenance import commit, made_by, weights_checksum

PAGE = Path(__file__).resolve().parents[2] / "docs" / "tables" / "baked-light.csv"
PROGRAM = "benchmarks.cycles.baked_light"
SOURCE = f"`python -m {PROGRAM}`, weights and commit in each row."
SAMPLES = 64
COLUMNS = (
    "view",
    "layer",
    "layer_bias",
    "baked",
    "baked_bias",
    "bake_cpu",
    "cycles_cpu",
    "weights",
    "commit",
)


def stage(view: View, folder: Path):
    """A Blender scene of one view: a Volume object, a sun and a camera. Gives the scene."""
    import bpy
    from mrpnn.mrpnn_addon.vdb.density_grid import VOXEL_CENTRE

    from tests.support import blender_scenes as scenes

    scene = scenes.empty_scene()
    scene.render.resolution_x = scene.render.resolution_y = view.spec.size
    density = view.density()
    cells = density.shape[0]
    # Where Blender draws voxels, the cube's cells.
    frame = scenes.centred(cells, 1.0)
    frame[:3, 3] -= VOXEL_CENTRE / cells
    path = scenes.write_vdb(folder, density, frame)
    spec = view.spec
    scenes.add_volume(
        scene,
        path,
        Density=spec.sigma_hat,
        Color=(*spec.albedo, 1.0),
        Anisotropy=spec.anisotropy,
        Absorption_Color=(0.0,) * 4,
    )
    sun = scenes.add_sun(scene, strength=1.0)
    sun.data.angle = 0.0
    sun.matrix_world = _matrix(look_at(view.sun, view.up))
    lens = bpy.data.cameras.new("Camera")
    lens.angle, lens.clip_start = np.radians(view.fov), 0.01
    scene.camera = scenes.add_object(scene, "Camera", lens)
    scene.camera.matrix_world = _matrix(look_at(view.position, view.up))
    return scene


def measure(view: View) -> dict:
    """The figures of one view."""
    import bpy
    from mrpnn.mrpnn_addon.scene.reader import read_scene

    from tests.support import blender_scenes as scenes

    with tempfile.TemporaryDirectory() as folder:
        scene = stage(view, Path(folder))
        exact = Settings(depth_samples=32, optimizations=ALL - {"shared_pixels"})
        layer = _layer(read_scene(scenes.depsgraph()), exact)
        start = time.process_time()
        bpy.ops.mrpnn.bake_light(folder=folder)
        baked = time.process_time()
        image = cycles(scene, Path(folder))
        done = time.process_time()
        halves = view.halves()
        mask = halves[..., 3].mean(axis=0) > MASK_ALPHA
        a, b = halves[..., :3] * mask[..., None]
        shown, own = (pixels * mask[..., None] for pixels in (image, layer.rgb))
        return {
            "view": view.name,
            "layer": relative_rmse(own, a, b, mask).value,
            "layer_bias": relative_bias(own, a, b, mask).value,
            "baked": relative_rmse(shown, a, b, mask).value,
            "baked_bias": relative_bias(shown, a, b, mask).value,
            "bake_cpu": baked - start,
            "cycles_cpu": done - baked,
            "weights": weights_checksum("mrpnn"),
            "commit": commit(),
        }


def _layer(description, settings: Settings):
    return render(description.volumes, description.suns, description.camera, settings)


def cycles(scene, folder: Path) -> np.ndarray:
    from tests.support import blender_scenes as scenes

    scenes.set_up_cycles(scene, SAMPLES, 0)
    scene.cycles.volume_step_rate = 1.0
    # The value at pixel centres, as layers and references have it.
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BLACKMAN_HARRIS", 0.01
    return scenes.rendered(scene, folder)[..., :3]


def _matrix(values: np.ndarray):
    from mathutils import Matrix

    return Matrix(values.tolist())


def main(names: list[str]) -> None:
    from ..support.extension import extension

    extension()
    rows = read_csv(PAGE) if PAGE.exists() else []
    for view in independent_views():
        present = dict(view=view.name, weights=weights_checksum("mrpnn"), commit=commit())
        if names and view.name not in names or any(present.items() <= row.items() for row in rows):
            continue
        rows = [row for row in rows if row["view"] != view.name] + [measure(view)]
        replace(PAGE, csv_text([SOURCE], COLUMNS, [[row[column] for column in COLUMNS] for row in rows]))
        print(f"{view.name}: error {rows[-1]['baked']:.3f}", flush=True)
    print("| view | layer | Cycles with baked light | Cycles, processor seconds |\n|---|---|---|---|")
    for row in rows:
        figures = [f"{float(row[what]):.3f} ({100 * float(row[f'{what}_bias']):+.1f} %)" for what in ("layer", "baked")]
        print(f"| {row['view']} | {' | '.join(figures)} | {float(row['cycles_cpu']):.1f} |")
    print(made_by(PROGRAM, names))


if __name__ == "__main__":
    main(sys.argv[1:])
