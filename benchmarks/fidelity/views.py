"""The views on which systems are measured: what is seen, from where, in what light, and its reference.

Cube units: the volume fills [-1/2, 1/2]^3, the camera looks at the origin, the sun has irradiance 1.
"""

import functools
import pathlib
from dataclasses import dataclass
from typing import Callable, Tuple

import numpy as np

from inference import Camera, Medium, Settings, Sun, render
from training.data.seeded_volume import cube_volume
from training.data.volumes import HELD_BACK, make_volume

from .references import traced_halves

SHARED = pathlib.Path(__file__).resolve().parents[3] / "shared" / "fidelity"
# The references leave out some faint pixels; those count that show the medium.
MASK_ALPHA = 0.02
LIGHTS = ("side", "front", "back")
#: Held-back seeds, none of them among those that training looks at: two cumuli, simulated smoke, a plume,
#: solids cut from one another, a homogeneous solid.
VOLUMES = {
    name: HELD_BACK[i]
    for name, i in {"cloud1": 503, "cloud2": 520, "cloud3": 506, "cloud4": 504, "model1": 516, "model2": 507}.items()
}
#: Of these, the ones whose albedo and anisotropy are varied.
VARIED = ("cloud1", "model1")
GREY = (1.0, 1.0, 1.0)
ALBEDOS = (GREY, (0.96, 0.98, 1.0), (0.8, 0.9, 1.0))
ANISOTROPIES = (0.857, 0.5, 0.0)
SIGMA_HAT = 100.0
FOV = 40.0
POSITION = (1.1, -0.95, 0.45)


@dataclass
class View:
    """One image to be predicted.

    volume: its name; density: () -> float32 (n, n, n); sun, position, up: (3,), cube units; fov: degrees.
    halves: () -> float64 (2, H, W, 4), radiance and alpha of two independent references of `samples` paths a pixel.
    """

    name: str
    volume: str
    light: str
    density: Callable
    sigma_hat: float
    anisotropy: float
    albedo: Tuple[float, float, float]
    sun: np.ndarray
    position: np.ndarray
    up: Tuple[float, float, float]
    fov: float
    size: int
    samples: int
    halves: Callable = None

    def render(self, settings: Settings):
        """The layer of this view."""
        camera = Camera(
            look_at(self.position, self.up), resolution=(self.size, self.size), fov=np.radians(self.fov))
        medium = Medium(self.sigma_hat, self.albedo, self.anisotropy)
        return render([(cube_volume(self.density(), self.volume), medium)], [Sun(self.sun, 1.0)], camera, settings)


def look_at(position, up=(0.0, 1.0, 0.0)) -> np.ndarray:
    """Camera to world (4, 4) for a camera at `position` that looks at the origin."""
    position = np.asarray(position, np.float64)
    forward = -position / np.linalg.norm(position)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3, 0], matrix[:3, 1] = right, np.cross(right, forward)
    matrix[:3, 2], matrix[:3, 3] = -forward, position
    return matrix


@functools.lru_cache(1)
def _shared_density(name: str) -> np.ndarray:
    with np.load(SHARED / "volumes" / f"{name}.npz") as data:
        return data["density"]


def _shared_view(name: str) -> View:
    path = SHARED / "views" / f"{name}.npz"
    with np.load(path) as view:
        facts = {key: view[key] for key in view.files if key != "ab"}
        size = view["ab"].shape[1]

    def halves():
        with np.load(path) as view:
            return view["ab"].astype(np.float64)

    volume, _, light = name.split("-")[:3]
    return View(
        name, volume, light, functools.partial(_shared_density, volume), float(facts["sigma"]), round(float(facts["g"]), 6),
        tuple(round(float(value), 6) for value in facts["albedo"]), facts["sun"], facts["cam"], (0.0, 1.0, 0.0),
        float(facts["fov"]), size, int(facts["spp"]), halves,
    )


def shared_views() -> list:
    """Those beside the project, whose references share no code with it; none where the folder is absent."""
    return [_shared_view(path.stem) for path in sorted((SHARED / "views").glob("*.npz"))]


@functools.lru_cache(1)
def _held_back_density(seed: int, cells: int) -> np.ndarray:
    return make_volume(seed, cells).density


def sun_direction(light: str, position=POSITION, up=(0.0, 0.0, 1.0)) -> np.ndarray:
    """Unit vector towards a sun at the side of, in front of (the camera's side) or behind the volume."""
    right, above, backward = look_at(position, up)[:3, :3].T
    direction = {
        "side": 0.9 * right + 0.4 * above + 0.1 * backward,
        "front": 0.2 * right + 0.35 * above + 0.9 * backward,
        "back": 0.3 * right + 0.4 * above - 0.85 * backward,
    }[light]
    return direction / np.linalg.norm(direction)


def traced_view(name, volume, density, light, sigma_hat, albedo, anisotropy, size, samples, cache) -> View:
    """A view whose reference our own tracer makes; density: () -> float32 (n, n, n), its third axis up."""
    view = View(
        name, volume, light, density, sigma_hat, anisotropy, albedo, sun_direction(light), np.array(POSITION),
        (0.0, 0.0, 1.0), FOV, size, samples,
    )
    view.halves = functools.partial(traced_halves, view, cache)
    return view


def procedural_view(volume, light, albedo, anisotropy, size, samples, cells, cache) -> View:
    """A held-back volume, one of VOLUMES."""
    name = f"{volume}-{light}-g{anisotropy:g}-albedo{albedo[0]:g}"
    density = functools.partial(_held_back_density, VOLUMES[volume], cells)
    return traced_view(name, volume, density, light, SIGMA_HAT, albedo, anisotropy, size, samples, cache)


def procedural_views(size: int, samples: int, cells: int, cache: pathlib.Path) -> list:
    """Table 1's views of every held-back volume and Table 2's of some.

    size: pixels an edge; samples: paths a pixel in each half; cells: an edge of the volumes; cache: folder of
    references.
    """
    wanted = [(volume, light, GREY, ANISOTROPIES[0]) for volume in VOLUMES for light in LIGHTS]
    for volume in VARIED:
        wanted += [(volume, light, albedo, ANISOTROPIES[0]) for albedo in ALBEDOS[1:] for light in LIGHTS]
        wanted += [(volume, light, GREY, g) for g in ANISOTROPIES[1:] for light in LIGHTS]
    # Views of one volume together: the last density made is kept.
    wanted.sort(key=lambda facts: facts[0])
    return [procedural_view(*facts, size, samples, cells, cache) for facts in wanted]
