# SPDX-License-Identifier: GPL-3.0-or-later
"""Baked light without the noise of a renderer: against independent references, and beside the baked camera.

    python -m benchmarks.fidelity.baked_directions [VIEW ...] [--size 64] [--turn 40] [--light sun | sky parallel lamp]

Prints a row per view: the error and bias of layers and of the baked light where it was baked, against the view's
reference, and of the baked light from a camera turned by so many degrees about the volume, against a layer rendered
from there, at size^2 pixels; and the processor seconds of the bake, with and without other directions. Baked light is
integrated along the pixels' rays, and the single scattering is the layer's. With --light sky, lamp or parallel a row
compares both cameras with layers, in the light of a sky over dark ground or of a point light on the sun's side instead
of the sun; parallel bakes twelve parallel lights in the sky's place.
"""

import argparse
import time
from collections.abc import Sequence

import numpy as np

from evaluation.error import relative_bias, relative_rmse
from inference import Camera, Environment, LitVolume, PointLight, Settings, Sun, bake, render
from inference.grids.grid import Grid
from inference.plan.directional_lights import directional_lights
from inference.plan.lights import DIRECTIONS
from inference.scene.optimizations import ALL

from ..support.provenance import made_by
from .environments import environments
from .views import MASK_ALPHA, View, independent_views, look_at

PROGRAM = "benchmarks.fidelity.baked_directions"
ORBIT = 40.0
EXACT = Settings(depth_samples=32, optimizations=ALL - {"shared_pixels"})
SKY = "gradient over dark ground"
# Distance of the point light from the volume's middle.
LAMP_DISTANCE = 1.0
# Steps along a ray, in edges of the cube, and transmittance at which it ends.
STEP, OPAQUE = 1.0 / 192.0, 1e-3


#: What is said of a row's light.
LIGHTS = {
    "sun": "",
    "sky": ", in a sky's light",
    "parallel": ", by twelve parallel lights in the sky's place, against the layer of the sky",
    "lamp": ", by a point light",
}


def turned(view: View, degrees: float) -> np.ndarray:
    """The camera's position, turned about the vertical axis through the volume."""
    angle, axis, p = np.radians(degrees), np.asarray(view.up, float), np.asarray(view.position, float)
    return p * np.cos(angle) + np.cross(axis, p) * np.sin(angle) + axis * (axis @ p) * (1.0 - np.cos(angle))


def seen(view: View, camera: Camera, lit: LitVolume, pixels: np.ndarray) -> np.ndarray:
    """Baked light, attenuated by the volume, in some pixels, bool (H, W), of a square camera: (H, W, 3)."""
    [(volume, medium)] = view.volumes()
    grid, size = Grid(volume), camera.resolution[0]
    rows, columns = np.nonzero(pixels)
    plane = np.stack([columns + 0.5 - size / 2, size / 2 - rows - 0.5], axis=1) * (2.0 * np.tan(camera.fov / 2) / size)
    rays = np.concatenate([plane, -np.ones((len(plane), 1))], axis=1) @ camera.world_matrix[:3, :3].T
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    eye = camera.world_matrix[:3, 3]
    ends = (np.array([[-0.5], [0.5]])[:, None] - eye) / np.where(np.abs(rays) < 1e-12, 1e-12, rays)
    at, last = np.maximum(ends.min(axis=0).max(axis=1), 0.0) + 0.5 * STEP, ends.max(axis=0).min(axis=1)
    light, transmittance, active = np.zeros((len(rays), 3)), np.ones(len(rays)), np.flatnonzero(last > at)
    while len(active):
        positions = eye + rays[active] * at[active, None]
        density = grid.sample_density(grid.index(positions).T.astype(np.float32))
        filled = active[density > 0.0]
        depth = np.maximum(density[density > 0.0].astype(np.float64) * float(medium.sigma_t[0]) * STEP, 1e-12)
        share = transmittance[filled] * STEP * -np.expm1(-depth) / depth
        light[filled] += lit.towards(positions[density > 0.0], rays[filled]) * share[:, None]
        transmittance[filled] *= np.exp(-depth)
        at[active] += STEP
        active = active[(at[active] < last[active]) & (transmittance[active] > OPAQUE)]
    image = np.zeros((*pixels.shape, 3))
    image[pixels] = light
    return image


def lights(view: View, kind: str) -> tuple[list, list]:
    """Lights that are baked, and those of the layers."""
    if kind == "sun":
        return [Sun(view.sun, 1.0)], [Sun(view.sun, 1.0)]
    if kind == "lamp":
        lamp = PointLight(LAMP_DISTANCE * np.asarray(view.sun) / np.linalg.norm(view.sun), 1.0)
        return [lamp], [lamp]
    sky = Environment(np.repeat(environments()[SKY][..., None], 3, axis=2))
    return directional_lights(sky, DIRECTIONS) if kind == "parallel" else [sky], [sky]


def measure(view: View, size: int, angles: Sequence[float], kind: str) -> str:
    """One row of the table; angles: degrees by which other cameras are turned. kind: one of LIGHTS."""
    shining, rendered = lights(view, kind)
    camera = view.camera(view.spec.size if kind == "sun" else size)
    start = time.process_time()
    bake(view.volumes(), shining, camera, Settings(directional=False))
    middle = time.process_time()
    [lit] = bake(view.volumes(), shining, camera)
    seconds = middle - start, time.process_time() - middle
    layer = render(view.volumes(), rendered, camera, EXACT)
    if kind == "sun":
        halves = view.halves()
        shown = halves[..., 3].mean(axis=0) > MASK_ALPHA
        a, b = halves[..., :3] * shown[..., None]
        own = layer.rgb * shown[..., None]
        baked = own + (seen(view, camera, lit, shown) - layer.multiple) * shown[..., None]
        figures = [
            f"{relative_rmse(image, a, b, shown).value:.3f} ({100 * relative_bias(image, a, b, shown).value:+.1f} %)"
            for image in (own, baked)
        ]
    else:
        figures = [against(layer, view, camera, lit)]
    for degrees in angles:
        beside = Camera(look_at(turned(view, degrees), view.up), resolution=(size, size), fov=camera.fov)
        figures.append(against(render(view.volumes(), rendered, beside, EXACT), view, beside, lit))
    return f"| {view.name}{LIGHTS[kind]} | {' | '.join(figures)} | {seconds[1]:.1f} | {seconds[0]:.1f} |"


def against(layer, view: View, camera: Camera, lit: LitVolume) -> str:
    """Error and bias of baked light against a layer that is rendered by the same camera."""
    shown = layer.alpha > MASK_ALPHA
    change = (seen(view, camera, lit, shown) - layer.multiple)[shown] / layer.rgb[shown].mean()
    return f"{np.sqrt(np.mean(change**2)):.3f} ({100 * change.mean():+.1f} %)"


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("views", nargs="*")
    parser.add_argument("--size", type=int, default=64)
    parser.add_argument("--turn", type=float, nargs="+", default=[ORBIT], metavar="DEGREES")
    parser.add_argument("--light", nargs="+", choices=LIGHTS, default=["sun"])
    options = parser.parse_args()
    if "sun" in options.light and len(options.light) > 1:
        parser.error("the sun's table has other columns: measure it alone")
    figures = ["layer", "baked light"] if options.light == ["sun"] else ["baked view"]
    turns = [f"turned by {degrees:g}°" for degrees in options.turn]
    head = ["view", *figures, *turns, "bake, processor seconds", "without other directions"]
    print(f"| {' | '.join(head)} |\n|{'---|' * len(head)}")
    for view in independent_views():
        if not options.views or view.name in options.views:
            for kind in options.light:
                print(measure(view, options.size, options.turn, kind), flush=True)
    print(made_by(PROGRAM))


if __name__ == "__main__":
    main()
